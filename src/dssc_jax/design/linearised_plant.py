"""A study's plant, linearised in continuous time at its start or where it rests with an output, and that point."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from dssc_jax.closed_loop.readings import STATE
from dssc_jax.core.adapters import quiet_inputs
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.named import signals_in
from dssc_jax.core.numerics import arithmetic, as_vector
from dssc_jax.core.setting import NominalPlant
from dssc_jax.core.signals import PlantInput, Scalar
from dssc_jax.study.fitting import COMMAND_DISTURBANCE, nominal_params
from dssc_jax.study.study import Study

NEWTON_STEPS = 20
STEPS_TO_OUTPUT = 21  # from the output at the start to a stated one
AT_REST = 1e-9  # share of the rate of change without a command that may be left
ROUNDING = 1e-12  # share of the terms of a rate of change that may be left, where they cancel


class Resting(NamedTuple):
    """An operating point at which a nonlinear plant rests.

    Args:
        output: y_0.
        command: u_0, which holds the plant.
        signals: Each measured signal there.
    """

    output: float
    command: float
    signals: tuple[float, ...]


class LinearisedPlant(NamedTuple):
    """A plant of one channel, linearised at a point: x' = A x + b u + E w, y = c x, y' = r x + v u, s = C x + D u.

    Args:
        a: Shape (n, n).
        b: Shape (n,).
        c: Shape (n,).
        rate: r, shape (n,).
        rate_through: v, which is not 0 for a plant of relative degree one.
        signals: C, a row for each measured signal, shape (m, n).
        feedthrough: D, shape (m,).
        disturbances: E, columns of the disturbance beside the command and of each named input, shape (n, q). A plant
            without the former has the command's column.
        inputs: Names of these columns.
        resting: The operating point; None: a linear plant, which has 0 as one, or a start at which no command holds it.
        is_held: Whether a command holds the plant at this point, or it is linear.
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    rate: np.ndarray
    rate_through: float
    signals: np.ndarray
    feedthrough: np.ndarray
    disturbances: np.ndarray
    inputs: tuple[str, ...]
    resting: Resting | None
    is_held: bool

    @property
    def nominal(self) -> NominalPlant:
        """The plant as a controller is fitted to it."""
        return NominalPlant(
            a=self.a,
            command=self.b,
            disturbances=self.disturbances,
            output=self.c,
            signals=self.signals,
            feedthrough=self.feedthrough,
            inputs=self.inputs,
        )


def linearised_plant(study: Study, at: float | None = None) -> LinearisedPlant:
    """A study's plant, linearised with the median in place of each law.

    Args:
        study: The study.
        at: Output at which a nonlinear plant rests where it is linearised; None: its start, with the command that keeps
            it there, or 0 where there is none.

    Raises:
        ConfigError: The plant has several channels, or no derivative; or no equilibrium with this output is found.
    """
    loop = study.loop
    place = f"{study.source}: plant.kind"
    if len(loop.channels) > 1:
        raise ConfigError(place, "first gains are those of a plant with one command")
    if loop.plant.begin is not None:
        rule = f"keeps its state outside of JAX ({loop.plant.native}), so it has no derivative"
        raise ConfigError(place, f"{rule}; first gains need a linear plant near it, such as kind = 'state_space'")
    params = nominal_params(study.template).plant
    with arithmetic():
        start, unravel = as_vector(loop.plant.init(params))
        quiet = jnp.zeros(1 + len(quiet_inputs(loop.plant, params)))

        def slope(x: jax.Array, u: Scalar, disturbances: jax.Array = quiet) -> jax.Array:
            drive = PlantInput(u, disturbances[0], None, tuple(disturbances[1:]))
            return ravel_pytree(loop.plant.derivative(params, unravel(x), drive, 0.0))[0]

        def outputs(x: jax.Array, u: Scalar) -> jax.Array:
            state = unravel(x)
            drive = PlantInput(u, 0.0, None, tuple(quiet[1:]))
            measurement = loop.plant.measure(params, state, drive)
            values = {"y": measurement.y, "y_dot": measurement.y_dot}
            values |= {f"{STATE}{i}": leaf for i, leaf in enumerate(jax.tree.leaves(state), start=1)}
            if loop.measures:
                values |= signals_in(loop.plant.monitor(params, state, drive))
            names = ("y", "y_dot", *(signal.name for signal in loop.measures))
            return jnp.stack([jnp.asarray(values[name], float) for name in names])

        linear = loop.plant.linear is not None and loop.plant.remainder is None
        if at is not None and linear:
            raise ConfigError("`at`", "is of a nonlinear plant; a linear one is the same everywhere")
        if at is None:
            resting_command = holding_command(slope, start)
        else:
            start, resting_command = equilibrium(slope, lambda x, u: outputs(x, u)[0], start, at)
        command = resting_command or 0.0
        a, b, columns = map(np.asarray, jax.jit(jax.jacfwd(slope, argnums=(0, 1, 2)))(start, command, quiet))
        rows, feedthrough = map(np.asarray, jax.jit(jax.jacfwd(outputs, argnums=(0, 1)))(start, command))
        y, _, *signals = np.asarray(jax.jit(outputs)(start, command)).tolist()
    if not np.any(columns[:, 0]):
        columns = np.column_stack([b, columns[:, 1:]])
    resting = None if linear or resting_command is None else Resting(y, command, tuple(signals))
    is_held = linear or resting_command is not None
    names = (COMMAND_DISTURBANCE, *loop.input_names)
    through = float(feedthrough[1])
    return LinearisedPlant(
        a=a,
        b=b,
        c=rows[0],
        rate=rows[1],
        rate_through=through,
        signals=rows[2:],
        feedthrough=feedthrough[2:],
        disturbances=columns,
        inputs=names,
        resting=resting,
        is_held=is_held,
    )


def holding_command(slope: Callable[[jax.Array, Scalar], jax.Array], start: jax.Array) -> float | None:
    """The command with which a state stays where it is, by Newton's method; None where there is none.

    Args:
        slope: ``(x, u) -> x'``.
        start: The state x.
    """
    rate_of = jax.jit(lambda u: slope(start, u))
    effect_of = jax.jit(jax.jacfwd(rate_of))
    command = 0.0
    initial_rate = float(np.max(np.abs(np.asarray(rate_of(0.0), float))))
    for _ in range(NEWTON_STEPS if initial_rate > 0.0 else 0):
        rate = np.asarray(rate_of(command), float)
        effect = np.asarray(effect_of(command), float)
        size = float(effect @ effect)
        if not size > 0.0:
            return None
        command -= float(effect @ rate) / size
    residual = np.abs(np.asarray(rate_of(command), float))
    slopes, effect = (np.asarray(part) for part in jax.jit(jax.jacfwd(slope, argnums=(0, 1)))(start, command))
    terms = np.abs(slopes) @ np.abs(np.asarray(start)) + np.abs(effect * command)
    return command if np.all(residual <= np.maximum(AT_REST * initial_rate, ROUNDING * terms)) else None


def equilibrium(
    slope: Callable[[jax.Array, Scalar], jax.Array],
    output: Callable[[jax.Array, Scalar], jax.Array],
    start: jax.Array,
    at: float,
) -> tuple[jax.Array, float]:
    """The state and the command with which a plant rests at an output.

    Newton's method follows the equilibria from the output at the start to this one.

    Args:
        slope: ``(x, u) -> x'``.
        output: ``(x, u) -> y``.
        start: The state x at the start.
        at: The output.

    Raises:
        ConfigError: It leads to none.
    """

    @jax.jit
    def excess(point: jax.Array, y: Scalar) -> jax.Array:
        x, u = point[:-1], point[-1]
        return jnp.append(slope(x, u), output(x, u) - y)

    slopes = jax.jit(jax.jacfwd(excess))
    point = np.append(np.asarray(start), holding_command(slope, start) or 0.0)
    start_output = float(output(start, point[-1]))
    for y in np.linspace(start_output, at, STEPS_TO_OUTPUT):
        for _ in range(NEWTON_STEPS):
            move = np.linalg.lstsq(np.asarray(slopes(point, y)), -np.asarray(excess(point, y)), rcond=None)[0]
            point = point + move
            if not np.all(np.isfinite(point)):
                raise ConfigError("`at`", f"no equilibrium with the output {y:g} is found from the plant's start")
            if np.all(np.abs(move) <= AT_REST * np.abs(point)):
                break
    residual = np.abs(np.asarray(excess(point, at)))
    terms = np.abs(np.asarray(slopes(point, at))) @ np.abs(point)
    if not np.all(residual <= AT_REST * np.append(terms[:-1], abs(at) + terms[-1])):
        raise ConfigError("`at`", f"no equilibrium with the output {at:g} is found from the plant's start")
    return jnp.asarray(point[:-1]), float(point[-1])
