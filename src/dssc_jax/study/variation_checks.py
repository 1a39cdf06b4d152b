"""Whether a user's part varies within a sample although it declares that it does not."""

from collections.abc import Callable
from typing import Any

import jax
from jax.interpreters.partial_eval import dce_jaxpr

from dssc_jax.core.contracts import Disturbance, Unmodelled, Variation
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import arithmetic, as_arrays
from dssc_jax.core.signals import Measurement, Params, Scalar
from dssc_jax.study.laws import UncertainValue


def require_variation(kind: str, model: object, params: Params) -> None:
    """Require that a user's disturbance or unmodelled dynamics depend on no more than they declare.

    What depends on what follows from a trace. A part whose code fails is left to the rehearsal, which names the line.

    Args:
        kind: Kind of the part in the study.
        model: The part; all others than disturbances and unmodelled dynamics pass.
        params: Its parameters; uncertain numbers have their nominal values.

    Raises:
        ConfigError: The part depends on more.
    """
    problem = None
    numbers = jax.tree.map(lambda leaf: leaf.nominal if isinstance(leaf, UncertainValue) else leaf, params)
    try:
        with arithmetic():
            if isinstance(model, Disturbance):
                problem = disturbance_problem(model, numbers)
            elif isinstance(model, Unmodelled):
                problem = actuator_problem(model, numbers)
    except Exception:  # user code may raise anything
        return
    if problem is not None:
        raise ConfigError("kind", f"'{kind}' {problem}")


def disturbance_problem(model: Disturbance, params: Params) -> str | None:
    """What contradicts the ``variation`` of a disturbance; None: nothing does."""
    if model.variation == Variation.STATE:
        return None
    state = as_arrays(model.init(params, jax.random.key(0)))

    def value(y: Scalar, y_dot: Scalar, sigma: Scalar, t: Scalar) -> Scalar:
        return model.value(params, state, Measurement(y, y_dot), sigma, t)

    flags = dependences(value, 0.5, 0.5, 0.5, 0.5)
    names = [name for name, flag in zip(("y", "y'", "sigma", "t"), flags, strict=True) if flag]
    if model.variation == Variation.TIME:
        names = [name for name in names if name != "t"]
    if not names:
        return None
    remedy = "declare Variation.STATE"
    if names == ["t"]:
        remedy = "compute it in `step`, which keeps it in the state, or declare Variation.TIME"
    declared = f"declares variation = Variation.{model.variation.name}"
    return f"{declared}, but its `value` depends on {', '.join(names)} within a sample; {remedy}"


def actuator_problem(model: Unmodelled, params: Params) -> str | None:
    """What contradicts ``held`` of unmodelled dynamics; None: nothing does."""
    if not model.held or model.linear is not None or model.advance is not None:
        return None
    state = as_arrays(model.init(params))

    def output_after(dt: Scalar) -> Scalar:
        return model.output(params, model.step(params, state, 0.5, dt), 0.5)

    if not any(dependences(output_after, 0.01)):
        return None
    return (
        "declares held = True, but its `step` changes the output within a sample; change the state in `sample`, once a "
        "sample, or declare held = False"
    )


def dependences(function: Callable[..., Any], *arguments: float) -> list[bool]:
    """Whether the result of a function depends on each of its arguments, by a trace at these values."""
    program = jax.make_jaxpr(function)(*arguments).jaxpr
    return dce_jaxpr(program, [True] * len(program.outvars))[1]
