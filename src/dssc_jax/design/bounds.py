"""Bounds of plant, disturbance, nominal control and reference (A0)-(A4), and the derived constants.

Formulas here and in the rest of the package accept numbers, arrays or traced values.
"""

from functools import cache
from typing import Annotated, NamedTuple, TypeVar, get_type_hints

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.zero_dynamics import ZeroDynamics, require_hurwitz
from dssc_jax.design.arrays import Numeric

LARGEST = 1e30  # numbers beyond it, or below its inverse, overflow in products of powers
DISTURBANCE_FIELDS = ("k_d1", "k_d2", "k_d3", "k_d4", "k_d5", "alpha_d2", "alpha_d3")
"""Names of the fields of :class:`Bounds` that bound the disturbance in (A1)-(A3)."""

Numbers = TypeVar("Numbers", bound=NamedTuple)
"""A NamedTuple of numbers."""


def non_negative(unit: str, meaning: str) -> Quantity:
    """Quantity of a number that must be at least 0, and that no probability law may replace."""
    return Quantity(unit, meaning, at_least=0.0, law=False)


def positive(unit: str, meaning: str) -> Quantity:
    """Quantity of a number that must be above 0, and that no probability law may replace."""
    return Quantity(unit, meaning, above=0.0, law=False)


@cache
def quantities(kind: type) -> dict[str, Quantity]:
    """Unit, meaning and admissible interval of each field of a parameter type, from the field's annotation."""
    quantity_by_name = {}
    for name, hint in get_type_hints(kind, include_extras=True).items():
        for annotation in getattr(hint, "__metadata__", ()):
            if isinstance(annotation, Quantity):
                quantity_by_name.setdefault(name, annotation)
    return quantity_by_name


def in_range(numbers: tuple[Numeric, ...]) -> Numeric:
    """Whether every number is in its admissible interval and below :data:`LARGEST`; for arrays, element by element.

    Args:
        numbers: A NamedTuple whose fields are annotated with quantities.
    """
    holds: Numeric = True
    for name, quantity in quantities(type(numbers)).items():
        value = getattr(numbers, name)
        holds = holds & (abs(value) < LARGEST)
        if quantity.above is not None:
            holds = holds & (value > quantity.above)
        if quantity.at_least is not None:
            holds = holds & (value >= quantity.at_least)
    return holds


def require_plain(numbers: tuple[Numeric, ...]) -> None:
    """Require that every number is plain, in its admissible interval, and neither too large nor too small for float64.

    Args:
        numbers: A NamedTuple whose fields are annotated with quantities; a field may be a tuple of numbers.

    Raises:
        ConfigError: A number breaks one of these rules; the message has the field, the rule and the value.
    """
    for name, quantity in quantities(type(numbers)).items():
        value = getattr(numbers, name)
        items = value if isinstance(value, tuple) else (value,)
        for item in items:
            if isinstance(item, bool) or not isinstance(item, int | float) or not abs(item) < LARGEST:
                raise ConfigError(name, f"must be a plain number below {LARGEST:.0e}, got {item}")
            if item != 0.0 and abs(item) < 1.0 / LARGEST:
                raise ConfigError(name, f"must be 0 or at least {1.0 / LARGEST:.0e} in magnitude, got {item}")
            violation = quantity.violated_by(item, item)
            if violation:
                raise ConfigError(name, f"{quantity.meaning} [{quantity.unit}] {violation}, got {item:g}")


class Bounds(NamedTuple):
    """Bounds of plant (A0), disturbance (A1)-(A3), nominal control (A4) and reference: the premises of Theorem 1.

    ``zero_dynamics`` is None for a plant of order two, which has no zero dynamics.
    """

    k_min: Annotated[Numeric, positive("1/s", "lower bound of k_p (A0.a)")]
    k_max: Annotated[Numeric, positive("1/s", "upper bound of k_p (A0.a)")]
    a_max: Annotated[Numeric, non_negative("1/s", "bound of |a_p| (A0.a)")]
    k_d1: Annotated[Numeric, non_negative("1/m", "k_d1 of (A1)")] = 0.0
    k_d2: Annotated[Numeric, non_negative("s/m", "k_d2 of (A1)")] = 0.0
    k_d3: Annotated[Numeric, non_negative("1", "k_d3 of (A1)")] = 0.0
    k_d4: Annotated[Numeric, non_negative("1/s", "k_d4 of (A2)")] = 0.0
    k_d5: Annotated[Numeric, non_negative("1/s^2", "k_d5 of (A2)")] = 0.0
    alpha_d2: Annotated[Numeric, non_negative("m/s^2", "alpha_d2 of (A2)")] = 0.0
    alpha_d3: Annotated[Numeric, non_negative("m/s^2", "alpha_d3 of (A3)")] = 0.0
    c_sigma: Annotated[Numeric, non_negative("1", "c_sigma of (A4)")] = 0.0
    c_e1: Annotated[Numeric, non_negative("1/s", "c_e1 of (A4)")] = 0.0
    c_e2: Annotated[Numeric, non_negative("1/s", "c_e2 of (A4)")] = 0.0
    c_isigma: Annotated[Numeric, non_negative("SI", "c_isigma of (A4)")] = 0.0
    c_ie: Annotated[Numeric, non_negative("SI", "c_ie of (A4)")] = 0.0
    y_m: Annotated[Numeric, non_negative("m", "sup |y_m|")] = 0.0
    y_m_dot: Annotated[Numeric, non_negative("m/s", "sup |y_m'|")] = 0.0
    y_m_ddot: Annotated[Numeric, non_negative("m/s^2", "sup |y_m''|")] = 0.0
    y_m_dddot: Annotated[Numeric, non_negative("m/s^3", "sup |y_m'''|")] = 0.0
    c_m: Annotated[Numeric, non_negative("m/s", "c_m of (A4), bound of |u_m|")] = 0.0
    u_m_dot: Annotated[Numeric, non_negative("m/s^2", "sup |u_m'|")] = 0.0
    alpha_d: Annotated[Numeric, non_negative("m/s", "bound of |d| (A0.b)")] = 0.0
    zero_dynamics: ZeroDynamics | None = None

    def prepare(self) -> "Bounds":
        """Check every field, and the rules that concern several fields, and return the same bounds.

        Raises:
            ConfigError: A number is out of its range, k_min > k_max, or A_eta is not Hurwitz.
        """
        require_plain(self)
        if self.k_min > self.k_max:
            raise ConfigError("k_min", f"must be <= k_max = {self.k_max:g}, got {self.k_min:g}")
        if self.zero_dynamics is not None:
            try:
                require_plain(self.zero_dynamics)
            except ConfigError as error:
                raise error.within_path("zero_dynamics") from None
            require_hurwitz(self.zero_dynamics)
        return self


class Constants(NamedTuple):
    """The constants in the inequalities of Theorem 1.

    They bound how terms of the loop grow with sigma and e, for every k_p up to k_max.
    """

    kd1_bar: Annotated[Numeric, Quantity("1/(m s)", "bound of |beta_1/sigma| growing with |e| (69)")]
    kd2_bar: Annotated[Numeric, Quantity("1/m", "bound of |beta_1/sigma| growing with |sigma| (69)")]
    kd3_bar: Annotated[Numeric, Quantity("1/s", "constant part of the bound of |beta_1/sigma| (69)")]
    csigma_bar: Annotated[Numeric, Quantity("1/s", "bound of |k_p u_d + (l_0 - a_p) sigma|/|sigma| (69)")]
    k_sigma: Annotated[Numeric, Quantity("1/s^2", "constant part of the bound of |beta_2/sigma| (72)")]
    kappa_e: Annotated[Numeric, Quantity("1/s^3", "bound of beta_e growing with |e| (71), derived")]
    kappa_e_printed: Annotated[Numeric, Quantity("1/s^3", "bound of beta_e growing with |e| (71), as printed")]
    c_eta_a_eta: Annotated[Numeric, Quantity("SI", "|C_eta A_eta| (71)")]
    c_eta_b_eta: Annotated[Numeric, Quantity("SI", "|C_eta B_eta| (72)")]
    beta_m: Annotated[Numeric, Quantity("m/s^3", "bound of beta_m, and of the constant rest of beta_e (70), (71)")]
    beta_m_printed: Annotated[Numeric, Quantity("m/s^3", "beta_m term by term as printed, lost dots restored")]


def derive(bounds: Bounds, l0: Numeric) -> Constants:
    """Compute the constants of Appendix E, with y = e + y_m and y' = -l0 e + sigma + y_m' inserted.

    Two constants differ from those of the article. kappa_e follows from the derivative of (64), where the article
    misplaces a factor l0 and omits k_p on du_p/de. In beta_m, the term l0 y_m'' of sigma_m'' cancels that of
    (l0 - a_p) y_m''; the article keeps both.

    Args:
        bounds: Bounds of plant, disturbance, nominal control and reference.
        l0: Error pole [1/s].

    Example:
        >>> derive(Bounds(k_min=0.9, k_max=1.1, a_max=1.0, k_d4=0.1), l0=0.5).k_sigma
        0.86
    """
    b = bounds
    k_max = bounds.k_max
    c_eta_a_eta, c_eta_b_eta = coupling(b.zero_dynamics)
    csigma_bar = k_max * b.c_sigma + l0 + b.a_max
    k_sigma = (l0 + b.a_max) * l0 + k_max * (b.c_e2 + b.k_d4) + c_eta_b_eta
    printed = (l0 + b.a_max) * l0 + b.c_e2 + k_max * l0 * b.k_d4 + c_eta_b_eta  # k_sigma in the article's kappa_e
    # beta_m: the terms that do not grow with sigma and e
    exogenous = k_max * (b.u_m_dot + b.k_d5 * b.y_m + b.alpha_d2 + b.alpha_d3)
    steady = exogenous + (k_max * b.k_d4 + c_eta_b_eta) * b.y_m_dot + b.y_m_dddot  # all terms but that of y_m''
    return Constants(
        kd1_bar=k_max * (b.k_d1 + l0 * b.k_d2),
        kd2_bar=k_max * b.k_d2,
        kd3_bar=csigma_bar + k_max * (b.k_d1 * b.y_m + b.k_d2 * b.y_m_dot + b.k_d3),
        csigma_bar=csigma_bar,
        k_sigma=k_sigma,
        kappa_e=l0 * k_sigma + k_max * b.k_d5,
        kappa_e_printed=l0 * printed + k_max * b.k_d5,
        c_eta_a_eta=c_eta_a_eta,
        c_eta_b_eta=c_eta_b_eta,
        beta_m=steady + b.a_max * b.y_m_ddot,
        beta_m_printed=steady + (2.0 * l0 + b.a_max) * b.y_m_ddot,
    )


def coupling(dynamics: ZeroDynamics | None) -> tuple[float, float]:
    """The norms |C_eta A_eta| and |C_eta B_eta|, the size of the effect of the zero dynamics on the output.

    A_eta has companion form with the last row -a, and B_eta = (0, ..., 0, 1). Both norms are 0 for a plant of order
    two, which has no zero dynamics.
    """
    if dynamics is None:
        return 0.0, 0.0
    a, c = dynamics  # last row of -A_eta, and C_eta
    shifted_c = [0.0, *c[:-1]]  # the ones of A_eta above its diagonal shift C_eta by one place
    c_a = [shifted - c[-1] * coefficient for shifted, coefficient in zip(shifted_c, a, strict=True)]
    return float(sum(x * x for x in c_a) ** 0.5), float(abs(c[-1]))
