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
from dssc_jax.core.signals import PlantInput, ReferencePoint, Scalar, TrackingError, tracking_error
from dssc_jax.engine.linearisation.smooth_parts import declared_place, substituted
from dssc_jax.models.actuators import UNMODELLED
from dssc_jax.models.controllers import CONTROLLERS
from dssc_jax.models.controllers.nominal import nominal_control
from dssc_jax.study import Study
from dssc_jax.study.actuators import kind_in, section_of

ORIGIN = ReferencePoint(0.0, 0.0, 0.0)


class Linearised(NamedTuple):
    """The loop without its robust control, linearised at the origin: x' = A x + B u, sigma = C x.

    The input is the robust command u, and the output is the sliding variable sigma. In between are the unmodelled
    dynamics, the plant and the nominal control. The state x consists of the states of the plant, then those of the
    unmodelled dynamics.

    Args:
        a: A, shape (states, states).
        b: B, shape (states,).
        c: C, shape (states,).
    """

    a: jax.Array
    b: jax.Array
    c: jax.Array


def at_rest(study: Study) -> Study:
    """The study with its inputs removed, so that the loop can rest.

    Reference and disturbance are zero, the plant starts at zero, and there is no sweep.

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
    """Refuse a study whose loop has no form in continuous time.

    A loop has such a form if its controller synthesises a law (22), proportional plus integral in sigma, and its
    unmodelled dynamics are continuous.

    Args:
        study: A study on a plant of one channel.

    Raises:
        ConfigError: The controller synthesises no such law, or the unmodelled dynamics have no continuous-time form.
    """
    if study.loop.controller[0].synthesised is None:
        kind = kind_in(study.config, "controller")
        continuous_kinds = ", ".join(kinds_with(CONTROLLERS, "synthesised"))
        rule = f"'{kind}' synthesises no law (22), which the continuous-time analysis takes; {continuous_kinds} do"
        raise ConfigError(f"{study.source}: controller.kind", rule)
    loop = study.loop
    template = study.template
    place = declared_place(study, "unmodelled", 0, loop.unmodelled[0], template.unmodelled[0])  # 0: the only channel
    smooth_loop, _ = substituted(loop, template, [place])  # dynamics that are smooth nowhere have a substitute
    require_continuous_dynamics(study, smooth_loop.unmodelled[0])


def require_continuous_dynamics(study: Study, dynamics: Unmodelled) -> None:
    """Refuse unmodelled dynamics that have only a form in sampled time, which :func:`open_loop` cannot linearise.

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
    """Which of the sections ``sensor`` and ``differentiator`` change y or y' on the way to the controller.

    :func:`open_loop` leaves sensor and differentiator out, so results have to name those that are not transparent.

    Args:
        study: A study on a plant of one channel.
    """
    loop = study.loop
    template = study.template
    sections = []
    if not loop.sensor[0].transparent(template.sensor[0]):
        sections.append("sensor")
    if not loop.differentiator[0].transparent(template.differentiator[0]):
        sections.append("differentiator")
    return sections


def kinds_with(registry: Registry, field: str) -> list[str]:
    """The kinds of models in a registry of which some form has an optional property, such as a law (22).

    The names are for error messages.

    Args:
        registry: The registry of controllers or actuators.
        field: Name of the property; it is truthy for a model that has it.
    """
    kinds = []
    for kind, entry in registry.items():
        if any(getattr(model, field) for model in entry.members.values()):
            kinds.append(kind)
    return kinds


def open_loop(loop: Loop, params: LoopParams) -> Linearised:
    """Linearise plant, nominal control and unmodelled dynamics, from the robust command to sigma, at the origin.

    Unmodelled dynamics are given as a step of length dt. The derivative of this step by dt, at dt = 0, is the
    derivative of their state by time.

    Args:
        loop: A loop at rest; see :func:`require_continuous`.
        params: Parameters of the loop for a draw.
    """
    gains = params.controller[0]
    model = loop.unmodelled[0]
    dynamics = params.unmodelled[0]
    plant_states, unravel_plant = ravel_pytree(loop.plant.init(params.plant))
    dynamics_states, unravel_dynamics = ravel_pytree(as_arrays(model.init(dynamics)))
    quiet = PlantInput(0.0, 0.0, None, quiet_inputs(loop.plant, params.plant))

    def error_at(state: jax.Array) -> TrackingError:
        """The tracking error, including sigma, in a state vector of plant and unmodelled dynamics."""
        x = unravel_plant(state[: plant_states.size])
        return tracking_error(loop.plant.measure(params.plant, x, quiet), ORIGIN, gains.l0)

    def derivative(state: jax.Array, u: Scalar) -> jax.Array:
        """The time derivative of the state vector of plant and unmodelled dynamics, under the robust command u."""
        x = unravel_plant(state[: plant_states.size])
        z = unravel_dynamics(state[plant_states.size :])
        total = u + nominal_control(gains.nominal, gains.l0, error_at(state), ORIGIN, predictor_pole_at_rest(gains))

        def z_after(dt: jax.Array) -> Any:
            """The state of the unmodelled dynamics after a step of length dt [s] from z under the command ``total``."""
            return model.step(dynamics, z, total, dt)

        _, z_rate = jax.jvp(z_after, (0.0,), (1.0,))  # the derivative by dt at dt = 0
        command_at_plant = model.output(dynamics, z, total)
        x_rate = loop.plant.derivative(params.plant, x, quiet._replace(command=command_at_plant), 0.0)  # at the time 0
        plant_rates, _ = ravel_pytree(x_rate)
        dynamics_rates, _ = ravel_pytree(as_arrays(z_rate))
        return jnp.concatenate([plant_rates, dynamics_rates])

    origin = jnp.zeros(plant_states.size + dynamics_states.size)
    a, b = jax.jacfwd(derivative, argnums=(0, 1))(origin, 0.0)
    c = jax.grad(lambda state: error_at(state).sigma)(origin)
    return Linearised(a, b, c)


def predictor_pole_at_rest(gains: Any) -> Scalar:
    """The pole 1/tau_m of the predictor at the origin [1/s]; 0 for a controller without a predictor.

    Args:
        gains: Parameters of the controller. A controller with a predictor has the field ``functions``: functions of
            sigma and e, of which tau_m is one.
    """
    if not hasattr(gains, "functions"):
        return 0.0
    return 1.0 / gains.functions.at(0.0, 0.0, gains.l0).tau_m  # sigma = e = 0


def continuous_matrix(loop: Loop, params: LoopParams) -> jax.Array:
    """System matrix of the loop closed by the law (22) in continuous time, shape (states + 1, states + 1).

    The law is u = -k_P sigma + w with w' = -k_I sigma. The integral term w is the last state.

    Args:
        loop: A loop at rest; see :func:`require_continuous`.
        params: Parameters of the loop for a draw.
    """
    a, b, c = open_loop(loop, params)
    law = loop.controller[0].synthesised
    assert law is not None  # require_continuous has checked this before tracing
    proportional_gain, integral_gain = law(params.controller[0])
    closed_loop = a - proportional_gain * jnp.outer(b, c)
    return jnp.block([[closed_loop, b[:, None]], [-integral_gain * c[None, :], jnp.zeros((1, 1))]])


class RestLinearisation(NamedTuple):
    """The linear map of a loop's small deviations from its start, and whether the loop rests there.

    Args:
        matrix: Jacobian of the loop's step from sample to sample, or system matrix in continuous time [1/s],
            shape (states, states).
        displacement: Largest change of a state in one sample; 0 if the loop starts at an equilibrium.
    """

    matrix: jax.Array
    displacement: jax.Array


def start_at_rest(loop: Loop, params: LoopParams) -> jax.Array:
    """The state after the first sample as a vector, shape (states,): the point at which a loop is linearised."""
    vector, _ = ravel_pytree(state_after_first_sample(loop, params))
    return vector


def state_after_first_sample(loop: Loop, params: LoopParams) -> LoopState:
    """The state of a loop after the first sample, in which a controller may behave differently from all others."""
    key = jax.random.key(0)  # a loop at rest has no noise
    state, _ = step(loop, params, key, initial_state(loop, params, key), 0)
    return state


def linearise_at_rest(loop: Loop, params: LoopParams) -> RestLinearisation:
    """Linearise the sampled loop: differentiate the step of the second sample by the state after the first sample.

    Args:
        loop: A loop at rest; see :func:`at_rest`.
        params: Parameters of the loop for a draw.
    """
    key = jax.random.key(0)
    start, unravel = ravel_pytree(state_after_first_sample(loop, params))

    def next_state(state: jax.Array) -> jax.Array:
        """The state one sample after ``state``, both as vectors of shape (states,)."""
        after, _ = step(loop, params, key, unravel(state), 1)  # 1: index of the second sample
        vector, _ = ravel_pytree(after)
        return vector

    displacement = jnp.max(jnp.abs(next_state(start) - start), initial=0.0)
    return RestLinearisation(jax.jacfwd(next_state)(start), displacement)
