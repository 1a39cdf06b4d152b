"""Linearise the loop at the origin: in continuous time part by part, in sampled time by differentiating its step."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from dssc_jax.closed_loop.first_state import initial_state
from dssc_jax.closed_loop.loop import Loop, LoopParams
from dssc_jax.closed_loop.sample import LoopState, step
from dssc_jax.core.adapters import quiet_inputs
from dssc_jax.core.contracts import Unmodelled
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import as_arrays
from dssc_jax.core.registry import Registry
from dssc_jax.core.signals import PlantInput, ReferencePoint, Scalar, tracking_error
from dssc_jax.engine.linearisation.smooth_parts import declared_place, substituted
from dssc_jax.models.actuators import UNMODELLED
from dssc_jax.models.controllers import CONTROLLERS
from dssc_jax.models.controllers.nominal import nominal_control
from dssc_jax.study import Study
from dssc_jax.study.actuators import kind_in, section_of

ORIGIN = ReferencePoint(0.0, 0.0, 0.0)


class Linearised(NamedTuple):
    """The loop from the robust command u to sigma, x' = A x + B u, sigma = C x, linearised at the origin.

    It consists of plant, nominal control and unmodelled dynamics.

    Args:
        a: A, shape (states, states).
        b: B, shape (states,).
        c: C, shape (states,).
    """

    a: jax.Array
    b: jax.Array
    c: jax.Array


def at_rest(study: Study) -> Study:
    """The study without inputs: no reference, no disturbance, and the plant's state at zero.

    Raises:
        ConfigError: The plant has several channels.
    """
    if len(study.loop.channels) > 1:
        raise ConfigError(f"{study.source}: plant.kind", "the origin is that of a plant of one channel")
    changes: dict[str, Any] = {"reference": {"kind": "zero"}, "disturbance": {"kind": "none"}, "sweep": {}}
    if "initial" in study.table["plant"]:
        changes["plant.initial"] = [0.0, 0.0]
    return study.override(changes)


def require_continuous(study: Study) -> None:
    """Require a loop with a form in continuous time: a controller with a law (22), and continuous unmodelled dynamics.

    Raises:
        ConfigError: The controller synthesises no such law, or the unmodelled dynamics have no continuous-time form.
    """
    if study.loop.controller[0].synthesised is None:
        kind = kind_in(study.config, "controller")
        continuous_kinds = ", ".join(kinds_with(CONTROLLERS, "synthesised"))
        rule = f"'{kind}' synthesises no law (22), which the continuous-time analysis takes; {continuous_kinds} do"
        raise ConfigError(f"{study.source}: controller.kind", rule)
    loop, template = study.loop, study.template
    place = declared_place(study, "unmodelled", 0, loop.unmodelled[0], template.unmodelled[0])
    smooth_loop, _ = substituted(loop, template, [place])  # dynamics that are smooth nowhere have a substitute
    require_continuous_dynamics(study, smooth_loop.unmodelled[0])


def require_continuous_dynamics(study: Study, dynamics: Unmodelled) -> None:
    """Require unmodelled dynamics that :func:`open_loop` can linearise in continuous time.

    Args:
        study: The study, for the message.
        dynamics: The unmodelled dynamics.

    Raises:
        ConfigError: The dynamics have no continuous-time form.
    """
    if not dynamics.continuous:
        continuous_kinds = ", ".join(kinds_with(UNMODELLED, "continuous"))
        raise ConfigError(
            f"{study.source}: {section_of(study.config, 'unmodelled')}.kind",
            f"the continuous-time analysis covers {continuous_kinds}, got '{kind_in(study.config, 'unmodelled')}'; "
            "use the sampled loop",
        )


def opaque_parts(study: Study) -> list[str]:
    """The sections of the parts between plant and controller that :func:`open_loop` leaves out, if any changes y or y'.

    Args:
        study: A study on a plant of one channel.
    """
    loop, template = study.loop, study.template
    parts = {
        "sensor": (loop.sensor[0], template.sensor[0]),
        "differentiator": (loop.differentiator[0], template.differentiator[0]),
    }
    return [section for section, (part, params) in parts.items() if not part.transparent(params)]


def kinds_with(registry: Registry, field: str) -> list[str]:
    """The kinds of a registry of which some model has a value in a field."""
    return [kind for kind, entry in registry.items() if any(getattr(part, field) for part in entry.members.values())]


def open_loop(loop: Loop, params: LoopParams) -> Linearised:
    """Linearise plant, nominal control and unmodelled dynamics, from the robust command to sigma, at the origin.

    Unmodelled dynamics have only a step; its slope at a step of 0 is the derivative of their state.

    Args:
        loop: A loop at rest; see :func:`require_continuous`.
        params: Parameters of the loop for one draw.
    """
    gains = params.controller[0]
    model = loop.unmodelled[0]
    dynamics = params.unmodelled[0]
    resting, unravel = ravel_pytree(loop.plant.init(params.plant))
    quiet = PlantInput(0.0, 0.0, None, quiet_inputs(loop.plant, params.plant))
    memory, unravel_memory = ravel_pytree(as_arrays(model.init(dynamics)))

    def sigma_of(x: jax.Array) -> Scalar:
        return tracking_error(loop.plant.measure(params.plant, unravel(x), quiet), ORIGIN, gains.l0).sigma

    def derivative(state: jax.Array, u: Scalar) -> jax.Array:
        x = state[: resting.size]
        z = unravel_memory(state[resting.size :])
        error = tracking_error(loop.plant.measure(params.plant, unravel(x), quiet), ORIGIN, gains.l0)
        total = u + nominal_control(gains.nominal, gains.l0, error, ORIGIN, predictor_pole_at_rest(gains))
        _, slope = jax.jvp(lambda dt: model.step(dynamics, z, total, dt), (0.0,), (1.0,))
        command_at_plant = model.output(dynamics, z, total)
        rate = loop.plant.derivative(params.plant, unravel(x), quiet._replace(command=command_at_plant), 0.0)
        return jnp.concatenate([ravel_pytree(rate)[0], ravel_pytree(as_arrays(slope))[0]])

    origin = jnp.zeros(resting.size + memory.size)
    a, b = jax.jacfwd(derivative, argnums=(0, 1))(origin, 0.0)
    c = jax.grad(lambda state: sigma_of(state[: resting.size]))(origin)
    return Linearised(a, b, c)


def predictor_pole_at_rest(gains: Any) -> Scalar:
    """The pole 1/tau_m of the predictor at the origin [1/s]; 0 for a controller without a predictor."""
    return 1.0 / gains.functions.at(0.0, 0.0, gains.l0).tau_m if hasattr(gains, "functions") else 0.0


def continuous_matrix(loop: Loop, params: LoopParams) -> jax.Array:
    """System matrix of the loop closed by the law (22) in continuous time, shape (states + 1, states + 1).

    The last state is the integral term of u.

    Args:
        loop: A loop at rest; see :func:`require_continuous`.
        params: Parameters of the loop for one draw.
    """
    a, b, c = open_loop(loop, params)
    law = loop.controller[0].synthesised
    assert law is not None  # held by require_continuous, before tracing
    proportional, integral = law(params.controller[0])
    closed_loop = a - proportional * jnp.outer(b, c)
    return jnp.block([[closed_loop, b[:, None]], [-integral * c[None, :], jnp.zeros((1, 1))]])


class RestLinearisation(NamedTuple):
    """The linearisation of a loop at its start.

    Args:
        matrix: Jacobian of the loop's step, or system matrix in continuous time, shape (states, states).
        displacement: Largest change of a state in one sample; 0 if the loop starts at an equilibrium.
    """

    matrix: jax.Array
    displacement: jax.Array


def start_at_rest(loop: Loop, params: LoopParams) -> jax.Array:
    """The state after the first sample as a vector, shape (states,); see :func:`first_sample`."""
    return ravel_pytree(first_sample(loop, params))[0]


def first_sample(loop: Loop, params: LoopParams) -> LoopState:
    """The state after the first sample, at which a loop is linearised.

    A controller may treat its first sample unlike the others.
    """
    key = jax.random.key(0)
    return step(loop, params, key, initial_state(loop, params, key), 0)[0]


def linearise_at_rest(loop: Loop, params: LoopParams) -> RestLinearisation:
    """Differentiate the step of the loop from its second sample to the third."""
    key = jax.random.key(0)
    resting, unravel = ravel_pytree(first_sample(loop, params))

    def after(state: jax.Array) -> jax.Array:
        return ravel_pytree(step(loop, params, key, unravel(state), 1)[0])[0]

    return RestLinearisation(jax.jacfwd(after)(resting), jnp.max(jnp.abs(after(resting) - resting), initial=0.0))
