"""Find how far one number of a study can move before the study is no longer proved; each value has its own proof."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dssc_jax.core.bisection import bisect
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.json_types import JsonObject
from dssc_jax.design.certification import widened_laws
from dssc_jax.proofs import SWEEP_BOXES
from dssc_jax.proofs.coverage import AnyProblem, problem_of
from dssc_jax.proofs.prove import AnyProved, Proved, prove_problem
from dssc_jax.study import Study
from dssc_jax.study.laws import SPREAD

SAMPLE_TIME = "loop.sample_time"
"""Name of T_s."""
HALVINGS = 7
"""Number of bisections of the range, so that the last proved and the first unproved value are within 1 % of it."""


@dataclass(frozen=True)
class ProvedReach:
    """The values of a number for which a study is proved, found by bisection from the safe end of a range.

    Args:
        name: Dotted name of the number.
        values: The tried values, in the order of the trials, each with whether the study is proved at this value.
        last: The proof at the last proved value; None if the safe end is not proved.
        proved: The last proved value; None if the safe end is not proved.
        refused: The first value that is not proved: the nearest tried one beyond ``proved``, or the safe end if
            nothing is proved. None if the whole range is proved.
        reason: Why ``refused`` is not proved; empty if the whole range is proved.
    """

    name: str
    values: list[tuple[float, bool]]
    last: AnyProved | None
    proved: float | None
    refused: float | None
    reason: str

    def statement(self) -> str:
        """The outcome in words, ending with the statement that is proved at the last proved value."""
        if self.last is None:
            return f"Not proved at the safe end {self.name} = {self.values[0][0]:g}: {self.reason}."
        last_value = f"{self.name} = {self.proved:.4g}, each value on its own"
        if self.refused is None:
            return f"Proved up to the end, {last_value}. {self.last.statement()}"
        return f"Proved up to {last_value}; not at {self.refused:.4g}: {self.reason}. {self.last.statement()}"

    def summary(self) -> JsonObject:
        """A table of the outcome, in JSON's types, with the bound of |e| at the last proved value as ``error`` [m]."""
        return {
            "over": self.name,
            "proved_up_to": self.proved,
            "not_proved_at": self.refused,
            "reason": self.reason or None,
            "tried": [{"value": value, "proved": proved} for value, proved in self.values],
            "error": None if self.last is None else self.last.error,
            **({} if self.last is None else covered_content(self.last)),
            "statement": self.statement(),
        }


def covered_content(proof: AnyProved) -> JsonObject:
    """Make a table of what a proof covers, for a summary.

    The entry ``covered`` is in words. A vehicle's proof adds ``bounds`` and ``settled``, the bounds of its signals.
    """
    summary = proof.summary()
    bounds = {name: summary[name] for name in ("bounds", "settled") if name in summary}
    return {"covered": proof.claim.covered, **bounds}


def proved_up_to(
    study: Study,
    name: str,
    bounds: tuple[float, float],
    *,
    log: bool = False,
    boxes: int = SWEEP_BOXES,
    progress: Callable[[int, int | None], None] | None = None,
) -> ProvedReach:
    """Find the furthest value of a number at which the study is proved, by bisection from the range's safe end.

    Every value has its own proof. Each statement holds for loops with this constant value, not for a number that
    varies over the range.

    Args:
        study: The study; its sweep is ignored.
        name: Dotted name of the number, whose law or value is replaced; ``spread`` widens all laws about their medians.
        bounds: Safe end and far end.
        log: Bisect on a logarithmic scale.
        boxes: Largest number of boxes of uncertain numbers that are tried at each value.
        progress: Called after each value with the number of values done, and None, as the total is not known.

    Raises:
        NotCovered: The loop is outside of what a proof covers; the message gives the reason.
        ConfigError: The bounds agree, a logarithmic scale has a bound that is not positive, or the number follows from
            parameters.
    """
    safe, end = bounds
    if safe == end or (log and min(bounds) <= 0.0):
        raise ConfigError("over", f"needs two different{' positive' if log else ''} ends, got {safe:g} and {end:g}")
    study.require_free(name)
    study_at_point = study.without_sweep()
    proofs: dict[float, tuple[float, AnyProved]] = {}

    def proved_at(share: np.ndarray | float) -> bool:
        """Try to prove the study at a share of the way from the safe end to the far end; return whether it is proved.

        The proof is stored in ``proofs`` for the outcome.
        """
        share = float(share)
        value = value_between(bounds, share, log=log)
        proof = prove_problem(problem_at(study_at_point, name, value), boxes)
        if isinstance(proof, Proved):
            proof = replace(proof, units=study.units[0])
        proofs[share] = (value, proof)
        if progress is not None:
            progress(len(proofs), None)
        return proof.complete

    def reach_between(proved_share: float | None, refused_share: float | None) -> ProvedReach:
        """Make the outcome from two shares of the way, at which a proof was tried.

        Args:
            proved_share: The last proved share; None: not even the safe end is proved.
            refused_share: The first share that is not proved; None: the whole range is proved.
        """
        value, proof = (None, None) if proved_share is None else proofs[proved_share]
        refused_value, failure = (None, None) if refused_share is None else proofs[refused_share]
        return ProvedReach(
            name=name,
            values=[(tried_value, outcome.complete) for tried_value, outcome in proofs.values()],
            last=proof,
            proved=value,
            refused=refused_value,
            reason="" if failure is None else failure.reason,
        )

    if not proved_at(0.0):
        return reach_between(None, 0.0)
    if proved_at(1.0):
        return reach_between(1.0, None)
    return reach_between(*map(float, bisect(proved_at, 0.0, 1.0, HALVINGS)))


def value_between(bounds: tuple[float, float], share: float, *, log: bool) -> float:
    """The value at a share of the way from the first bound to the second, on a linear or a logarithmic scale.

    Args:
        bounds: Safe end and far end; positive on a logarithmic scale.
        share: 0 for the safe end, 1 for the far end.
        log: Whether the scale is logarithmic.
    """
    safe, end = bounds
    return safe * (end / safe) ** share if log else safe + share * (end - safe)


def problem_at(study: Study, name: str, value: float) -> AnyProblem:
    """Make the problem of a study in which one number has a given value.

    Args:
        study: The study, without a sweep.
        name: Dotted name of the number; ``spread`` widens all laws about their medians.
        value: The number's value; for ``spread``, the factor on the distance of a law's ends from its median.

    Raises:
        NotCovered: The loop is outside of what a proof covers.
    """
    if name == SAMPLE_TIME:  # replaced in the problem itself, so that the study's duration need not be a multiple of it
        return replace(problem_of(study), sample_time=value)
    return problem_of(study.override(widened_laws(study, value) if name == SPREAD else {name: value}))
