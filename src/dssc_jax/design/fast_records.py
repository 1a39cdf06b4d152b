"""Check whether the values of a recorded disturbance or wind lie closer together in time than the steps of the run."""

import jax
import numpy as np

from dssc_jax.core.records import HeldRecord, Pieces
from dssc_jax.study import Study

SHORTEST_SHARE = 0.999
"""Distance of two times, in steps, below which they count as closer than a step; it allows for rounding."""


def record_warnings(study: Study) -> list[str]:
    """Warnings of recorded disturbances and winds whose values lie closer together in time than a run resolves.

    A held record acts through its mean over each sample. A record joined by lines or splines acts through its values at
    the stages of the integrator.
    """
    dt = study.loop.sample_time
    step = dt / study.loop.substeps
    duration = study.config.loop.duration
    params_of_slots = {
        "disturbance": (study.template.disturbance, study.template.inputs),
        "wind": study.template.wind,
    }
    warnings = []
    for slot, params in params_of_slots.items():
        records = [leaf for leaf in jax.tree.leaves(params, is_leaf=is_record) if is_record(leaf)]
        held = [record.pieces for record in records if isinstance(record, HeldRecord)]
        joined = [record for record in records if isinstance(record, Pieces)]
        held_distance = shortest_distance(held, duration)
        if held_distance < SHORTEST_SHARE * dt:
            warnings.append(
                f"the recorded {slot} has values {held_distance:.3g} s apart, closer than T_s = {dt:g} s: a held "
                "record acts through its mean over each sample, without what happens within it; if that matters, "
                "lower loop.sample_time"
            )
        joined_distance = shortest_distance(joined, duration)
        if joined_distance < SHORTEST_SHARE * step:
            warnings.append(
                f"the recorded {slot} has values {joined_distance:.3g} s apart, closer than the steps of integration, "
                f"{step:g} s, which may miss some of them: raise loop.substeps, or give fewer values"
            )
    return warnings


def is_record(part: object) -> bool:
    """Whether a part of a study's parameters is a record, held or joined."""
    return isinstance(part, HeldRecord | Pieces)


def shortest_distance(records: list[Pieces], duration: float) -> float:
    """Shortest distance [s] between two successive times of one record; infinite if no record has two times in the run.

    Args:
        records: The records; only times from 0 to the duration count.
        duration: Duration of the run [s].
    """
    distances = []
    for pieces in records:
        begins = np.asarray(pieces.begins)
        is_in_run = (begins >= 0.0) & (begins <= duration)
        distances += np.diff(begins[is_in_run]).tolist()
    return min(distances, default=np.inf)
