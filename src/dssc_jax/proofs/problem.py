"""What is to be proved, in plain numbers: one loop with intervals, from a study and into a certificate's file."""

from dataclasses import asdict, dataclass
from typing import Any

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.registry import Discretisation
from dssc_jax.design.certification import NotCovered, disturbance_bounds, ends_of
from dssc_jax.models.controllers.differentiators import NO_DIFFERENTIATOR
from dssc_jax.models.controllers.dssc import DSSC, SSC, DsscGains, PredictorStart
from dssc_jax.models.controllers.gain_functions import GAIN_FUNCTIONS
from dssc_jax.models.controllers.modulation import ConstantModulation
from dssc_jax.models.controllers.pi import PI, PiGains
from dssc_jax.models.environment import references, sensors
from dssc_jax.models.plants.normal_form import NORMAL_FORM
from dssc_jax.models.unmodelled.lag import LAG, NO_DYNAMICS, Order
from dssc_jax.study import Study
from dssc_jax.study.laws import Law

Interval = tuple[float, float]
UNCERTAIN = ("plant.k_p", "plant.a_p", "unmodelled.mu")
"""Numbers of a loop that a proof covers over an interval."""


@dataclass(frozen=True)
class ProofProblem:
    """A sampled loop of the class (5)-(8) with intervals for its uncertain numbers.

    Args:
        sample_time: T_s [s].
        l0: Error pole [1/s].
        form: Sampled form of DSSC, ``implicit`` or ``conservative``.
        functions: Kind and constants of the state-dependent functions.
        rho: Bound of the switched control [m/s]; None: the command has no bound (PI).
        nominal: a_n, k_n and whether u_n has its term 1/tau_m; None: no nominal control.
        k_p: Interval of the high-frequency gain [1/s].
        a_p: Interval of the damping [1/s].
        zero_a: Characteristic coefficients of the zero dynamics, ascending; empty for order two.
        zero_c: Their output row.
        lag_order: Order of the lag, 0 for none.
        mu: Interval of its time constant [s]; (0, 0) for none.
        level: Bound of |d| [m/s].
        slope: Bound of |d'| [m/s^2].
        initial: Interval of each component of the plant's initial state (y, y', eta).
        matched: Whether the predictor starts at sigma.
    """

    sample_time: float
    l0: float
    form: str
    functions: dict[str, Any]
    rho: float | None
    nominal: tuple[float, float, bool] | None
    k_p: Interval
    a_p: Interval
    zero_a: tuple[float, ...]
    zero_c: tuple[float, ...]
    lag_order: int
    mu: Interval
    level: float
    slope: float
    initial: tuple[Interval, ...]
    matched: bool

    def to_dict(self) -> dict[str, Any]:
        """The problem as JSON's types."""
        return asdict(self)

    @property
    def box(self) -> dict[str, Interval]:
        """The intervals of k_p, a_p and, with a lag, of 1/mu."""
        ends = {"k_p": self.k_p, "a_p": self.a_p}
        return ends | ({"rate": (1.0 / self.mu[1], 1.0 / self.mu[0])} if self.lag_order else {})


def problem_of(study: Study) -> ProofProblem:
    """The problem of a study at its own values; laws of k_p, a_p and mu become the intervals of their support.

    Raises:
        NotCovered: a part of the loop is outside of the class; the message gives the reason.
    """
    loop, ends = study.loop, ends_of(study.without_sweep())
    for name, law in study.laws.items():
        if name not in UNCERTAIN and not name.startswith(("plant.initial", "disturbance.")):
            raise NotCovered(f"{name} is uncertain; a proof takes intervals of {', '.join(UNCERTAIN)} only")
        if not all(abs(end) < float("inf") for end in law.support):
            raise NotCovered(f"the law of {name} has no bounds; give one with bounded support")
    if loop.plant is not NORMAL_FORM:
        raise NotCovered("the plant is not of the class (5)-(8)")
    if loop.reference is not references.ZERO:
        raise NotCovered("the reference is not zero")
    if loop.sensor[0] is not sensors.IDEAL or loop.differentiator[0] is not NO_DIFFERENTIATOR:
        raise NotCovered("sigma is not measured exactly")
    orders = {Order.ONE: 1, Order.TWO: 2}
    order = next((orders[order] for order, member in LAG.members.items() if loop.unmodelled[0] is member), 0)
    if not order and loop.unmodelled[0] is not NO_DYNAMICS:
        raise NotCovered("the unmodelled dynamics are not a lag")
    try:
        disturbance = disturbance_bounds(loop.disturbance[0], ends.part("disturbance", 0))
    except NotCovered:
        raise NotCovered("the disturbance's derivative has no known bound") from None
    if set(disturbance) - {"alpha_d", "alpha_d3"}:
        raise NotCovered("the disturbance depends on the state")
    low, high = ends
    if any(isinstance(value, Law) for value in (low.plant.zero_dynamics or ())):
        raise NotCovered("the zero dynamics are uncertain")
    zero = low.plant.zero_dynamics
    if zero is not None and zero != high.plant.zero_dynamics:
        raise NotCovered("the zero dynamics are uncertain")
    size = 2 + (len(zero.a) if zero else 0)
    starts = [tuple(map(float, end.plant.initial)) + (0.0,) * (size - len(end.plant.initial)) for end in ends]
    return ProofProblem(
        sample_time=loop.sample_time,
        k_p=(float(low.plant.k_p), float(high.plant.k_p)),
        a_p=(float(low.plant.a_p), float(high.plant.a_p)),
        zero_a=tuple(map(float, zero.a)) if zero else (),
        zero_c=tuple(map(float, zero.c)) if zero else (),
        lag_order=order,
        mu=(float(low.unmodelled[0].mu), float(high.unmodelled[0].mu)) if order else (0.0, 0.0),
        level=float(disturbance.get("alpha_d", 0.0)),
        slope=float(disturbance.get("alpha_d3", 0.0)),
        initial=tuple((min(ends), max(ends)) for ends in zip(*starts, strict=True)),
        **controller_of(study),
    )


def controller_of(study: Study) -> dict[str, Any]:
    """The controller's part of a problem.

    Raises:
        NotCovered: the controller, or one of its options, is outside of the class.
    """
    member, gains = study.loop.controller[0], study.template.controller[0]
    nominal = gains.nominal and (float(gains.nominal.a), float(gains.nominal.k), bool(gains.nominal.predictor_term))
    common = {"l0": float(gains.l0), "nominal": nominal}
    if isinstance(gains, PiGains):
        if member is not PI.members[Discretisation.IMPLICIT]:
            raise NotCovered("PI is covered in its implicit form only")
        if not (gains.k_p > 0.0 and gains.k_i > 0.0):
            raise NotCovered("PI needs K_P > 0 and K_I > 0")
        constants = {"k_o": 1.0, "tau_av": 1.0 / gains.k_p, "tau_m": gains.k_p / gains.k_i}
        functions = {"kind": "constant", **constants}
        own = (*common["nominal"][:2], False) if common["nominal"] else None
        return common | {"nominal": own, "form": "implicit", "functions": functions, "rho": None, "matched": False}
    forms = {Discretisation.IMPLICIT, Discretisation.CONSERVATIVE}
    form = next((f for f in forms if member in (DSSC.members[f], SSC.members[f])), None)
    if form is None or not isinstance(gains, DsscGains):
        raise NotCovered("the controller is not DSSC, SSC or PI, in implicit or conservative form")
    if not isinstance(gains.rho, ConstantModulation):
        raise NotCovered("rho is not constant")
    if gains.sign_width is not None:
        raise NotCovered("the sign is smoothed")
    kind = next(kind for kind, entry in GAIN_FUNCTIONS.items() if isinstance(gains.functions, entry.members[None]))
    if kind == "vgsta" and form == Discretisation.CONSERVATIVE:
        raise NotCovered("in the conservative form, functions of Table 1 depend on e between samples")
    if kind == "sta" and form == Discretisation.CONSERVATIVE:
        raise NotCovered("in the conservative form, the slope of the standard STA's phi_1 jumps at its floor")
    constants = {name: float(value) for name, value in gains.functions._asdict().items() if value is not None}
    return common | {
        "form": form.value,
        "functions": {"kind": kind, **constants},
        "rho": float(gains.rho.rho),
        "matched": gains.predictor_start == PredictorStart.MATCHED,
    }


def problem_from(content: dict[str, Any]) -> ProofProblem:
    """A problem from JSON's types.

    Raises:
        ConfigError: a field is missing or unknown.
    """
    try:
        pairs = {name: tuple(content[name]) for name in ("k_p", "a_p", "mu", "zero_a", "zero_c")}
        nominal = content["nominal"] and tuple(content["nominal"])
        initial = tuple(map(tuple, content["initial"]))
        return ProofProblem(**{**content, **pairs, "nominal": nominal, "initial": initial})
    except (KeyError, TypeError) as error:
        raise ConfigError("problem", f"is not that of a certificate: {error}") from None
