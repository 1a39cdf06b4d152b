"""Our answers: ``python -m benchmarks.answers.ours MODEL BOUND TASK`` prints JSON as ``peers.py`` does.

A task is asked twice, with two seeds: the first answer is that of a cold process.
"""

import json
import math
import sys
import time
from collections.abc import Callable

BEGAN = time.perf_counter()

import numpy as np  # noqa: E402

import dssc_jax as dj  # noqa: E402
from benchmarks.answers.studies import study_of  # noqa: E402
from dssc_jax.closed_loop.metrics.requirements import worst_slack  # noqa: E402
from dssc_jax.engine.batching import BLOCK, Engine, evaluate, is_noisy  # noqa: E402
from dssc_jax.engine.sampling import inside_cube, values_at  # noqa: E402

WIDE, NARROW = 0.02, 0.002  # of intervals of +-1 % and +-0.1 %
VARIATION = 0.13  # leaves a factor of 1.3 in 95 % of the cases
SOBOL_HALF_WIDTH = 0.05
FIRST_ROWS, MOST_ROWS = 256, 32_768
PLAIN_ROWS = 1024  # from which the cost of plain Sobol indices is told
NORMAL = 1.959964
WILKS = 59  # draws of a 95/95 limit
POINTS, BISECTIONS = 9, 3  # of a margin: as fine as a lattice of 65 values
REGION_DRAWS, HALVINGS = 240, 2
MASS = dj.RegionAxis("plant.vehicle.mass", 10.0, 12.0)
PAIRS = {
    "axis": (dj.RegionAxis("unmodelled.mu", 0.02, 1.0, True), dj.RegionAxis("disturbance.value", 0.0, 0.6)),
    "gust": (dj.RegionAxis("wind.x", 0.0, 30.0), MASS),
    "turbulence": (dj.RegionAxis("wind.speed", 0.0, 10.0), MASS),
}
WALKS = {
    "axis": ("unmodelled.mu", (0.02, 1.0)),
    "gust": ("wind.x", (0.0, 30.0)),
    "turbulence": ("wind.speed", (0.0, 12.0)),
}
GAINS = {
    "controller.l0": (0.05, 1.0),
    "controller.rho": (1.0, 6.0),
    "controller.functions.kappa_o": (10.0, 1000.0),
    "controller.functions.kappa_m": (0.2, 20.0),
    "controller.functions.tau_av": (0.003, 0.3),
}
"""Of the vehicle's x and y axes; those of the axis follow from its study."""

ONCE = ("splitting", "probability 0.1 %")  # tasks that take minutes are asked once


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
    """Indices of the requirement's metric; rows are doubled, and only the last sample counts."""
    rows = FIRST_ROWS
    while True:
        answer = dj.sensitivity(study.override({"draws": rows})).answer
        found = answer.outputs[study.requirements[0].measure.name]
        widths = [np.inf]
        if found:
            ends = [
                interval for factor in found.values() for interval in (factor.first_interval, factor.total_interval)
            ]
            widths = [0.5 * (high - low) for low, high in ends]
        if max(widths) <= SOBOL_HALF_WIDTH:
            return answer.simulations, max(widths), plain_sobol(study)
        if rows >= MOST_ROWS:
            return 0, None, 0
        rows *= 2


def plain_sobol(study: dj.Study) -> int:
    """Evaluations that the textbook's estimators of the indices take with independent draws.

    A first-order index is mean(f_B (f_AB - f_A))/V, a total index is mean((f_A - f_AB)^2)/(2 V).
    """
    engine = Engine(study, BLOCK)
    noisy = is_noisy(engine)
    factors = len(study.laws) + noisy
    base = np.random.default_rng(study.config.seed).random((2, PLAIN_ROWS, factors))
    samples = [base[0], base[1]]
    for column in range(factors):
        samples.append(np.where(np.arange(factors) == column, base[1], base[0]))
    outputs = []
    for sample in samples:
        draws = np.arange(PLAIN_ROWS)
        if noisy:
            draws = np.where(sample[:, -1] == base[0, :, -1], draws, draws + PLAIN_ROWS)
        results = evaluate(engine, values_at(study, inside_cube(sample[:, : len(study.laws)])), draws)
        outputs.append(worst_slack(study.requirements, results))
    f_a, f_b = (outputs[k] - np.mean(outputs[:2]) for k in (0, 1))
    f_ab = np.stack(outputs[2:]) - np.mean(outputs[:2])
    variance = 0.5 * (f_a**2 + f_b**2)
    shares = np.concatenate([f_b * (f_ab - f_a), 0.5 * (f_a - f_ab) ** 2])
    errors = shares - variance * shares.mean(axis=1, keepdims=True) / variance.mean()
    largest = float(np.max(errors.std(axis=1))) / float(variance.mean())
    return math.ceil((NORMAL * largest / SOBOL_HALF_WIDTH) ** 2) * len(samples)


def margin(study: dj.Study, model: str) -> tuple[int, object, int]:
    over, bounds = WALKS[model]
    drawn = study.override({"draws": WILKS})
    answer = dj.margin(drawn, over=over, bounds=bounds, points=POINTS, bisections=BISECTIONS).answer
    values = (POINTS - 1) * 2**BISECTIONS + 1
    return WILKS * (POINTS + BISECTIONS), answer.lower_tolerance, WILKS * values


def region(study: dj.Study, model: str) -> tuple[int, object, int]:
    answer = dj.region(study.override({"draws": REGION_DRAWS}), over=PAIRS[model], halvings=HALVINGS).answer
    return answer.simulations, (answer.meets, answer.fails), REGION_DRAWS * int(np.prod(answer.lattice))


def best_gains(study: dj.Study, model: str) -> tuple[int, object, int]:
    """The ten best of 1,024 gains, to a difference of 0.02; plain: as many draws for every candidate."""
    answer = dj.select(study, over=None if model == "axis" else GAINS).answer
    return answer.simulations, answer.within, answer.equal_simulations


TASKS: dict[str, Callable[[dj.Study, str], tuple[int, object, int]]] = {
    "probability 1 %": lambda study, _: probability(study, WIDE),
    "probability 0.1 %": lambda study, _: probability(study, NARROW),
    "rare": lambda study, _: rare(study, splitting=False),
    "splitting": lambda study, _: rare(study, splitting=True),
    "Sobol": lambda study, _: sobol(study),
    "margin": margin,
    "region": region,
    "best gains": best_gains,
}
"""Each gives the evaluations that it took, its answer, and the evaluations of plain Monte Carlo."""


def main(model: str, bound: str, task: str) -> None:
    began = BEGAN
    for seed in (1,) if task in ONCE else (1, 2):
        evaluations, answer, plain = TASKS[task](study_of(model, bound).override({"seed": seed}), model)
        seconds = time.perf_counter() - began
        row = {"evaluations": evaluations, "seconds": seconds, "answer": answer, "plain": plain}
        print(json.dumps(row, default=float), flush=True)
        began = time.perf_counter()


if __name__ == "__main__":
    main(*sys.argv[1:])
