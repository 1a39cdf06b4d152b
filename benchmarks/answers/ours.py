"""Our answers: ``python -m benchmarks.answers.ours MODEL BOUND TASK`` prints JSON as ``peers.py`` does.

A task is asked twice, with two seeds: the first answer is that of a cold process.
"""

import json
import sys
import time
from collections.abc import Callable

BEGAN = time.perf_counter()

import numpy as np  # noqa: E402

import dssc_jax as dj  # noqa: E402
from benchmarks.answers.studies import study_of  # noqa: E402

WIDE, NARROW = 0.02, 0.002  # of intervals of +-1 % and +-0.1 %
VARIATION = 0.13  # leaves a factor of 1.3 in 95 % of the cases
SOBOL_HALF_WIDTH = 0.05
FIRST_ROWS, MOST_ROWS = 256, 4096
WILKS = 59  # draws of a 95/95 limit
POINTS, BISECTIONS = 17, 2  # of a margin: a lattice of 65 values
REGION_DRAWS, HALVINGS = 240, 2
PAIRS = {
    "axis": (dj.RegionAxis("unmodelled.mu", 0.02, 1.0, True), dj.RegionAxis("disturbance.value", 0.0, 0.6)),
    "vehicle": (dj.RegionAxis("wind.speed", 0.0, 10.0), dj.RegionAxis("plant.vehicle.mass", 10.0, 12.0)),
}
WALKS = {"axis": ("unmodelled.mu", (0.02, 1.0)), "vehicle": ("wind.speed", (0.0, 12.0))}


def probability(study: dj.Study, width: float) -> tuple[int, object, int]:
    answer = dj.probability(study, width).answer
    return answer.simulations, answer.interval, answer.plain_draws


def rare(study: dj.Study, splitting: bool) -> tuple[int, object, int]:
    how = dj.Splitting(plain=1024)
    if splitting:
        answer = dj.rare(study, None, how).answer
    else:
        answer = dj.rare(study, dj.ImportanceSampling(VARIATION), None).answer
    return answer.simulations + answer.plain.draws, answer.interval, round(min(answer.plain_draws, 1e15))


def sobol(study: dj.Study) -> tuple[int, object, int]:
    """Indices of the first requirement's metric; rows are doubled, and only the last sample counts."""
    rows = FIRST_ROWS
    while True:
        answer = dj.sensitivity(study.override({"draws": rows})).answer
        found = answer.outputs[answer.headline[0]]
        widths = [np.inf]
        if found:
            ends = [
                interval for factor in found.values() for interval in (factor.first_interval, factor.total_interval)
            ]
            widths = [0.5 * (high - low) for low, high in ends]
        if max(widths) <= SOBOL_HALF_WIDTH:
            return answer.simulations, max(widths), 0
        if rows >= MOST_ROWS:
            return 0, None, 0
        rows *= 2


def margin(study: dj.Study, model: str) -> tuple[int, object, int]:
    over, bounds = WALKS[model]
    drawn = study.override({"draws": WILKS})
    answer = dj.margin(drawn, over=over, bounds=bounds, points=POINTS, bisections=BISECTIONS).answer
    values = (POINTS - 1) * 2**BISECTIONS + 1
    return WILKS * (POINTS + BISECTIONS), answer.lower_tolerance, WILKS * values


def region(study: dj.Study, model: str) -> tuple[int, object, int]:
    answer = dj.region(study.override({"draws": REGION_DRAWS}), over=PAIRS[model], halvings=HALVINGS).answer
    return answer.simulations, (answer.meets, answer.fails), REGION_DRAWS * int(np.prod(answer.lattice))


def best_gains(study: dj.Study) -> tuple[int, object, int]:
    """The ten best of 1,024 gains, to a difference of 0.02; plain: as many draws for every candidate."""
    answer = dj.select(study).answer
    return answer.simulations, answer.within, answer.equal_simulations


TASKS: dict[str, Callable[[dj.Study, str], tuple[int, object, int]]] = {
    "probability 1 %": lambda study, _: probability(study, WIDE),
    "probability 0.1 %": lambda study, _: probability(study, NARROW),
    "rare": lambda study, _: rare(study, splitting=False),
    "splitting": lambda study, _: rare(study, splitting=True),
    "Sobol": lambda study, _: sobol(study),
    "margin": margin,
    "region": region,
    "best gains": lambda study, _: best_gains(study),
}
"""Each gives the evaluations that it took, its answer, and the evaluations of plain Monte Carlo."""


def main(model: str, bound: str, task: str) -> None:
    began = BEGAN
    for seed in (1,) if task == "splitting" else (1, 2):  # splitting takes minutes
        evaluations, answer, plain = TASKS[task](study_of(model, bound).override({"seed": seed}), model)
        seconds = time.perf_counter() - began
        row = {"evaluations": evaluations, "seconds": seconds, "answer": answer, "plain": plain}
        print(json.dumps(row, default=float), flush=True)
        began = time.perf_counter()


if __name__ == "__main__":
    main(*sys.argv[1:])
