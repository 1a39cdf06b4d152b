"""Certification of a study's loop by Theorem 1 at every point of its sweep.

The bounds (A0)-(A4) follow from the study: the interval of k_p and a_p from their laws, the disturbance's constants
from its kind, those of the reference and of the nominal control from theirs. The certificate is that of the loop in
continuous time, without unmodelled dynamics and sensors, and with a rho that maintains sliding. The simulation covers
everything else in the study.
"""

import math
from typing import Any, NamedTuple

import jax
import numpy as np

from dssc_jax.closed_loop.loop import Loop
from dssc_jax.core.contracts import Disturbance, Plant, Reference
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.normal_form import NormalForm, RealisedSystem, normal_form, transfer_function
from dssc_jax.core.zero_dynamics import ZeroDynamics
from dssc_jax.design import Bounds, Parameters, certified
from dssc_jax.design.arrays import Numeric, greater
from dssc_jax.design.ends import Ends, ends_of
from dssc_jax.design.practice import predictor_pole
from dssc_jax.models.controllers.dssc import DSSC
from dssc_jax.models.controllers.gain_functions import Vgsta
from dssc_jax.models.disturbances import NO_DISTURBANCE
from dssc_jax.models.disturbances.partition import PARTITION
from dssc_jax.models.disturbances.prescribed import CONSTANT, SINE_DISTURBANCE, SPLINE, STEP
from dssc_jax.models.plants.linear import RATIONAL_PLANT, STATE_SPACE
from dssc_jax.models.plants.normal_form import NORMAL_FORM
from dssc_jax.models.references import ZERO
from dssc_jax.models.references.sine import MISSION, MISSION_ENTRY, SINE
from dssc_jax.study import Described, Study
from dssc_jax.study.actuators import tables_of
from dssc_jax.study.laws import SPREAD

OUTSIDE = {
    "loop": "it is of continuous time",
    "sensor": "it takes y and y' as they are",
    "differentiator": "it takes y' as it is",
    "controller.rho": "it takes sliding for granted",
}
"""Numbers that the theorem does not cover, with the reason."""
ACTUATION = ("unmodelled", "actuator")
"""Sections of the study file with the unmodelled dynamics."""
LIMITS = ("rate", "limit")  # of unmodelled dynamics whose absence is an infinite number
OTHER_FUNCTIONS = "the controller is not DSSC with functions.kind = 'vgsta', those of Table 1"
REFINEMENTS = 2  # of the walk's cell in which the certificate is lost
REFINED = 33  # points of a refined cell, so that two refinements reach 1/1024 of it


class NotCovered(Exception):
    """The theorem does not cover this loop; the message gives the reason."""


class Mark(NamedTuple):
    """The theorem's result for a study.

    Args:
        certified: True or False for each point, with the shape of the sweep's axes; None if it does not apply.
        reason: Why it does not apply; empty if it applies.
    """

    certified: np.ndarray | None
    reason: str


class Reach(NamedTuple):
    """How far the theorem certifies a loop as one of its numbers varies.

    Args:
        value: The last certified value, for all draws at once; None if there is none.
        text: The theorem's result for the number, in words.
    """

    value: float | None
    text: str


class PlantBounds(NamedTuple):
    """What the theorem needs to know of a plant.

    Args:
        k_min: Smallest high-frequency gain k_p [1/s].
        k_max: Largest high-frequency gain k_p [1/s].
        a_max: Bound of |a_p| [1/s].
        zero_dynamics: The zero dynamics; None: there are none.
        stiffness: Bound of the stiffness' magnitude [1/s^2].
    """

    k_min: Numeric
    k_max: Numeric
    a_max: Numeric
    zero_dynamics: ZeroDynamics | None = None
    stiffness: Numeric = 0.0


def mark(study: Study) -> Mark:
    """Whether each point of a study's sweep is certified; the stored result if the study's code is not loaded."""
    if isinstance(study, Described):
        description = study.description
        if description.certified is None:
            return Mark(None, description.silence or OTHER_FUNCTIONS)
        return Mark(np.asarray(description.certified, dtype=bool), "")
    try:
        with np.errstate(all="ignore"):  # an unbounded law makes infinite bounds, which nothing certifies
            verdicts = certified(*design_of(study))
    except NotCovered as silence:
        return Mark(None, str(silence))
    shape = tuple(len(values) for values in study.axes.values())
    return Mark(np.broadcast_to(np.asarray(verdicts, dtype=bool), shape).copy(), "")


def reach(study: Study, name: str, values: np.ndarray) -> Reach:
    """How far Theorem 1 certifies a study as given values of one number replace its law or its own value.

    The theorem assumes that there are no unmodelled dynamics. A lag mu s W(mu s) u (Section V-A2) depends on u' and
    is therefore not a disturbance of the class (A0)-(A3), however small mu is; nor is the effect of a limit on the
    command.

    Args:
        study: The study; its own sweep is ignored.
        name: Dotted name of the number.
        values: Values of the number, from its safe end, shape (n,).
    """
    if name in study.parameter_names:
        refusal = parameter_refusal(study, name)
        return Reach(None, refusal) if refusal else certified_up_to(study, name, np.asarray(values, float))
    section = name.partition(".")[0]
    if section in ACTUATION:
        verdict, reason = mark(study.override({"sweep": {}}))
        if verdict is None:
            return Reach(None, f"Theorem 1 does not apply: {reason}")
        if not verdict:
            return Reach(None, "Theorem 1 does not certify the loop, not even without unmodelled dynamics")
        text = "Theorem 1 certifies only the loop without unmodelled dynamics"
        if len(tables_of(study.config, "unmodelled")) > 1:
            return Reach(None, f"{text}; the chain has other elements than that of {name}")
        if name.rpartition(".")[2] in LIMITS:
            return Reach(None, f"{text}; it covers no finite {name}")
        quantity = study.quantities[name]
        if 0.0 not in (quantity.above, quantity.at_least):
            return Reach(None, f"{text}, whatever {name} is")
        return Reach(0.0, f"{text}; it covers no {name} > 0")
    if section in OUTSIDE or name in OUTSIDE:
        return Reach(None, f"Theorem 1 does not cover {name}: {OUTSIDE.get(name) or OUTSIDE[section]}")
    return certified_up_to(study, name, np.asarray(values, float))


def parameter_refusal(study: Study, name: str) -> str:
    """Why the theorem cannot follow a parameter; empty if it covers every number that follows from it."""
    for follower in study.followers(name):
        section = follower.partition(".")[0]
        if section in ACTUATION or section in OUTSIDE or follower in OUTSIDE:
            return f"Theorem 1 does not cover {name}: {follower} follows from it, and it knows nothing of that"
    return ""


def certified_up_to(study: Study, name: str, values: np.ndarray) -> Reach:
    """:func:`reach` for a number that the theorem covers."""
    marks_of = marks_over_spread if name == SPREAD else marks_along
    verdicts, reason = marks_of(study, name, values)
    if verdicts is None:
        return Reach(None, f"Theorem 1 does not apply: {reason}")
    if not verdicts[0]:
        return Reach(None, f"Theorem 1 does not certify the loop at {name} = {values[0]:g}")
    if verdicts.all():
        text = f"Theorem 1 certifies the whole walk, without lag and sampling, to {name} = {values[-1]:g}"
        return Reach(float(values[-1]), text)
    first_failure = int(np.argmin(verdicts))
    low = values[first_failure - 1]
    high = values[first_failure]
    for _ in range(REFINEMENTS):
        refined_values = np.linspace(low, high, REFINED)
        verdicts, _ = marks_of(study, name, refined_values)
        assert verdicts is not None  # it spoke of both ends
        first_failure = max(1, int(np.argmin(verdicts)))
        low = refined_values[first_failure - 1]
        high = refined_values[first_failure]
    return Reach(float(low), f"Theorem 1 certifies the loop, without lag and sampling, as far as {name} = {low:.6g}")


def marks_along(study: Study, name: str, values: np.ndarray) -> Mark:
    """Marks of a study at values of one number, in their order."""
    verdicts, reason = mark(study.override({"sweep": {name: sorted(values.tolist())}}))
    if verdicts is not None and values[0] > values[-1]:
        verdicts = verdicts[::-1]
    return Mark(verdicts, reason)


def marks_over_spread(study: Study, name: str, values: np.ndarray) -> Mark:
    """Marks of a study whose laws are widened by a factor: their ends move about the median.

    A law of unbounded support stays unbounded; one that leaves its number's range is not certified.
    """
    del name
    verdicts = []
    for value in values:
        try:
            verdict, reason = mark(study.override({"sweep": {}, **widened_laws(study, float(value))}))
        except ConfigError:
            verdict = np.False_
            reason = ""
        if verdict is None:
            return Mark(None, reason)
        verdicts.append(bool(verdict))
    return Mark(np.array(verdicts), "")


def widened_laws(study: Study, share: float) -> dict[str, Any]:
    """Replacements of the laws with bounded support: uniform laws between the moved ends."""
    changes: dict[str, Any] = {}
    for name, law in study.laws.items():
        if np.all(np.isfinite(law.support)):
            low, high = (float(end) for end in law.spread(np.array(law.support), share))
            changes[name] = {"uniform": [low, high]} if low < high else low
    return changes


def design_of(study: Study) -> tuple[Parameters, Bounds]:
    """The parameters of Table 1 and the bounds of a study's loop, over its sweep.

    Raises:
        NotCovered: The plant is not (5)-(8), the functions are not those of Table 1, or a number has no bound.
    """
    ends = ends_of(study)
    if study.loop.plant is not NORMAL_FORM:  # what the plant lacks is told before what the controller lacks
        plant_bounds(study.loop.plant, ends.part("plant"))
    gains = ends.low.controller[0]
    is_dssc = study.loop.controller[0] in DSSC.members.values()
    if not is_dssc or not isinstance(gains.functions, Vgsta):
        raise NotCovered(OTHER_FUNCTIONS)
    if gains.sign_width is not None:
        raise NotCovered("the sign is smoothed (sign_width), so that nothing slides on sigma_tilde = 0")
    if any(map(is_gain, study.uncertain)):
        raise NotCovered("the controller's own numbers are uncertain")
    constants = gains.functions._asdict() | {"eps": gains.functions.epsilon, "l0": gains.l0}
    parameters = Parameters(**{name: constants[name] for name in Parameters._fields})
    return parameters, bounds_of(study.loop, ends, parameters)


def is_gain(name: str) -> bool:
    """Whether a dotted name belongs to the functions or is l0."""
    return name.startswith("controller.functions.") or name == "controller.l0"


def bounds_of(loop: Loop, ends: Ends, p: Parameters) -> Bounds:
    """The bounds (A0)-(A4) of a loop of the class (5)-(8); the plant's stiffness is a disturbance -stiffness y/k_p."""
    plant = plant_bounds(loop.plant, ends.part("plant"))
    reference = reference_bounds(loop.reference, ends.part("reference"))
    require_no_inputs(loop)
    disturbance = disturbance_bounds(loop.disturbance[0], ends.part("disturbance", 0))
    return Bounds(
        k_min=plant.k_min,
        k_max=plant.k_max,
        a_max=plant.a_max,
        zero_dynamics=plant.zero_dynamics,
        **reference,
        **(disturbance | {"k_d4": disturbance.get("k_d4", 0.0) + plant.stiffness / plant.k_min}),
        **nominal_bounds(ends.part("controller", 0).part("nominal"), p, reference),
    )


def require_no_inputs(loop: Loop) -> None:
    """Require that no disturbance acts at an input that the plant names.

    Raises:
        NotCovered: one does.
    """
    for name, model in zip(loop.input_names, loop.inputs, strict=True):
        if model is not NO_DISTURBANCE:
            raise NotCovered(f"a disturbance acts at the input '{name}', and (7) takes it where the command acts")


def plant_bounds(model: Plant, ends: Ends) -> PlantBounds:
    """The bounds of a plant in normal form, or of a linear one that has this form.

    Raises:
        NotCovered: It is neither, or its zero dynamics are uncertain.
    """
    low, high = ends
    if model is NORMAL_FORM:
        if low.zero_dynamics is not None and not is_fixed(ends.part("zero_dynamics")):
            raise NotCovered("the zero dynamics are uncertain, or swept")
        return PlantBounds(low.k_p, high.k_p, ends.largest("a_p"), low.zero_dynamics)
    if model not in (STATE_SPACE, RATIONAL_PLANT):
        raise NotCovered("the plant is not of the class (5)-(8), which kind = 'normal_form' writes down")
    if model is STATE_SPACE and low.disturbance is not None and not are_equal(low.disturbance, low.b):
        raise NotCovered("the disturbance has an input column of its own, and (7) takes it where the command acts")
    if is_certain(low, high):
        form = form_of(model, low)
        if form.obstacle:
            raise NotCovered(form.obstacle)
        dynamics = ZeroDynamics(form.zero_a, form.zero_c) if form.zero_a else None
        return PlantBounds(form.gain, form.gain, abs(form.damping), dynamics, abs(form.stiffness))
    if model is STATE_SPACE or len(low.denominator) != 3 or len(low.numerator) != 1:
        raise NotCovered("the plant is uncertain, and no transfer function of second order without zeros")
    lead_low = low.denominator[0]
    lead_high = high.denominator[0]
    if not np.all(np.asarray(lead_low) > 0.0) or not np.all(np.asarray(low.numerator[0]) > 0.0):
        raise NotCovered("the leading coefficients of the transfer function are not positive for every draw")
    magnitudes = [np.maximum(np.abs(a), np.abs(b)) for a, b in zip(low.denominator, high.denominator, strict=True)]
    return PlantBounds(
        k_min=low.numerator[0] / lead_high,
        k_max=high.numerator[0] / lead_low,
        a_max=magnitudes[1] / lead_low,
        stiffness=magnitudes[2] / lead_low,
    )


def are_equal(first: Numeric, second: Numeric) -> bool:
    """Whether two columns hold the same plain numbers."""
    return all(isinstance(leaf, int | float) for leaf in jax.tree.leaves((first, second))) and first == second


def is_certain(low: Numeric, high: Numeric) -> bool:
    """Whether a linear plant's numbers are plain, and the same at both ends."""
    return all(isinstance(leaf, int | float) for leaf in jax.tree.leaves((low, high))) and low == high


def form_of(model: Plant, params: Any) -> NormalForm:
    """The normal form of a linear plant in plain numbers."""
    if model is STATE_SPACE:
        return normal_form(*transfer_function(RealisedSystem(params.a, params.b, params.c)))
    return normal_form(params.numerator, params.denominator)


def is_fixed(ends: Ends) -> bool:
    """Whether every number of a part is plain, and the same at both ends."""
    low, high = ([value for row in part for value in row] for part in ends)
    return all(isinstance(value, int | float) for value in low) and low == high


def swing(amplitude: Numeric, period: Numeric, order: int) -> Numeric:
    """Largest value of the derivative of a sine of the given order."""
    return amplitude * (2.0 * math.pi / period) ** order


def reference_bounds(model: Reference, ends: Ends) -> dict[str, Numeric]:
    """Suprema of the reference and its first three derivatives."""
    for axis, member in MISSION_ENTRY.members.items():
        if model is member:
            ends = Ends(MISSION[axis], MISSION[axis])
            model = SINE
    low = ends.low
    if model is ZERO:
        return {}
    if model is not SINE:
        raise NotCovered("the reference's third derivative has no known bound")
    amplitude = ends.largest("amplitude")
    names = ("y_m_dot", "y_m_ddot", "y_m_dddot")
    swings = {name: swing(amplitude, low.period, order) for order, name in enumerate(names, 1)}
    return {"y_m": amplitude + ends.largest("offset"), **swings}


def disturbance_bounds(model: Disturbance, ends: Ends) -> dict[str, Numeric]:
    """The constants of (A0.b)-(A3). A step is constant except at its time, after which the theorem applies again."""
    low = ends.low
    if model is NO_DISTURBANCE:
        return {}
    if model in (CONSTANT, STEP):
        return {"alpha_d": ends.largest("value")}
    if model is SINE_DISTURBANCE:
        amplitude = ends.largest("amplitude")
        return {"alpha_d": amplitude, "alpha_d3": swing(amplitude, low.period, 1)}
    if model is SPLINE:
        pairs = zip(low.knots, ends.high.knots, strict=True)
        knots = [0.0, *(np.maximum(np.abs(a), np.abs(b)) for a, b in pairs), 0.0]
        steepest = np.max(np.add(knots[1:], knots[:-1]), axis=0) / low.interval  # of any knots that large
        return {"alpha_d": np.max(knots, axis=0), "alpha_d3": steepest}
    if model is PARTITION:
        names = ("k_d1", "k_d2", "k_d3", "k_d4", "k_d5", "alpha_d2", "alpha_d3")
        return {name: getattr(ends.high, name) for name in names}
    raise NotCovered("the disturbance's derivative has no known bound")


def nominal_bounds(ends: Ends, p: Parameters, reference: dict[str, Numeric]) -> dict[str, Numeric]:
    """The constants of (A4) for the nominal control (37), with the largest 1/tau_m; each at its worse end."""
    if ends.low is None:
        return {}
    speed, acceleration, jerk = (reference.get(name, 0.0) for name in ("y_m_dot", "y_m_ddot", "y_m_dddot"))
    pole = predictor_pole(p) if ends.low.predictor_term else 0.0
    k = ends.low.k
    damping = ends.largest("a")
    offset = greater(abs(ends.low.a - p.l0), abs(ends.high.a - p.l0))
    c_e = offset * p.l0 / k
    return {
        "c_sigma": (offset + pole) / k,
        "c_e1": c_e,
        "c_e2": c_e,
        "c_m": (damping * speed + acceleration) / k,
        "u_m_dot": (damping * acceleration + jerk) / k,
    }
