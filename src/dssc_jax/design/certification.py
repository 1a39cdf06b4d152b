"""Certification of a study's loop by Theorem 1 at every point of its sweep.

The certificate is that of the loop in continuous time, without unmodelled dynamics and sensors, and with a rho that
maintains sliding. The simulation covers everything else in the study.
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
"""Numbers that the theorem does not cover, with the reason."""
ACTUATION = ("unmodelled", "actuator")
"""Sections of the study file with the unmodelled dynamics."""
LIMITS = ("rate", "limit")  # of unmodelled dynamics whose absence is an infinite number
REFINEMENTS = 2  # of the walk's cell in which the certificate is lost
CELL_POINTS = 33  # of a refined cell, so that two refinements reach 1/1024 of it


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


def mark(study: Study) -> Mark:
    """Whether Theorem 1 certifies the loop at each point of a study's sweep.

    If the study's code is not loaded, this is the result that is stored with its description.
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


def reach(study: Study, name: str, values: np.ndarray) -> Reach:
    """How far Theorem 1 certifies a study as values of one number replace the number's law or value.

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
        return actuation_reach(study, name)
    if section in UNCOVERED or name in UNCOVERED:
        return Reach(None, f"Theorem 1 does not cover {name}: {UNCOVERED.get(name) or UNCOVERED[section]}")
    return certified_up_to(study, name, np.asarray(values, float))


def actuation_reach(study: Study, name: str) -> Reach:
    """:func:`reach` for a number of the unmodelled dynamics: the theorem covers only their absence."""
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


def parameter_refusal(study: Study, name: str) -> str:
    """Why the theorem cannot follow a parameter; empty if it covers every number that follows from it."""
    for follower in study.followers(name):
        section = follower.partition(".")[0]
        if section in ACTUATION or section in UNCOVERED or follower in UNCOVERED:
            return f"Theorem 1 does not cover {name}: {follower} follows from it, and it knows nothing of that"
    return ""


def certified_up_to(study: Study, name: str, values: np.ndarray) -> Reach:
    """:func:`reach` for a number that the theorem covers.

    The cell between the last certified and the first uncertified value is refined.
    """
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
        refined_values = np.linspace(low, high, CELL_POINTS)
        verdicts, _ = marks_of(study, name, refined_values)
        assert verdicts is not None  # the theorem applies at both ends
        first_failure = max(1, int(np.argmin(verdicts)))
        low = refined_values[first_failure - 1]
        high = refined_values[first_failure]
    return Reach(float(low), f"Theorem 1 certifies the loop, without lag and sampling, as far as {name} = {low:.6g}")


def marks_along(study: Study, name: str, values: np.ndarray) -> Mark:
    """The marks of a study at values of one number, in the order of the values, (n,)."""
    verdicts, reason = mark(study.override({"sweep": {name: sorted(values.tolist())}}))
    if verdicts is not None and values[0] > values[-1]:
        verdicts = verdicts[::-1]
    return Mark(verdicts, reason)


def marks_over_spread(study: Study, name: str, values: np.ndarray) -> Mark:
    """The marks of a study whose laws are widened by each of several factors, (n,): their ends move about the median.

    A law of unbounded support stays unbounded; one that leaves its number's range is not certified. ``name`` is not
    used: the function has the arguments of :func:`marks_along`.
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
    """Uniform laws between the moved ends of each law with bounded support, by name: the ends move about the median.

    ``share`` is the factor on their distance from the median.
    """
    changes: dict[str, Any] = {}
    for name, law in study.laws.items():
        if np.all(np.isfinite(law.support)):
            low, high = (float(end) for end in law.spread(np.array(law.support), share))
            changes[name] = {"uniform": [low, high]} if low < high else low
    return changes
