"""Proofs at every point of a study's sweep, by one process for each core."""

import itertools
import multiprocessing
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any

from dssc_jax.core.errors import ConfigError
from dssc_jax.proofs import SWEEP_BOXES
from dssc_jax.proofs.problem import ProofProblem, problem_of
from dssc_jax.results.proofs import SweepProofs
from dssc_jax.study import Study


def prove_sweep(
    study: Study, *, boxes: int = SWEEP_BOXES, progress: Callable[[int, int], None] | None = None
) -> SweepProofs:
    """Prove a study at every point of its sweep.

    Processes are spawned, so a script that calls this needs ``if __name__ == "__main__":``.

    Args:
        study: A study with a sweep; a swept value takes the place of its parameter's law.
        boxes: Largest number of boxes of uncertain numbers that are tried at each point.
        progress: Called with the points done and the number of points.

    Raises:
        NotCovered: The loop is outside of what a proof covers; the message gives the reason.
        ConfigError: ``boxes`` is not positive.
    """
    if boxes < 1:
        raise ConfigError("boxes", f"must be at least 1, got {boxes}")
    began, problems = time.perf_counter(), [problem_of(point) for point in sweep_points(study)]
    outcomes: list[tuple[dict[str, Any], dict[str, Any]]] = []
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(len(problems), os.cpu_count() or 1), mp_context=spawn) as pool:
        for outcome in pool.map(partial(prove_point, boxes=boxes), problems):
            outcomes.append(outcome)
            if progress is not None:
                progress(len(outcomes), len(problems))
    summaries, certificates = ([each[i] for each in outcomes] for i in (0, 1))
    return SweepProofs(study.hash, study.axes, summaries, certificates, time.perf_counter() - began)


def prove_point(problem: ProofProblem, boxes: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """Summary and certificate of one point; runs in a process of its own."""
    from dssc_jax.proofs.prove import prove_problem

    outcome = prove_problem(problem, boxes)
    return outcome.summary(), outcome.certificate()


def sweep_points(study: Study) -> Iterator[Study]:
    """The study at each point of its sweep."""
    single = study.without_sweep()
    for values in itertools.product(*study.axes.values()):
        yield single.override(dict(zip(study.axes, values, strict=True)))
