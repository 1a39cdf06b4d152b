"""Certification of a study's loop by Theorem 1 at every point of its sweep.

The theorem concerns the loop in continuous time, without unmodelled dynamics and sensors, and with a rho that maintains
sliding. The simulation covers everything else in the study.
"""

from typing import Any, NamedTuple

import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.design import certified
from dssc_jax.design.loop_bounds import NOT_TABLE_1, NotCovered, design_of
from dssc_jax.study import Described, Study
from dssc_jax.study.actuators import tables_of
from dssc_jax.study.laws import SPREAD

UNCOVERED = {
    "loop": "it is of continuous time",
    "sensor": "it takes y and y' as they are",
    "differentiator": "it takes y' as it is",
    "controller.rho": "it takes sliding for granted",
}
"""Sections and numbers of a study that the theorem does not cover, with the reason in words."""
ACTUATION = ("unmodelled", "actuator")
"""Sections of the study file with the unmodelled dynamics."""
LIMITS = ("rate", "limit")
"""Fields of unmodelled dynamics that are infinite, rather than 0, where the dynamics are absent."""
REFINEMENTS = 2
"""How often the cell between the last certified and the first uncertified value is refined."""
CELL_POINTS = 33
"""Points of a refined cell, both ends included: two refinements divide the cell by 32^2 = 1024."""


class Mark(NamedTuple):
    """The theorem's result for a study.

    Args:
        certified: Whether the theorem holds at each point, shape (axes...); None if the theorem does not apply.
        reason: Why the theorem does not apply; empty if it applies.
    """

    certified: np.ndarray | None
    reason: str


class CertifiedReach(NamedTuple):
    """How far the theorem certifies a loop as one of its numbers varies.

    Args:
        value: The last value at which the theorem holds for all draws; None if there is none.
        text: The theorem's result for the number, in words.
    """

    value: float | None
    text: str


def mark(study: Study) -> Mark:
    """Whether Theorem 1 certifies the loop at each point of a study's sweep, or why the theorem does not apply.

    If the study's code is not loaded, the result is read from the study's description.
    """
    if isinstance(study, Described):
        description = study.description
        if description.certified is None:
            return Mark(None, description.silence or NOT_TABLE_1)
        return Mark(np.asarray(description.certified, dtype=bool), "")
    try:
        with np.errstate(all="ignore"):  # an unbounded law makes infinite bounds, which nothing certifies
            verdicts = certified(*design_of(study))
    except NotCovered as reason:
        return Mark(None, str(reason))
    shape = tuple(len(values) for values in study.axes.values())
    return Mark(np.broadcast_to(np.asarray(verdicts, dtype=bool), shape).copy(), "")


def reach(study: Study, name: str, values: np.ndarray) -> CertifiedReach:
    """How far Theorem 1 certifies a study as one number moves away from its safe end.

    Each value takes the place of the number's law or value. The theorem assumes that there are no unmodelled dynamics.
    A lag mu s W(mu s) u (Section V-A2) depends on u', so it is no disturbance of the class (A0)-(A3), however small mu
    is. The effect of a limit on the command is no such disturbance either.

    Args:
        study: The study; its own sweep is ignored.
        name: Dotted name of the number.
        values: Values of the number, rising or falling from its safe end, shape (n,).
    """
    section, _, _ = name.partition(".")
    if name in study.parameter_names:
        refusal = parameter_refusal(study, name)
        if refusal:
            return CertifiedReach(None, refusal)
    elif section in ACTUATION:
        return actuation_reach(study, name)
    elif name in UNCOVERED or section in UNCOVERED:
        reason = UNCOVERED[name] if name in UNCOVERED else UNCOVERED[section]
        return CertifiedReach(None, f"Theorem 1 does not cover {name}: {reason}")
    return certified_up_to(study, name, np.asarray(values, float))


def actuation_reach(study: Study, name: str) -> CertifiedReach:
    """How far Theorem 1 certifies a study along a number of the unmodelled dynamics.

    The theorem covers only the absence of these dynamics. So the reach is 0 if the loop without them is certified and
    they vanish when the number is 0. Otherwise it is None.

    Args:
        study: The study; its own sweep is ignored.
        name: Dotted name of the number.
    """
    verdict, reason = mark(study.override({"sweep": {}}))
    if verdict is None:
        return CertifiedReach(None, f"Theorem 1 does not apply: {reason}")
    if not verdict:
        return CertifiedReach(None, "Theorem 1 does not certify the loop, not even without unmodelled dynamics")
    text = "Theorem 1 certifies only the loop without unmodelled dynamics"
    if len(tables_of(study.config, "unmodelled")) > 1:
        return CertifiedReach(None, f"{text}; the chain has other elements than that of {name}")
    if name.rpartition(".")[2] in LIMITS:
        return CertifiedReach(None, f"{text}; it covers no finite {name}")
    quantity = study.quantities[name]
    vanishes_at_zero = 0.0 in (quantity.above, quantity.at_least)  # such as a time constant
    if not vanishes_at_zero:
        return CertifiedReach(None, f"{text}, whatever {name} is")
    return CertifiedReach(0.0, f"{text}; it covers no {name} > 0")


def parameter_refusal(study: Study, name: str) -> str:
    """Why the theorem does not cover a parameter of the study, in words.

    The text is empty if the theorem covers every number that follows from the parameter.
    """
    for follower in study.followers(name):
        section, _, _ = follower.partition(".")
        if section in ACTUATION or section in UNCOVERED or follower in UNCOVERED:
            return f"Theorem 1 does not cover {name}: {follower} follows from it, and it knows nothing of that"
    return ""


def certified_up_to(study: Study, name: str, values: np.ndarray) -> CertifiedReach:
    """How far Theorem 1 certifies a study along a number that the theorem covers.

    The cell between the last certified and the first uncertified value is refined.

    Args:
        study: The study; its own sweep is ignored.
        name: Dotted name of the number, or :data:`SPREAD` for the factor that widens all laws.
        values: Values of the number, from its safe end, shape (n,).
    """
    verdicts, reason = marks_at(study, name, values)
    if verdicts is None:
        return CertifiedReach(None, f"Theorem 1 does not apply: {reason}")
    if not verdicts[0]:
        return CertifiedReach(None, f"Theorem 1 does not certify the loop at {name} = {values[0]:g}")
    if verdicts.all():
        text = f"Theorem 1 certifies the whole walk, without lag and sampling, to {name} = {values[-1]:g}"
        return CertifiedReach(float(values[-1]), text)
    certified_end = refined_end(study, name, values, verdicts)
    text = f"Theorem 1 certifies the loop, without lag and sampling, as far as {name} = {certified_end:.6g}"
    return CertifiedReach(certified_end, text)


def refined_end(study: Study, name: str, values: np.ndarray, verdicts: np.ndarray) -> float:
    """The last certified value of a number, found by refining the cell in which the certificate is lost.

    Args:
        study: The study.
        name: Dotted name of the number, or :data:`SPREAD`.
        values: Values of the number, from its safe end, shape (n,).
        verdicts: Whether each value is certified, shape (n,); True for the first value, and False for at least one.
    """
    first_failure = int(np.argmin(verdicts))
    certified_end = values[first_failure - 1]
    failing_end = values[first_failure]
    for _ in range(REFINEMENTS):
        refined_values = np.linspace(certified_end, failing_end, CELL_POINTS)
        refined_verdicts, _ = marks_at(study, name, refined_values)
        assert refined_verdicts is not None  # the theorem applies at both ends
        first_failure = max(1, int(np.argmin(refined_verdicts)))  # at least 1: the first value is certified
        certified_end = refined_values[first_failure - 1]
        failing_end = refined_values[first_failure]
    return float(certified_end)


def marks_at(study: Study, name: str, values: np.ndarray) -> Mark:
    """The theorem's result at each value of a number, or of the factor :data:`SPREAD`, in the order of ``values``."""
    return marks_over_spread(study, values) if name == SPREAD else marks_along(study, name, values)


def marks_along(study: Study, name: str, values: np.ndarray) -> Mark:
    """The theorem's result at each value of one number, in the order of ``values``, shape (n,).

    Args:
        study: The study; its own sweep is ignored.
        name: Dotted name of the number.
        values: Rising or falling values of the number, shape (n,).
    """
    verdicts, reason = mark(study.override({"sweep": {name: sorted(values.tolist())}}))
    is_falling = values[0] > values[-1]
    if verdicts is not None and is_falling:
        verdicts = verdicts[::-1]
    return Mark(verdicts, reason)


def marks_over_spread(study: Study, values: np.ndarray) -> Mark:
    """The theorem's result for a study whose laws are all widened by each of several factors, shape (n,).

    A law with unbounded support keeps this support. A study is not certified for a factor with which a law leaves the
    admissible interval of its number.

    Args:
        study: The study; its own sweep is ignored.
        values: Factors on the width of every law, shape (n,).
    """
    verdicts = []
    for value in values:
        try:
            verdict, reason = mark(study.override({"sweep": {}, **widened_laws(study, float(value))}))
        except ConfigError:  # a law leaves its number's interval
            verdicts.append(False)
            continue
        if verdict is None:
            return Mark(None, reason)
        verdicts.append(bool(verdict))
    return Mark(np.array(verdicts), "")


def widened_laws(study: Study, share: float) -> dict[str, Any]:
    """Widened laws of a study by dotted name: for each law with bounded support, a uniform law between the moved ends.

    A uniform law suffices, since Theorem 1 depends on the ends alone. If both ends coincide, a number takes its place.

    Args:
        study: The study.
        share: Factor on the distance of each end from the median of the law.
    """
    changes: dict[str, Any] = {}
    for name, law in study.laws.items():
        if np.all(np.isfinite(law.support)):
            low, high = law.spread(np.array(law.support), share).tolist()
            changes[name] = {"uniform": [low, high]} if low < high else low
    return changes
