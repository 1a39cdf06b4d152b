"""The bounds (A0)-(A4) of a study's loop, and its parameters of Table 1.

The bounds follow from the parts of the loop. The intervals of k_p and a_p follow from their laws. The constants of
disturbance, reference and nominal control follow from the kinds and the numbers of these parts.
"""

import math
from typing import Any, NamedTuple

import jax
import numpy as np

from dssc_jax.closed_loop.loop import Loop
from dssc_jax.core.contracts import Disturbance, Plant, Reference
from dssc_jax.core.normal_form import NormalForm, RealisedSystem, normal_form, transfer_function
from dssc_jax.core.zero_dynamics import ZeroDynamics
from dssc_jax.design import Bounds, Parameters
from dssc_jax.design.arrays import Numeric, greater
from dssc_jax.design.bounds import DISTURBANCE_FIELDS
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
from dssc_jax.study import Study

NOT_TABLE_1 = "the controller is not DSSC with functions.kind = 'vgsta', those of Table 1"


class NotCovered(Exception):
    """The theorem does not cover this loop; the message gives the reason."""


class PlantBounds(NamedTuple):
    """The bounds of a plant that the theorem uses.

    Args:
        k_min: Smallest high-frequency gain k_p [1/s].
        k_max: Largest high-frequency gain k_p [1/s].
        a_max: Bound of |a_p| [1/s].
        zero_dynamics: The zero dynamics; None: there are none.
        stiffness: Bound of the magnitude of the stiffness, the factor of -y in y'' [1/s^2].
    """

    k_min: Numeric
    k_max: Numeric
    a_max: Numeric
    zero_dynamics: ZeroDynamics | None = None
    stiffness: Numeric = 0.0


def design_of(study: Study) -> tuple[Parameters, Bounds]:
    """The parameters of Table 1 and the bounds of a study's loop.

    The bounds hold for all draws. In a sweep they are arrays over the points, with shapes that broadcast.

    Raises:
        NotCovered: The plant is not of the class (5)-(8), the controller is not DSSC with the functions of Table 1, the
            controller's own numbers are uncertain or its sign is smoothed, or a number has no bound.
    """
    ends = ends_of(study)
    if study.loop.plant is not NORMAL_FORM:  # raises what the plant lacks, before what the controller lacks
        plant_bounds(study.loop.plant, ends.part("plant"))
    gains = ends.low.controller[0]  # at both ends, since they must be certain
    is_dssc = study.loop.controller[0] in DSSC.members.values()
    if not is_dssc or not isinstance(gains.functions, Vgsta):
        raise NotCovered(NOT_TABLE_1)
    if gains.sign_width is not None:
        raise NotCovered("the sign is smoothed (sign_width), so that nothing slides on sigma_tilde = 0")
    if any(name.startswith(("controller.functions.", "controller.l0")) for name in study.uncertain):
        raise NotCovered("the controller's own numbers are uncertain")
    constants = gains.functions._asdict() | {"eps": gains.functions.epsilon, "l0": gains.l0}
    parameters = Parameters(**{name: constants[name] for name in Parameters._fields})
    return parameters, bounds_of(study.loop, ends, parameters)


def bounds_of(loop: Loop, ends: Ends, p: Parameters) -> Bounds:
    """The bounds (A0)-(A4) of a loop of the class (5)-(8).

    The term -stiffness y of y'' counts as the disturbance -stiffness y/k_p at the command, which adds to k_d4.

    Args:
        loop: The loop.
        ends: Parameters of the loop at both ends of all laws.
        p: Parameters of Table 1, from which the bounds of the nominal control follow.

    Raises:
        NotCovered: A part is not covered by the theorem, or has no bound.
    """
    plant = plant_bounds(loop.plant, ends.part("plant"))
    reference = reference_bounds(loop.reference, ends.part("reference"))
    require_no_inputs(loop)
    disturbance = disturbance_bounds(loop.disturbance[0], ends.part("disturbance", 0))
    disturbance["k_d4"] = disturbance.get("k_d4", 0.0) + plant.stiffness / plant.k_min
    return Bounds(
        k_min=plant.k_min,
        k_max=plant.k_max,
        a_max=plant.a_max,
        zero_dynamics=plant.zero_dynamics,
        **reference,
        **disturbance,
        **nominal_bounds(ends.part("controller", 0).part("nominal"), p, reference),
    )


def require_no_inputs(loop: Loop) -> None:
    """Require that no disturbance acts at a named input of the plant.

    The disturbance of the theorem acts where the command acts.

    Raises:
        NotCovered: A disturbance acts at a named input.
    """
    for name, model in zip(loop.input_names, loop.inputs, strict=True):
        if model is not NO_DISTURBANCE:
            raise NotCovered(f"a disturbance acts at the input '{name}', and (7) takes it where the command acts")


def plant_bounds(model: Plant, ends: Ends) -> PlantBounds:
    """The bounds of a plant in normal form, or of a linear plant that can be brought into this form.

    Args:
        model: Model of the plant.
        ends: Parameters of the plant at both ends of their laws.

    Raises:
        NotCovered: The plant has no normal form, its disturbance does not act where the command acts, or it is
            uncertain in a way for which the bounds are not known.
    """
    low, high = ends
    if model is NORMAL_FORM:
        if low.zero_dynamics is not None and not are_same_numbers(*ends.part("zero_dynamics")):
            raise NotCovered("the zero dynamics are uncertain, or swept")
        return PlantBounds(low.k_p, high.k_p, ends.largest("a_p"), low.zero_dynamics)
    if model not in (STATE_SPACE, RATIONAL_PLANT):
        raise NotCovered("the plant is not of the class (5)-(8), which kind = 'normal_form' writes down")
    if model is STATE_SPACE and low.disturbance is not None and not are_same_numbers(low.disturbance, low.b):
        raise NotCovered("the disturbance has an input column of its own, and (7) takes it where the command acts")
    if are_same_numbers(low, high):
        return bounds_of_normal_form(form_of(model, low))
    if model is STATE_SPACE or len(low.denominator) != 3 or len(low.numerator) != 1:
        raise NotCovered("the plant is uncertain, and no transfer function of second order without zeros")
    return bounds_of_second_order(low, high)


def bounds_of_normal_form(form: NormalForm) -> PlantBounds:
    """The bounds of a linear plant without uncertain numbers, from its normal form.

    Raises:
        NotCovered: The plant has no normal form (5)-(8).
    """
    if form.obstacle:
        raise NotCovered(form.obstacle)
    dynamics = ZeroDynamics(form.zero_a, form.zero_c) if form.zero_a else None
    return PlantBounds(form.gain, form.gain, abs(form.damping), dynamics, abs(form.stiffness))


def bounds_of_second_order(low: Any, high: Any) -> PlantBounds:
    """The bounds of uncertain plants n_0/(d_0 s^2 + d_1 s + d_2), that is y'' = -(d_1 y' + d_2 y)/d_0 + (n_0/d_0) u.

    Args:
        low: Parameters of the plant at the lower ends of their laws.
        high: Parameters at the upper ends.

    Raises:
        NotCovered: n_0 or d_0 may be zero or negative.
    """
    lead_low = low.denominator[0]
    lead_high = high.denominator[0]
    has_positive_leads = np.all(np.asarray(lead_low) > 0.0) and np.all(np.asarray(low.numerator[0]) > 0.0)
    if not has_positive_leads:
        raise NotCovered("the leading coefficients of the transfer function are not positive for every draw")
    magnitudes = [np.maximum(np.abs(a), np.abs(b)) for a, b in zip(low.denominator, high.denominator, strict=True)]
    return PlantBounds(
        k_min=low.numerator[0] / lead_high,
        k_max=high.numerator[0] / lead_low,
        a_max=magnitudes[1] / lead_low,
        stiffness=magnitudes[2] / lead_low,
    )


def are_same_numbers(first: Any, second: Any) -> bool:
    """Whether two parts, or two parameters, consist of equal plain numbers; False for a swept number, an array."""
    leaves = jax.tree.leaves((first, second))
    return all(isinstance(leaf, int | float) for leaf in leaves) and first == second


def form_of(model: Plant, params: Any) -> NormalForm:
    """The normal form of a linear plant, from parameters in plain numbers.

    Args:
        model: The plant in state space or as a transfer function.
        params: Parameters of the plant, in plain numbers.
    """
    if model is STATE_SPACE:
        return normal_form(*transfer_function(RealisedSystem(params.a, params.b, params.c)))
    return normal_form(params.numerator, params.denominator)


def swing(amplitude: Numeric, period: Numeric, order: int) -> Numeric:
    """Largest magnitude of a derivative of a sine, in the unit of the amplitude per s^order.

    Args:
        amplitude: Amplitude of the sine.
        period: Period [s].
        order: Order of the derivative.
    """
    return amplitude * (2.0 * math.pi / period) ** order


def reference_bounds(model: Reference, ends: Ends) -> dict[str, Numeric]:
    """Suprema of the reference and its first three derivatives, by field of :class:`Bounds`; absent fields are 0.

    Args:
        model: Model of the reference.
        ends: Parameters of the reference at both ends of their laws.

    Raises:
        NotCovered: The third derivative has no known bound.
    """
    for axis, member in MISSION_ENTRY.members.items():  # the article's missions are sines
        if model is member:
            ends = Ends(MISSION[axis], MISSION[axis])
            model = SINE
    if model is ZERO:
        return {}
    if model is not SINE:
        raise NotCovered("the reference's third derivative has no known bound")
    amplitude = ends.largest("amplitude")
    period = ends.low.period  # the shortest one has the largest derivatives
    return {
        "y_m": amplitude + ends.largest("offset"),
        "y_m_dot": swing(amplitude, period, order=1),
        "y_m_ddot": swing(amplitude, period, order=2),
        "y_m_dddot": swing(amplitude, period, order=3),
    }


def disturbance_bounds(model: Disturbance, ends: Ends) -> dict[str, Numeric]:
    """The constants of (A0.b)-(A3) for a disturbance, by field of :class:`Bounds`; absent fields are 0.

    A step counts as a constant disturbance, since the theorem applies again from the time of the step on.

    Args:
        model: Model of the disturbance.
        ends: Parameters of the disturbance at both ends of their laws.

    Raises:
        NotCovered: The derivative of the disturbance has no known bound.
    """
    low = ends.low
    if model is NO_DISTURBANCE:
        return {}
    if model in (CONSTANT, STEP):
        return {"alpha_d": ends.largest("value")}
    if model is SINE_DISTURBANCE:
        amplitude = ends.largest("amplitude")
        return {"alpha_d": amplitude, "alpha_d3": swing(amplitude, low.period, order=1)}
    if model is SPLINE:
        return spline_bounds(ends)
    if model is PARTITION:
        return {name: getattr(ends.high, name) for name in DISTURBANCE_FIELDS}
    raise NotCovered("the disturbance's derivative has no known bound")


def spline_bounds(ends: Ends) -> dict[str, Numeric]:
    """The constants of (A0.b)-(A3) for a cubic B-spline with uncertain knots, by field of :class:`Bounds`.

    The largest slope is at most the largest difference of two consecutive knots, divided by the interval between them.

    Args:
        ends: Parameters of the spline at both ends of their laws.
    """
    largest_knots: list[Numeric] = [0.0]  # it begins and ends at 0
    for low, high in zip(ends.low.knots, ends.high.knots, strict=True):
        largest_knots.append(np.maximum(np.abs(low), np.abs(high)))
    largest_knots.append(0.0)
    largest_steps = np.add(largest_knots[1:], largest_knots[:-1])  # between knots of opposite signs
    return {"alpha_d": np.max(largest_knots, axis=0), "alpha_d3": np.max(largest_steps, axis=0) / ends.low.interval}


def nominal_bounds(ends: Ends, p: Parameters, reference: dict[str, Numeric]) -> dict[str, Numeric]:
    """The constants of (A4) for the nominal control (37), by field of :class:`Bounds`; absent fields are 0.

    Each constant is the larger of its values at the two ends of the gains' laws.

    Args:
        ends: Gains of the nominal control at both ends of their laws; both ends are None without a nominal control.
        p: Parameters of Table 1, from which the largest 1/tau_m follows.
        reference: Suprema of the reference, by :func:`reference_bounds`.
    """
    if ends.low is None:
        return {}
    speed = reference.get("y_m_dot", 0.0)
    acceleration = reference.get("y_m_ddot", 0.0)
    jerk = reference.get("y_m_dddot", 0.0)
    pole = predictor_pole(p) if ends.low.predictor_term else 0.0  # bound of 1/tau_m
    k = ends.low.k  # nominal k_p
    damping = ends.largest("a")  # nominal a_p
    offset = greater(abs(ends.low.a - p.l0), abs(ends.high.a - p.l0))  # bound of |a - l0|
    c_e = offset * p.l0 / k
    return {
        "c_sigma": (offset + pole) / k,
        "c_e1": c_e,
        "c_e2": c_e,
        "c_m": (damping * speed + acceleration) / k,
        "u_m_dot": (damping * acceleration + jerk) / k,
    }
