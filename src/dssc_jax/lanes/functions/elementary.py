"""Elementary functions as arithmetic, so that every machine and every width of vectors computes the same bits.

These are ordinary functions of JAX arrays. The translator traces each of them in place of JAX's primitive of the same
name. Over the whole range of float64 and float32, subnormal numbers included, results are within a few units in the
last place of the exact value; docs/lanes.md has the numbers. Infinities, NaN and the sign of zero follow C99.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import JaxprEqn

from dssc_jax.lanes.functions import circular, exponentials
from dssc_jax.lanes.functions.approximations import atan, atan2, polynomial
from dssc_jax.lanes.functions.exponentials import is_negative, logarithm, mantissa, width
from dssc_jax.lanes.functions.powers import power
from dssc_jax.lanes.tracing.specification import REAL, WHOLE, Specification, TranslationRule, array_type, no_value, rule

INVERSE_ERROR = {
    64: (
        (
            3.240704459379902e-21, -1.113483769832702e-21, -3.4996044354754177e-19, 1.150022252066253e-18,
            1.5574320246233251e-17, -1.3016928016796445e-16, -4.0282154327661744e-17, 6.5964077124208341e-15,
            -4.0012377350918961e-14, -8.1183994430743526e-14, 2.6304834740560442e-12, -1.2976885526532075e-11,
            -5.414287198084716e-11, 1.0512181539804126e-09, -4.1126608200232397e-09, -2.9070382262927266e-08,
            4.2347881737823391e-07, -1.3654691850603575e-06, -1.3882523394405316e-05, 0.00018673420802464837,
            -0.00074070253415447704, -0.0060336708714278497, 0.24015818242558831, 1.6536545626831027,
        ),
        (
            -1.5102695423335065e-08, 6.9692419776296945e-10, 1.3104351499972014e-07, -2.7134511054394561e-07,
            -2.7004219280868947e-08, 1.4987130784186127e-06, -3.986084395214756e-06, 2.9257291901789823e-06,
            1.2465167157087251e-05, -4.7318984120112452e-05, 6.8287086547533766e-05, 2.4031257015092525e-05,
            -0.00035503780975963814, 0.00095328936374356377, -0.0016882755357337071, 0.0024914420969817607,
            -0.003751208508215561, 0.0053709145535716799, 1.0052589676941652, 3.0838856104922208,
        ),
        (
            2.7520836691204922e-11, -2.2467591693364952e-11, -3.7171553416167463e-10, 1.4895546197648137e-09,
            -3.5875995609819953e-09, 7.6443359835573965e-09, -1.5146221782627176e-08, 2.9124399186491765e-08,
            -6.761414811460412e-08, 2.2901554497563463e-07, -9.9301191834829539e-07, 4.5260599477720725e-06,
            -1.9681773483763821e-05, 7.5995277351601924e-05, -0.00021503011962944126, -0.00013871931835112341,
            1.0103004648645413, 4.8499064014085844,
        ),
    ),
    32: (
        (
            -8.931925970244222e-09, 2.3335967195708108e-08, 4.6813134805534123e-07, -3.4639852676333717e-06,
            -4.9724196894547514e-06, 0.00021834938623976644, -0.0012527263917732291, -0.0041773928752031489,
            0.24664027905463662, 1.5014093604503289,
        ),
        (
            9.4318286945379432e-05, -0.00028383382080894755, -2.9263578703979435e-05, 0.0014519277163066668,
            -0.0036101715202431378, 0.0057004171379147631, -0.0076347339589097592, 0.0094435543259884531,
            1.0016747999742759, 2.8329768349758204,
        ),
    ),
}  # fmt: skip
"""Coefficients of erfinv(x)/x, highest power first, for each range of w = -ln(1 - x^2), by the bits of a number.

In the first range, near x = 0, they multiply powers of w - c; in the others, the tails, powers of w^(1/2) - c. They
interpolate values of 50 digits at Chebyshev's nodes."""

INVERSE_ERROR_RANGES = {64: ((6.25, 3.125), (16.0, 3.25), (math.inf, 5.0)), 32: ((5.0, 2.5), (math.inf, 3.0))}
"""End of each range of w, and the centre c of its polynomial, by the bits of a number."""

SIDES = {
    64: ((2.0**1000, 2.0**-60), (2.0**-900, 2.0**200)),
    32: ((2.0**100, 2.0**-24), (2.0**-80, 2.0**60)),
}
"""Sides that :func:`angle` scales: ((the largest it does not scale, the factor of larger sides), (the smallest it does
not scale, the factor of smaller sides)), by the bits of a number."""


def erf_inv(x: jax.Array) -> jax.Array:
    """Return the inverse of the error function at x between the tails, where :func:`is_in_tail` is false.

    The result is x times a polynomial in w = -ln(1 - x^2), as in M. Giles, "Approximating the erfinv function", GPU
    Computing Gems, Jade Edition (2012).
    """
    _, centre = INVERSE_ERROR_RANGES[width(x)][0]  # near 0
    coefficients = INVERSE_ERROR[width(x)][0]
    w = one_minus_square_logarithm(x)
    return x * jnp.asarray(polynomial(coefficients, w - centre))


def is_in_tail(x: jax.Array) -> jax.Array:
    """Whether x lies in a tail of the inverse error function, so w = -ln(1 - x^2) is large, or is NaN.

    About 0.2 % of the numbers of a uniform distribution in (-1, 1) lie in a tail.
    """
    end, _ = INVERSE_ERROR_RANGES[width(x)][0]
    is_between_tails = one_minus_square(x) > math.exp(-end)  # w < end; false for NaN
    return ~is_between_tails


def tail_erf_inv(x: jax.Array) -> jax.Array:
    """Return the inverse of the error function at x in a tail; infinite at -1 and 1, and NaN for |x| > 1."""
    tail_coefficients = INVERSE_ERROR[width(x)][1:]
    tail_ranges = INVERSE_ERROR_RANGES[width(x)][1:]
    w = one_minus_square_logarithm(x)
    root = jnp.sqrt(w)
    _, centre = tail_ranges[-1]
    value = jnp.asarray(polynomial(tail_coefficients[-1], root - centre))
    inner_tails = list(zip(tail_coefficients[:-1], tail_ranges[:-1], strict=True))
    for coefficients, (end, centre) in reversed(inner_tails):
        value = jnp.where(w < end, polynomial(coefficients, root - centre), value)
    y = one_minus_square(x)
    return x * jnp.where(y > 0.0, value, jnp.where(y == 0.0, jnp.inf, jnp.nan))


def one_minus_square_logarithm(x: jax.Array) -> jax.Array:
    """Return w = -ln(1 - x^2). The quotient erfinv(x)/x is a smooth function of w."""
    fraction, k = mantissa(one_minus_square(x))
    return -logarithm(fraction - 1.0, jnp.zeros_like(x), k)


def asin(x: jax.Array) -> jax.Array:
    """Return the arc sine [rad] in [-pi/2, pi/2]; NaN for |x| > 1.

    Its magnitude is the angle of the vector ((1 - x^2)^(1/2), |x|).
    """
    size = jnp.abs(x)
    value = jnp.asarray(atan2(size, jnp.sqrt((1.0 - size) * (1.0 + size))))
    return jnp.where(is_negative(x), -value, value)


def acos(x: jax.Array) -> jax.Array:
    """Return the arc cosine [rad] in [0, pi], the angle of the vector (x, (1 - x^2)^(1/2)); NaN for |x| > 1."""
    return jnp.asarray(atan2(jnp.sqrt((1.0 - x) * (1.0 + x)), x))


def arc_tangent(x: jax.Array) -> jax.Array:
    """Return the arctangent [rad] in [-pi/2, pi/2]; at -0 the result is -0, unlike that of :func:`atan`."""
    value = jnp.asarray(atan(jnp.abs(x)))
    return jnp.where(is_negative(x), -value, value)


def angle(y: jax.Array, x: jax.Array) -> jax.Array:
    """Return the angle of the vector (x, y) [rad] in [-pi, pi], with C99's values for zeros and infinities.

    Both sides are scaled by one factor if they are so long that their sum would overflow, or so short that digits would
    be lost.
    """
    longer_side = jnp.maximum(jnp.abs(x), jnp.abs(y))
    (largest, factor_if_larger), (smallest, factor_if_smaller) = SIDES[width(x)]
    is_too_long = longer_side > largest
    is_too_short = longer_side < smallest
    scale = jnp.where(is_too_long, factor_if_larger, jnp.where(is_too_short, factor_if_smaller, 1.0))
    is_diagonal = jnp.isinf(x) & jnp.isinf(y)
    height = jnp.abs(y) * scale
    base = x * scale
    magnitude = atan2(jnp.where(is_diagonal, 1.0, height), jnp.where(is_diagonal, jnp.sign(x), base))
    magnitude = jnp.where((x == 0.0) & (y == 0.0) & is_negative(x), math.pi, magnitude)
    return jnp.where(is_negative(y), -magnitude, magnitude)


def one_minus_square(x: jax.Array) -> jax.Array:
    """Return 1 - x^2 as (1 + x)(1 - x), which does not cancel near |x| = 1."""
    return (1.0 + x) * (1.0 - x)


@dataclass(frozen=True)
class RareRule(TranslationRule):
    """A translation rule with a second function, for arguments that few lanes have.

    Args:
        is_rare: ``(*arguments) -> bool``: whether a lane's arguments need the second function.
        rarely: The second function of the same arguments. It becomes a subroutine, which is called only if at least
            one lane of a vector needs it.
    """

    is_rare: Callable[..., Any]
    rarely: Callable[..., Any]


def accuracy_rule(function: Callable[..., Any]) -> TranslationRule:
    """Return the rule of a function whose primitive has a parameter ``accuracy``, of which only None is translated."""
    return rule(function, REAL, accuracy=no_value)


def refuse_integer_base(equation: JaxprEqn) -> str | None:
    """Return the reason why a power is not translated, or None if it is translated.

    The base must be a floating-point number, while the exponent may be an integer.
    """
    base = equation.invars[0]
    return None if np.dtype(array_type(base).dtype) in REAL else "a power of an integer"


def circular_rule(usually: Callable[..., Any], rarely: Callable[..., Any]) -> RareRule:
    """Return the rule of a circular function.

    Args:
        usually: The function for angles of few turns.
        rarely: The function for angles that :func:`circular.is_far` finds to have many turns.
    """
    return RareRule(usually, Specification(REAL, {"accuracy": no_value}), circular.is_far, rarely)


ELEMENTARY: dict[str, TranslationRule] = {
    "sin": circular_rule(circular.sin, circular.far_sin),
    "cos": circular_rule(circular.cos, circular.far_cos),
    "tan": circular_rule(circular.tan, circular.far_tan),
    "exp": accuracy_rule(exponentials.exp),
    "exp2": accuracy_rule(exponentials.exp2),
    "expm1": accuracy_rule(exponentials.expm1),
    "log": accuracy_rule(exponentials.log),
    "log2": accuracy_rule(exponentials.log2),
    "log1p": accuracy_rule(exponentials.log1p),
    "tanh": accuracy_rule(exponentials.tanh),
    "logistic": accuracy_rule(exponentials.logistic),
    "sinh": rule(exponentials.sinh, REAL),
    "cosh": rule(exponentials.cosh, REAL),
    "asin": rule(asin, REAL),
    "acos": rule(acos, REAL),
    "atan": rule(arc_tangent, REAL),
    "atan2": rule(angle, REAL),
    "erf_inv": RareRule(erf_inv, Specification(REAL), is_in_tail, tail_erf_inv),
    "one_minus_square": rule(one_minus_square, REAL),
    "pow": TranslationRule(power, Specification(REAL | WHOLE, exact=refuse_integer_base)),
}
"""The rule of each function by its primitive's name. A new function needs its definition above and a row here."""
