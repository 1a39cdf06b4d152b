"""The certificate of a design by Theorem 1: its inequalities with their slacks, and the guarantee that follows."""

from typing import NamedTuple

from dssc_jax.core.json_types import JsonObject
from dssc_jax.design.arrays import Numeric
from dssc_jax.design.bounds import Bounds, Constants, Numbers, derive, in_range, require_plain
from dssc_jax.design.lyapunov import eigenvalues_of_p, functions_are_positive, q_is_positive, smallest_q_on_grid
from dssc_jax.design.practice import Practice, practice
from dssc_jax.design.small_gain import NOTHING, Guarantee, SmallGain, guarantee, small_gain, small_gain_holds
from dssc_jax.design.table1 import Inequality, InequalityState, Parameters, inequalities


class Lyapunov(NamedTuple):
    """Eigenvalues of the Lyapunov matrices P (53) and Q - 2 eps I (54), and what is proved about them.

    Args:
        p_smallest: Smallest eigenvalue of P over the interval of k_p; NaN where P is not positive definite.
        q_smallest: Smallest eigenvalue of Q - 2 eps I that a search over sigma, e, alpha_1, alpha_2 and k_p found.
        q_proved: Whether Q - 2 eps I > 0 is proved for all sigma, e, alpha_1, alpha_2 and k_p.
        functions_proved: Whether k_o tau_av > 0 and tau_m > 0 are proved for all sigma and e.
    """

    p_smallest: float
    q_smallest: float
    q_proved: bool
    functions_proved: bool


class Certificate(NamedTuple):
    """The results of checking a design under its bounds by Theorem 1.

    Args:
        inequalities: The inequalities of Table 1, row by row.
        constants: The constants in the inequalities.
        lyapunov: Results for P, Q - 2 eps I and the functions.
        small_gain: The smallest phi_b of the small-gain condition, by three formulas.
        phi_b: The phi_b of the design.
        guarantee: Decay rate and residual sets; the rate is 0 and the sets are infinite if Q or the small gain is not
            proved.
        practice: Sampling period that the design needs, and bounds that its modulation must dominate.
        interconnected: Whether the derived small-gain condition holds.
    """

    inequalities: tuple[Inequality, ...]
    constants: Constants
    lyapunov: Lyapunov
    small_gain: SmallGain
    phi_b: float
    guarantee: Guarantee
    practice: Practice
    interconnected: bool

    @property
    def table(self) -> bool:
        """Whether every inequality of Table 1 is strictly satisfied."""
        return all(inequality.state is InequalityState.SATISFIED for inequality in self.inequalities)

    @property
    def certified(self) -> bool:
        """Whether Theorem 1 holds: Table 1 strictly, and phi_b above the derived small-gain bound."""
        return self.table and self.interconnected

    def to_dict(self) -> JsonObject:
        """The certificate in the types of JSON, except that NaN and infinity are not yet replaced."""
        rows = [
            {
                "name": row.name,
                "equation": row.equation,
                "value": row.value,
                "bound": row.bound,
                "slack": row.slack,
                "state": row.state.value,
                "printed_slack": row.printed_slack,
            }
            for row in self.inequalities
        ]
        small_gain_rows = {}
        for formula, bound in self.small_gain._asdict().items():
            small_gain_rows[f"{formula}_phi_b"] = {"bound": bound, "slack": self.phi_b - bound}
        return {
            "inequalities": rows,
            "certified": self.certified,
            "table": self.table,
            "small_gain": small_gain_rows,
            "lyapunov": self.lyapunov._asdict(),
            "guarantee": self.guarantee._asdict(),
            "practice": self.practice._asdict(),
            "constants": self.constants._asdict(),
        }


def check(parameters: Parameters, bounds: Bounds) -> Certificate:
    """Check a design under its bounds, over the whole interval of k_p.

    Args:
        parameters: The parameters, plain numbers.
        bounds: Bounds of plant, disturbance, nominal control and reference.

    Returns:
        The certificate: each inequality with its slack, as derived and as printed, and the resulting guarantee.

    Raises:
        ConfigError: A number is out of its range, or the bounds contradict themselves.

    Example:
        >>> bounds = Bounds(k_min=0.9, k_max=1.1, a_max=1.0, alpha_d3=0.1)
        >>> parameters = Parameters(
        ...     l0=0.5, phi_a=0.1, phi_b=8.0, delta=0.5, eps=0.3, gamma=3.5,
        ...     kappa_a=0.5, kappa_b=0.1, kappa_c=4.0, kappa_d=1.0,
        ... )
        >>> certificate = check(parameters, bounds)
        >>> certificate.certified, round(certificate.guarantee.e, 4)
        (True, 0.076)
    """
    require_plain(parameters)
    bounds = bounds.prepare()
    p = parameters
    is_q_proved = bool(q_is_positive(p, bounds))
    is_small_gain_proved = bool(small_gain_holds(p, bounds))
    proved_guarantee = guarantee(p, bounds) if is_q_proved and is_small_gain_proved else NOTHING
    lyapunov = Lyapunov(
        p_smallest=float(eigenvalues_of_p(bounds.k_min, p.eps, p.gamma).low),
        q_smallest=smallest_q_on_grid(p, bounds),
        q_proved=is_q_proved,
        functions_proved=bool(functions_are_positive(p)),
    )
    return Certificate(
        inequalities=tuple(as_floats(row) for row in inequalities(p, bounds)),
        constants=as_floats(derive(bounds, p.l0)),
        lyapunov=lyapunov,
        small_gain=as_floats(small_gain(p, bounds)),
        phi_b=p.phi_b,
        guarantee=as_floats(proved_guarantee),
        practice=as_floats(practice(p, bounds, proved_guarantee)),
        interconnected=is_small_gain_proved,
    )


def as_floats(numbers: Numbers) -> Numbers:
    """Replace every number, or array of one element, in a NamedTuple by a plain float; text stays."""
    values = {}
    for name, value in numbers._asdict().items():
        values[name] = value if isinstance(value, str) else float(value)
    return numbers._replace(**values)


def certified(parameters: Parameters, bounds: Bounds) -> Numeric:
    """Whether Theorem 1 holds, for many designs at once, by the rule of :attr:`Certificate.certified`.

    Args:
        parameters: Parameters of the designs: numbers, NumPy arrays or traced values with shapes that broadcast. Arrays
            of JAX must be float64.
        bounds: Bounds of the designs, in the same forms; the zero dynamics must be plain numbers.

    Returns:
        True or False for each design; False where a number is out of its range.
    """
    p = parameters
    holds = in_range(p) & in_range(bounds) & (bounds.k_min <= bounds.k_max) & small_gain_holds(p, bounds)
    for row in inequalities(p, bounds):
        holds = holds & row.satisfied
    return holds
