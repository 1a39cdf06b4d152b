"""What is known of plant, disturbance, nominal control and reference (A0)-(A4), and the constants that follow."""

from typing import Annotated, Any, NamedTuple, get_type_hints

from dssc_jax.errors import ConfigError
from dssc_jax.types import Quantity
from dssc_jax.zero_dynamics import ZeroDynamics, require_hurwitz

MOST = 1e30  # numbers beyond it, or below its inverse, overflow in products of powers


def known(unit: str, meaning: str) -> Quantity:
    """A non-negative bound; a plain number."""
    return Quantity(unit, meaning, at_least=0.0, law=False)


def positive(unit: str, meaning: str) -> Quantity:
    """A positive number."""
    return Quantity(unit, meaning, above=0.0, law=False)


def require_plain(numbers: Any) -> None:
    """Require that every number is a plain one within its quantity's interval.

    Raises:
        ConfigError: with the field, the rule and the value.
    """
    for name, hint in get_type_hints(type(numbers), include_extras=True).items():
        quantity = next((mark for mark in getattr(hint, "__metadata__", ()) if isinstance(mark, Quantity)), None)
        if quantity is None:
            continue
        value = getattr(numbers, name)
        for item in value if isinstance(value, tuple) else (value,):
            if isinstance(item, bool) or not isinstance(item, int | float) or not abs(item) < MOST:
                raise ConfigError(name, f"must be a plain number below {MOST:.0e}, got {item}")
            if item != 0.0 and abs(item) < 1.0 / MOST:
                raise ConfigError(name, f"must be 0 or at least {1.0 / MOST:.0e} in magnitude, got {item}")
            broken = quantity.violated_by(item, item)
            if broken:
                raise ConfigError(name, f"{quantity.meaning} [{quantity.unit}] {broken}, got {item:g}")


class Bounds(NamedTuple):
    """The bounds of (A0)-(A4) and of the reference."""

    k_min: Annotated[float, positive("1/s", "lower bound of k_p (A0.a)")]
    k_max: Annotated[float, positive("1/s", "upper bound of k_p (A0.a)")]
    a_max: Annotated[float, known("1/s", "bound of |a_p| (A0.a)")]
    k_d1: Annotated[float, known("1/m", "k_d1 of (A1)")] = 0.0
    k_d2: Annotated[float, known("s/m", "k_d2 of (A1)")] = 0.0
    k_d3: Annotated[float, known("1", "k_d3 of (A1)")] = 0.0
    k_d4: Annotated[float, known("1/s", "k_d4 of (A2)")] = 0.0
    k_d5: Annotated[float, known("1/s^2", "k_d5 of (A2)")] = 0.0
    alpha_d2: Annotated[float, known("m/s^2", "alpha_d2 of (A2)")] = 0.0
    alpha_d3: Annotated[float, known("m/s^2", "alpha_d3 of (A3)")] = 0.0
    c_sigma: Annotated[float, known("1", "c_sigma of (A4)")] = 0.0
    c_e1: Annotated[float, known("1/s", "c_e1 of (A4)")] = 0.0
    c_e2: Annotated[float, known("1/s", "c_e2 of (A4)")] = 0.0
    c_isigma: Annotated[float, known("SI", "c_isigma of (A4)")] = 0.0
    c_ie: Annotated[float, known("SI", "c_ie of (A4)")] = 0.0
    y_m: Annotated[float, known("m", "sup |y_m|")] = 0.0
    y_m_dot: Annotated[float, known("m/s", "sup |y_m'|")] = 0.0
    zero_dynamics: ZeroDynamics | None = None

    def prepare(self) -> "Bounds":
        """Check what spans several fields.

        Raises:
            ConfigError: k_min > k_max, or A_eta is not Hurwitz.
        """
        require_plain(self)
        if self.k_min > self.k_max:
            raise ConfigError("k_min", f"must be <= k_max = {self.k_max:g}, got {self.k_min:g}")
        if self.zero_dynamics is not None:
            require_plain(self.zero_dynamics)
            require_hurwitz(self.zero_dynamics)
        return self


class Constants(NamedTuple):
    """What the inequalities of Table 1 are made of; the barred constants at k_max."""

    kd1_bar: float
    kd2_bar: float
    kd3_bar: float
    csigma_bar: float
    k_sigma: float
    c_eta_b_eta: float


def derive(bounds: Bounds, l0: float) -> Constants:
    """The barred constants of (69), with y = e + y_m and y' = -l0 e + sigma + y_m', and k_sigma of (70).

    Args:
        bounds: The bounds.
        l0: Error pole [1/s].
    """
    k_max = bounds.k_max
    c_eta_b_eta = abs(bounds.zero_dynamics.c[-1]) if bounds.zero_dynamics is not None else 0.0
    csigma_bar = k_max * bounds.c_sigma + l0 + bounds.a_max
    reference = bounds.k_d1 * bounds.y_m + bounds.k_d2 * bounds.y_m_dot + bounds.k_d3
    return Constants(
        kd1_bar=k_max * (bounds.k_d1 + l0 * bounds.k_d2),
        kd2_bar=k_max * bounds.k_d2,
        kd3_bar=csigma_bar + k_max * reference,
        csigma_bar=csigma_bar,
        k_sigma=(l0 + bounds.a_max) * l0 + k_max * (bounds.c_e2 + bounds.k_d4) + float(c_eta_b_eta),
        c_eta_b_eta=float(c_eta_b_eta),
    )
