"""A study's plant, linearised in continuous time: at its start, or at the point where it rests with a stated output."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from dssc_jax.closed_loop.loop import Loop
from dssc_jax.closed_loop.readings import STATE
from dssc_jax.core.adapters import quiet_inputs
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.named import signals_in
from dssc_jax.core.numerics import arithmetic, as_vector
from dssc_jax.core.setting import NominalPlant
from dssc_jax.core.signals import Params, PlantInput, Scalar
from dssc_jax.study.fitting import COMMAND_DISTURBANCE
from dssc_jax.study.laws import nominal_params
from dssc_jax.study.study import Study

NEWTON_STEPS = 20
"""Most steps of Newton's method."""
STEPS_TO_OUTPUT = 21
"""Number of outputs, from the one at the start to the stated one, at which an equilibrium is computed."""
AT_REST = 1e-9
"""Relative tolerance of a rate of change, or of an unknown, at which a plant counts as resting."""
ROUNDING = 1e-12
"""Rounding error of a rate of change, relative to the magnitudes of its terms, which may cancel."""


class Resting(NamedTuple):
    """An operating point at which a nonlinear plant rests.

    Args:
        output: Output y_0 at the point.
        command: Command u_0, which holds the plant at the point.
        signals: Value of each measured signal at the point.
    """

    output: float
    command: float
    signals: tuple[float, ...]


class LinearisedPlant(NamedTuple):
    """A plant with one channel, linearised at a point: x' = A x + b u + E w, y = c x, y' = r x + v u, s = C x + D u.

    All signals are deviations from the point: state x, command u, disturbances w, output y, measured signals s.

    Args:
        a: A, shape (n, n).
        b: Column of the command, shape (n,).
        c: Row of y, shape (n,).
        rate: r, row of y', shape (n,).
        rate_through: v, which is not 0 for a plant of relative degree one.
        signals: C, with a row for each measured signal, shape (m, n).
        feedthrough: D, the effect of the command on each measured signal, shape (m,).
        disturbances: E, shape (n, q): the column of the disturbance at the command, then one for each named input. If
            the plant does not use the disturbance at the command, the first column is b.
        inputs: Names of the columns of E.
        resting: The operating point; None for a linear plant, which rests at 0, and for a start at which no command
            holds the plant.
        is_held: Whether the plant is linear, or a command holds it at this point.
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
        """The same matrices in the form to which a controller is fitted."""
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
    """Linearise a study's plant, with the nominal value in place of each law.

    Args:
        study: The study.
        at: Output of the equilibrium at which a nonlinear plant is linearised. None: the plant is linearised at its
            start, with the command that holds it there, or with the command 0 if no command does.

    Raises:
        ConfigError: The plant has several channels, or keeps its state outside of JAX; ``at`` is stated for a linear
            plant; or no equilibrium with this output is found.
    """
    require_one_command(study)
    loop = study.loop
    params = nominal_params(study.template).plant
    with arithmetic():
        start, quiet, slope, outputs = plant_functions(loop, params)

        def output(x: jax.Array, u: Scalar) -> jax.Array:
            """The output y."""
            return outputs(x, u)[0]

        is_linear = loop.plant.linear is not None and loop.plant.remainder is None
        if at is not None and is_linear:
            raise ConfigError("`at`", "is of a nonlinear plant; a linear one is the same everywhere")
        point = start
        if at is None:
            resting_command = holding_command(slope, start)  # None: no command holds the plant
        else:
            point, resting_command = equilibrium(slope, output, start, at)
        command = resting_command or 0.0
        a, b, columns = map(np.asarray, jax.jit(jax.jacfwd(slope, argnums=(0, 1, 2)))(point, command, quiet))
        rows, feedthrough = map(np.asarray, jax.jit(jax.jacfwd(outputs, argnums=(0, 1)))(point, command))
        y, _, *signals = np.asarray(jax.jit(outputs)(point, command)).tolist()
    uses_command_disturbance = bool(np.any(columns[:, 0]))
    if not uses_command_disturbance:
        columns = np.column_stack([b, columns[:, 1:]])
    resting = None
    if not is_linear and resting_command is not None:
        resting = Resting(y, command, tuple(signals))
    return LinearisedPlant(
        a=a,
        b=b,
        c=rows[0],
        rate=rows[1],
        rate_through=float(feedthrough[1]),
        signals=rows[2:],
        feedthrough=feedthrough[2:],
        disturbances=columns,
        inputs=(COMMAND_DISTURBANCE, *loop.input_names),
        resting=resting,
        is_held=is_linear or resting_command is not None,
    )


def require_one_command(study: Study) -> None:
    """Require a plant with one command whose functions JAX can differentiate.

    Raises:
        ConfigError: The plant has several channels, or keeps its state outside of JAX.
    """
    loop = study.loop
    place = f"{study.source}: plant.kind"
    if len(loop.channels) > 1:
        raise ConfigError(place, "first gains are those of a plant with one command")
    if loop.plant.begin is not None:
        rule = f"keeps its state outside of JAX ({loop.plant.native}), so it has no derivative"
        raise ConfigError(place, f"{rule}; first gains need a linear plant near it, such as kind = 'state_space'")


class PlantFunctions(NamedTuple):
    """A plant as functions of its state as a vector x, and of its command u.

    Args:
        start: x at the start, shape (n,).
        quiet: Zeros in place of the disturbances, at the command and at each named input, shape (1 + inputs,).
        slope: (x, u, disturbances) -> x', shape (n,); the disturbances are ``quiet`` unless they are stated.
        outputs: (x, u) -> the output y, then y' and the measured signals, shape (2 + m,).
    """

    start: jax.Array
    quiet: jax.Array
    slope: Callable[..., jax.Array]
    outputs: Callable[[jax.Array, Scalar], jax.Array]


def plant_functions(loop: Loop, params: Params) -> PlantFunctions:
    """Make functions of a vector from the functions of a loop's plant, without wind.

    Args:
        loop: The loop, with one command.
        params: Parameters of its plant, in plain numbers.
    """
    start, unravel = as_vector(loop.plant.init(params))
    quiet = jnp.zeros(1 + len(quiet_inputs(loop.plant, params)))

    def slope(x: jax.Array, u: Scalar, disturbances: jax.Array = quiet) -> jax.Array:
        """Rate of change x' for the disturbance at the command, then those at the named inputs."""
        drive = PlantInput(u, disturbance=disturbances[0], wind=None, inputs=tuple(disturbances[1:]))
        rate_of_change, _ = ravel_pytree(loop.plant.derivative(params, unravel(x), drive, 0.0))
        return rate_of_change

    def outputs(x: jax.Array, u: Scalar) -> jax.Array:
        """The output y, then y' and the measured signals."""
        state = unravel(x)
        drive = PlantInput(u, disturbance=0.0, wind=None, inputs=tuple(quiet[1:]))
        measurement = loop.plant.measure(params, state, drive)
        values = {"y": measurement.y, "y_dot": measurement.y_dot}
        values |= {f"{STATE}{i}": leaf for i, leaf in enumerate(jax.tree.leaves(state), start=1)}
        if loop.measures:
            values |= signals_in(loop.plant.monitor(params, state, drive))
        names = ("y", "y_dot", *(signal.name for signal in loop.measures))
        return jnp.stack([jnp.asarray(values[name], float) for name in names])

    return PlantFunctions(start, quiet, slope, outputs)


def holding_command(slope: Callable[[jax.Array, Scalar], jax.Array], start: jax.Array) -> float | None:
    """The command that holds a plant at a state, found by Newton's method; None if no command does.

    Each step reduces the rate of change in the sense of least squares, since one command acts on several states.

    Args:
        slope: ``(x, u) -> x'``.
        start: The state x, shape (n,).
    """
    rate_of = jax.jit(lambda u: slope(start, u))  # (u) -> x'
    effect_of = jax.jit(jax.jacfwd(rate_of))  # (u) -> dx'/du
    initial_rate = float(np.max(np.abs(np.asarray(rate_of(0.0), float))))
    if initial_rate == 0.0:
        return 0.0
    command = 0.0
    for _ in range(NEWTON_STEPS):
        rate = np.asarray(rate_of(command), float)
        effect = np.asarray(effect_of(command), float)
        size = float(effect @ effect)
        if not size > 0.0:  # the command has no effect, or NaN
            return None
        command -= float(effect @ rate) / size  # least squares
    residual = np.abs(np.asarray(rate_of(command), float))
    slopes, effect = map(np.asarray, jax.jit(jax.jacfwd(slope, argnums=(0, 1)))(start, command))
    terms = np.abs(slopes) @ np.abs(np.asarray(start)) + np.abs(effect * command)
    is_at_rest = np.all(residual <= np.maximum(AT_REST * initial_rate, ROUNDING * terms))
    return command if is_at_rest else None


def equilibrium(
    slope: Callable[[jax.Array, Scalar], jax.Array],
    output: Callable[[jax.Array, Scalar], jax.Array],
    start: jax.Array,
    at: float,
) -> tuple[jax.Array, float]:
    """The state, shape (n,), and the command with which a plant rests at a stated output.

    The output moves in small steps from its value at the start to the stated one. At each step, Newton's method finds
    the equilibrium from the one before.

    Args:
        slope: ``(x, u) -> x'``.
        output: ``(x, u) -> y``.
        start: The state x at the start, shape (n,).
        at: The stated output.

    Raises:
        ConfigError: No equilibrium with this output is found.
    """

    @jax.jit
    def excess(point: jax.Array, y: Scalar) -> jax.Array:
        """Rate of change x', then the deviation of the output from y; both vanish at an equilibrium (x, u)."""
        x = point[:-1]
        u = point[-1]
        return jnp.append(slope(x, u), output(x, u) - y)

    slopes = jax.jit(jax.jacfwd(excess))
    point = np.append(np.asarray(start), holding_command(slope, start) or 0.0)
    start_output = float(output(start, point[-1]))
    for y in np.linspace(start_output, at, STEPS_TO_OUTPUT):
        for _ in range(NEWTON_STEPS):
            move, *_ = np.linalg.lstsq(np.asarray(slopes(point, y)), -np.asarray(excess(point, y)), rcond=None)
            point = point + move
            if not np.all(np.isfinite(point)):
                raise ConfigError("`at`", f"no equilibrium with the output {y:g} is found from the plant's start")
            if np.all(np.abs(move) <= AT_REST * np.abs(point)):
                break
    residual = np.abs(np.asarray(excess(point, at)))
    terms = np.abs(np.asarray(slopes(point, at))) @ np.abs(point)
    terms[-1] += abs(at)  # the last equation is y(x, u) - at = 0
    is_at_rest = np.all(residual <= AT_REST * terms)
    if not is_at_rest:
        raise ConfigError("`at`", f"no equilibrium with the output {at:g} is found from the plant's start")
    return jnp.asarray(point[:-1]), float(point[-1])
