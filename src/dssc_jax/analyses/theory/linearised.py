"""Linearise the loop at the origin: in continuous time part by part, in sampled time by differentiating its step."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from dssc_jax.closed_loop.sample import Loop, LoopParams, initial_state, step
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.signals import PlantInput, ReferencePoint, Scalar, tracking_error
from dssc_jax.models.controllers.nominal import nominal_control
from dssc_jax.study import Study

SET_VALUED = ("sta", "vgsta", "smc")  # their gain at the origin is infinite
CONTINUOUS = ("none", "lag", "transfer_function", "saturation")  # unmodelled dynamics with a continuous-time form
SMOOTH = ("dssc", "ssc", "pi")
ORIGIN = ReferencePoint(0.0, 0.0, 0.0)
QUIET = PlantInput(0.0, 0.0)


class Linearised(NamedTuple):
    """x' = A x + B u, sigma = C x: plant, nominal control and unmodelled dynamics, from the robust command to sigma."""

    a: jax.Array
    b: jax.Array
    c: jax.Array


def at_rest(study: Study) -> Study:
    """The study without inputs: no reference, no disturbance, and the plant's state at zero.

    Raises:
        ConfigError: the plant has several channels.
    """
    if len(study.loop.channels) > 1:
        raise ConfigError(f"{study.source}: plant.kind", "the origin is that of a plant of one channel")
    changes: dict[str, Any] = {"reference": {"kind": "zero"}, "disturbance": {"kind": "none"}, "sweep": {}}
    if "initial" in study.table["plant"]:
        changes["plant.initial"] = [0.0, 0.0]
    return study.override(changes)


def kind_of(study: Study, slot: str) -> str:
    """The kind of the part in a slot."""
    return str(getattr(study.config, slot)["kind"])


def require_smooth(study: Study) -> None:
    """Require a controller that has a linearisation at the origin.

    Raises:
        ConfigError: the controller switches there.
    """
    kind = kind_of(study, "controller")
    explicit = kind in ("dssc", "ssc") and study.config.controller.get("discretisation") == "explicit"
    if kind in SET_VALUED or explicit:
        law = f"the explicit form of {kind}" if explicit else kind
        raise ConfigError(
            f"{study.source}: controller.kind", f"{law} switches at the origin and has no linearisation there"
        )


def open_loop(study: Study, params: LoopParams) -> Linearised:
    """Plant, nominal control and unmodelled dynamics between the robust command and sigma, at the origin.

    The slope of the unmodelled state is the initial slope of its exact step.

    Args:
        study: A study at rest.
        params: Its parameters for one draw.

    Raises:
        ConfigError: the unmodelled dynamics have no continuous-time form.
    """
    kind = kind_of(study, "unmodelled")
    if kind not in CONTINUOUS:
        known = ", ".join(CONTINUOUS)
        raise ConfigError(
            f"{study.source}: unmodelled.kind",
            f"the continuous-time analysis covers {known}, got '{kind}'; use the sampled loop",
        )
    loop, gains = study.loop, params.controller[0]
    model, dynamics = loop.unmodelled[0], params.unmodelled[0]
    rest, unravel = ravel_pytree(loop.plant.init(params.plant))
    order = len(model.init(dynamics))

    def sigma_of(x: jax.Array) -> Scalar:
        return tracking_error(loop.plant.measure(params.plant, unravel(x), QUIET), ORIGIN, gains.l0).sigma

    def derivative(state: jax.Array, u: Scalar) -> jax.Array:
        x, z = state[: rest.size], tuple(state[rest.size :])
        error = tracking_error(loop.plant.measure(params.plant, unravel(x), QUIET), ORIGIN, gains.l0)
        total = u + nominal_control(gains.nominal, gains.l0, error, ORIGIN, predictor_pole_at_rest(gains))
        _, slope = jax.jvp(lambda dt: model.step(dynamics, z, total, dt), (0.0,), (1.0,))
        reaching = model.output(dynamics, z, total)
        rate = loop.plant.derivative(params.plant, unravel(x), PlantInput(reaching, 0.0), 0.0)
        return jnp.concatenate([ravel_pytree(rate)[0], jnp.array(slope)])

    origin = jnp.zeros(rest.size + order)
    a, b = jax.jacfwd(derivative, argnums=(0, 1))(origin, 0.0)
    c = jax.grad(lambda state: sigma_of(state[: rest.size]))(origin)
    return Linearised(a, b, c)


def predictor_pole_at_rest(gains: Any) -> Scalar:
    """1/tau_m at the origin [1/s]; 0 for a controller without a predictor."""
    return 1.0 / gains.functions.at(0.0, 0.0, gains.l0).tau_m if hasattr(gains, "functions") else 0.0


def synthesised_gains(gains: Any) -> tuple[Scalar, Scalar]:
    """K_P and K_I of the law that (22) synthesises at the origin: u = -K_P sigma - K_I int sigma.

    Args:
        gains: Those of DSSC or SSC, K_P = 1/(k_o tau_av) and K_I = K_P/tau_m, or of PI.
    """
    if not hasattr(gains, "functions"):
        return gains.k_p, gains.k_i
    at = gains.functions.at(0.0, 0.0, gains.l0)
    proportional = 1.0 / (at.k_o * at.tau_av)
    return proportional, proportional / at.tau_m


def continuous_matrix(study: Study, params: LoopParams) -> jax.Array:
    """The loop closed by the synthesised law (22), in continuous time; the last state is the integral term of u."""
    a, b, c = open_loop(study, params)
    proportional, integral = synthesised_gains(params.controller[0])
    closed = a - proportional * jnp.outer(b, c)
    return jnp.block([[closed, b[:, None]], [-integral * c[None, :], jnp.zeros((1, 1))]])


def sampled_matrix(loop: Loop, params: LoopParams) -> tuple[jax.Array, jax.Array]:
    """The derivative of the loop's step at its start, and the state's change in that step: 0 at an equilibrium."""
    key = jax.random.key(0)
    rest, unravel = ravel_pytree(initial_state(loop, params, key))

    def after(state: jax.Array) -> jax.Array:
        return ravel_pytree(step(loop, params, key, unravel(state), 1)[0])[0]

    return jax.jacfwd(after)(rest), jnp.max(jnp.abs(after(rest) - rest), initial=0.0)
