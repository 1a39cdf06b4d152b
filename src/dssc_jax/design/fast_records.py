"""Whether a recorded disturbance or wind has values that lie closer together than the steps of the run."""

import jax
import numpy as np

from dssc_jax.core.records import HeldRecord, Pieces
from dssc_jax.study import Study

SHORTEST_SHARE = 0.999
"""Least distance of two times over the step: times on the grid of the steps have roundings."""


def record_warnings(study: Study) -> list[str]:
    """Warnings of recorded disturbances and winds that are finer than a run resolves.

    A held record acts through its mean over each sample, one joined by lines or splines through its values at the
    stages of the integrator.
    """
    dt = study.loop.sample_time
    step = dt / study.loop.substeps
    template = study.template
    warnings = []
    for slot, params in (("disturbance", (template.disturbance, template.inputs)), ("wind", template.wind)):
        records = [leaf for leaf in jax.tree.leaves(params, is_leaf=is_record) if is_record(leaf)]
        held = [record.pieces for record in records if isinstance(record, HeldRecord)]
        joined = [record for record in records if isinstance(record, Pieces)]
        distance = shortest_distance(held, study.config.loop.duration)
        if distance < SHORTEST_SHARE * dt:
            warnings.append(
                f"the recorded {slot} has values {distance:.3g} s apart, closer than T_s = {dt:g} s: a held record "
                "acts through its mean over each sample, without what happens within it; if that matters, lower "
                "loop.sample_time"
            )
        distance = shortest_distance(joined, study.config.loop.duration)
        if distance < SHORTEST_SHARE * step:
            warnings.append(
                f"the recorded {slot} has values {distance:.3g} s apart, closer than the steps of integration, "
                f"{step:g} s, which may miss some of them: raise loop.substeps, or give fewer values"
            )
    return warnings


def is_record(part: object) -> bool:
    """Whether a part of a study's parameters is a record."""
    return isinstance(part, HeldRecord | Pieces)


def shortest_distance(records: list[Pieces], duration: float) -> float:
    """Shortest distance of two times of one record within a run of a duration [s]; infinite if there are none."""
    distances = []
    for pieces in records:
        begins = np.asarray(pieces.begins)
        distances += np.diff(begins[(begins >= 0.0) & (begins <= duration)]).tolist()
    return min(distances, default=np.inf)
