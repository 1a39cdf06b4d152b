"""Check that a user's part does not depend, within a sample, on more than it declares."""

from collections.abc import Callable
from typing import Any

import jax
from jax.interpreters.partial_eval import dce_jaxpr

from dssc_jax.core.contracts import Disturbance, Unmodelled, Variation
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import arithmetic, as_arrays
from dssc_jax.core.signals import Measurement, Params, Scalar
from dssc_jax.study.laws import nominal_params

ANY_NUMBER = 0.5
"""Value of an argument in a trace; the result of the trace does not depend on the value."""


def require_variation(kind: str, model: object, params: Params) -> None:
    """Require that a user's disturbance or unmodelled dynamics depend on no more than they declare.

    A trace of the part's functions shows on which arguments they depend. A part whose code fails passes this check:
    the rehearsal of the loop reports the failure, with the line of code.

    Args:
        kind: Kind of the part in the study, for messages.
        model: The part; parts of all other slots pass.
        params: Parameters of the part, which may contain laws; the check takes their nominal values.

    Raises:
        ConfigError: The part depends on more than it declares.
    """
    problem = None
    numbers = nominal_params(params)
    try:
        with arithmetic():
            if isinstance(model, Disturbance):
                problem = disturbance_problem(model, numbers)
            elif isinstance(model, Unmodelled):
                problem = actuator_problem(model, numbers)
    except Exception:  # a user's code may raise anything
        return
    if problem is not None:
        raise ConfigError("kind", f"'{kind}' {problem}")


def disturbance_problem(model: Disturbance, params: Params) -> str | None:
    """Text on a contradiction between a disturbance and its declared ``variation``; None if there is none."""
    if model.variation == Variation.STATE:  # it may depend on everything
        return None
    state = as_arrays(model.init(params, jax.random.key(0)))

    def value(y: Scalar, y_dot: Scalar, sigma: Scalar, t: Scalar) -> Scalar:
        """Value of the disturbance within a sample, during which the disturbance's own state is constant."""
        return model.value(params, state, Measurement(y, y_dot), sigma, t)

    argument_names = ("y", "y'", "sigma", "t")
    flags = dependences(value, *[ANY_NUMBER] * 4)
    names = [name for name, depends in zip(argument_names, flags, strict=True) if depends]
    if model.variation == Variation.TIME and "t" in names:
        names.remove("t")
    if not names:
        return None
    remedy = "declare Variation.STATE"
    if names == ["t"]:
        remedy = "compute it in `step`, which keeps it in the state, or declare Variation.TIME"
    declared = f"declares variation = Variation.{model.variation.name}"
    return f"{declared}, but its `value` depends on {', '.join(names)} within a sample; {remedy}"


def actuator_problem(model: Unmodelled, params: Params) -> str | None:
    """Text on a contradiction between unmodelled dynamics and their declared ``held``; None if there is none."""
    if not model.held or model.linear is not None or model.advance is not None:
        return None
    state = as_arrays(model.init(params))

    def output_after(dt: Scalar) -> Scalar:
        """Output after a step of integration, for a constant command."""
        return model.output(params, model.step(params, state, ANY_NUMBER, dt), ANY_NUMBER)

    if not any(dependences(output_after, ANY_NUMBER)):
        return None
    return (
        "declares held = True, but its `step` changes the output within a sample; change the state in `sample`, once a "
        "sample, or declare held = False"
    )


def dependences(function: Callable[..., Any], *arguments: float) -> list[bool]:
    """Whether the result of a function depends on each of its arguments, that is, whether a trace uses the argument.

    Args:
        function: The function.
        arguments: Values of the arguments in the trace; only their types matter.
    """
    program = jax.make_jaxpr(function)(*arguments).jaxpr
    is_result_needed = [True] * len(program.outvars)
    _, is_argument_used = dce_jaxpr(program, is_result_needed)
    return is_argument_used
