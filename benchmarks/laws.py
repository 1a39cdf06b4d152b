"""How wrong may the laws be? Regenerates the measured parts of docs/laws.md: ``make laws``.

How often the bounds hold on problems with known answers, for three failure probabilities and three numbers of draws;
and the packaged vehicle. Exits with 1 where a statement with 95 % confidence holds in less than 93 % of all cases.
With a word (``laws.py vehicle``) only that part runs.
"""

import sys
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy import stats

import dssc_jax as dj
from benchmarks.page import put
from dssc_jax.analyses.laws.law_tables import median_ends
from dssc_jax.analyses.laws.ranged_draws import RangedDraws, mixture_values
from dssc_jax.statistics import CONFIDENCE, clopper_pearson
from dssc_jax.statistics.any_failures import AnyFailures
from dssc_jax.statistics.divergence_balls import BALLS
from dssc_jax.statistics.law_changes import Shift, Widening
from dssc_jax.statistics.partition import part_information
from dssc_jax.statistics.worst_changes import WeightedDraws, largest_change
from dssc_jax.study.laws import Law, RangedLaw

PAGE = Path(__file__).parents[1] / "docs" / "laws.md"
REPETITIONS, CHEAP = 200, 4000
"""Repetitions of a search over the weights, and of a bound in closed form."""
LEAST = 0.93
LIMITS = {0.2: 0.3, 0.05: 0.1, 0.01: 0.03}
"""Failure probabilities, and the limit that each of them may not exceed."""
DRAWS = (256, 1024, 4096)
PART = np.array([2.0, 1.0, 0.0]) / np.sqrt(5.0)
"""How three numbers take part in the failure; the last one does not."""
STATED = 0.15
BOX_PART = np.array([2.0, 1.0, 0.5])
BOXES = 200
LEVELS = 1000
"""Of each part of a law, for the failure probability in closed form."""
ROUNDING = 1e-9
VEHICLE_DRAWS, VEHICLE_LIMIT, NEW_DRAWS = 8192, 0.1, 1024
Statement = Callable[[WeightedDraws, WeightedDraws, float, float], bool | None]
"""(draws weighted for shifts, and for widenings, p, limit) -> whether a statement holds; None: refused."""


def edge(p: float) -> float:
    """Distance of a half space of probability p."""
    return float(stats.norm.isf(p))


def interval_of(draws: WeightedDraws) -> tuple[float, float]:
    """The exact interval of the failure probability."""
    low, high = clopper_pearson(np.count_nonzero(draws.failed), len(draws.failed), CONFIDENCE)
    return float(low), float(high)


def radii(shifts: WeightedDraws, _: WeightedDraws, p: float, limit: float) -> bool:
    """No radius is larger than the one at which the limit is reached."""
    high = interval_of(shifts)[1]
    return all(ball.largest_radius(high, limit) <= ball.largest_radius(p, limit) for ball in BALLS.values())


def guaranteed(shifts: WeightedDraws, _: WeightedDraws, p: float, limit: float) -> bool:
    """A half space of which all free numbers are equal parts attains the guaranteed shift."""
    bounds = AnyFailures(shifts.change.precision, interval_of(shifts))
    truth = (edge(p) - edge(limit)) / np.sqrt(len(PART))
    return bounds.largest_shift(shifts.free, limit) <= truth


def shift(shifts: WeightedDraws, _: WeightedDraws, p: float, limit: float) -> bool | None:
    """The largest shift of all means by the weights."""
    found = largest_change(shifts, limit)
    return None if found.explored == 0.0 else found.bound <= (edge(p) - edge(limit)) / np.abs(PART).sum()


def widening(_: WeightedDraws, widenings: WeightedDraws, p: float, limit: float) -> bool | None:
    """The largest widening of all laws by the weights."""
    found = largest_change(widenings, limit)
    return None if found.explored == 0.0 else found.bound <= np.log(edge(p) / edge(limit))


def stated(shifts: WeightedDraws, _: WeightedDraws, p: float, limit: float) -> bool | None:
    """The interval of the failure probability if all means may be wrong by a stated shift."""
    interval = shifts.interval_within(STATED)
    reach = STATED * np.abs(PART).sum()
    low, high = stats.norm.sf(edge(p) + np.array([reach, -reach]))
    return None if interval is None else bool(interval[0] <= low and high <= interval[1])


def removed(number: int) -> Statement:
    """The share of the variance that knowing the part of one number removes."""

    def statement(shifts: WeightedDraws, _: WeightedDraws, p: float, limit: float) -> bool | None:
        known = part_information(stats.norm.cdf(shifts.scores[:, number]), shifts.failed, limit)
        if known is None:
            return None
        shares = part_probabilities(p, number, known.parts)
        truth = float(np.mean(shares**2) / p**2 - 1.0) * p / (1.0 - p)
        low, high = known.removed_interval
        return low - ROUNDING <= truth <= high + ROUNDING

    return statement


def changes(number: int) -> Statement:
    """The probability that knowing the part of one number changes the decision."""

    def statement(shifts: WeightedDraws, _: WeightedDraws, p: float, limit: float) -> bool | None:
        known = part_information(stats.norm.cdf(shifts.scores[:, number]), shifts.failed, limit)
        if known is None:
            return None
        truth = float(np.mean(part_probabilities(p, number, known.parts) > limit))
        low, high = known.changes_interval
        return low - ROUNDING <= truth <= high + ROUNDING

    return statement


@lru_cache
def part_probabilities(p: float, number: int, parts: int) -> np.ndarray:
    """The failure probability of the half space in each part of a number's law, by the midpoint rule."""
    levels = (np.arange(parts * LEVELS) + 0.5) / (parts * LEVELS)
    rest = np.sqrt(1.0 - PART[number] ** 2)
    return stats.norm.sf((edge(p) - PART[number] * stats.norm.ppf(levels)) / rest).reshape(parts, LEVELS).mean(axis=1)


def failing_median(shifts: WeightedDraws, _: WeightedDraws, p: float, limit: float) -> bool | None:
    """The median level of the first number in failed draws."""
    low, high = median_ends(stats.norm.cdf(shifts.scores[shifts.failed, 0]), CONFIDENCE)
    return None if np.isnan(low) else low <= median_level(p) <= high


def random_box(rng: np.random.Generator) -> dict[str, RangedLaw]:
    """Three normal laws; at least one of all means and standard deviations is a range."""
    laws = {}
    for name in "abc":
        mean, deviation = rng.uniform(-0.5, 0.5), rng.uniform(0.7, 1.3)
        ranges = (mean, mean + rng.uniform(0.05, 0.5)), (deviation, deviation * rng.uniform(1.02, 1.4))
        known = rng.random(2) < 0.3
        known[0] &= not known[1]
        kept = tuple((low, low) if fixed else (low, high) for (low, high), fixed in zip(ranges, known, strict=True))
        laws[name] = RangedLaw("normal", tuple(float(np.mean(pair)) for pair in kept), kept)
    return laws


def normal_half_space(laws: Mapping[str, Law], distance: float) -> float:
    """The failure probability of PART . x beyond a distance under normal laws."""
    means, deviations = np.transpose([law.arguments for law in laws.values()])
    return float(stats.norm.sf((distance - BOX_PART @ means) / np.linalg.norm(BOX_PART * deviations)))


def middle_edge(laws: Mapping[str, RangedLaw], p: float) -> float:
    """The distance beyond which the middle of a box fails with a probability."""
    means, deviations = np.transpose([law.arguments for law in laws.values()])
    return float(BOX_PART @ means + np.linalg.norm(BOX_PART * deviations) * edge(p))


def drawn_box(laws: dict[str, RangedLaw], count: int, rng: np.random.Generator, distance: float) -> RangedDraws:
    """Draws of the mixtures of a box, which fail beyond a distance."""
    levels = rng.random((count, len(laws)))
    values = {name: mixture_values(law, levels[:, i]) for i, (name, law) in enumerate(laws.items())}
    failed = np.stack(list(values.values()), axis=1) @ BOX_PART > distance
    return RangedDraws(laws, values, failed, CONFIDENCE)


def boxes() -> bool:
    """Write in how many of random boxes the interval holds the failure probability of a random law of the box."""
    rows = ["| p in the middle of the box | draws | boxes | hold the random law's | hold those of all laws |"]
    rows.append("|---" * 5 + "|")
    missed = 0
    for p in LIMITS:
        for count in DRAWS:
            held = [box_case(p, count, seed) for seed in range(BOXES)]
            told = np.array([one for one in held if one is not None]).reshape(-1, 2)
            missed += int(np.count_nonzero(~told[:, 0]))
            counts = np.count_nonzero(told, axis=0)
            rows.append(f"| {p:g} | {count:,} | {len(told)} | {counts[0]} | {counts[1]} |")
            print(rows[-1], flush=True)
    put("boxes of laws", "\n".join(rows), PAGE)
    return missed == 0


def box_case(p: float, count: int, seed: int) -> tuple[bool, bool] | None:
    """Whether the interval of a random box holds the truth of a random law of it, and of all; None: refused."""
    rng = np.random.default_rng([1, seed])
    laws = random_box(rng)
    distance = middle_edge(laws, p)
    draws = drawn_box(laws, count, rng, distance)
    if not draws.trusted:
        return None
    low, high = draws.lowest().interval[0], draws.highest().interval[1]
    one = normal_half_space(draws.laws_at(rng.uniform(*np.transpose(draws.bounds))), distance)
    truths = [normal_half_space(draws.laws_at(corner), distance) for corner in draws.corners]
    return low <= one <= high, low <= min(truths) and max(truths) <= high


@lru_cache
def median_level(p: float) -> float:
    """The level of the first number below which half of the failures lie."""
    parts = part_probabilities(p, 0, 10_000)
    return float(np.interp(0.5, np.cumsum(parts) / parts.sum(), (np.arange(10_000) + 1.0) / 10_000))


STATEMENTS: dict[str, tuple[Statement, int]] = {
    "total variation, KL, chi-square": (radii, CHEAP),
    "shift whatever draws fail": (guaranteed, CHEAP),
    "shift by the weights": (shift, REPETITIONS),
    "widening by the weights": (widening, REPETITIONS),
    f"failure probability under a shift of {STATED:g}": (stated, REPETITIONS),
    "variance removed by knowing the first number": (removed(0), CHEAP),
    "variance removed by knowing the second number": (removed(1), CHEAP),
    "variance removed by knowing the third number": (removed(2), CHEAP),
    "knowing the first number changes the decision": (changes(0), CHEAP),
    "knowing the second number changes the decision": (changes(1), CHEAP),
    "median of the first number in failed draws": (failing_median, CHEAP),
}


def synthetic(p: float, draws: int, seed: int) -> tuple[WeightedDraws, WeightedDraws]:
    """Draws that fail in a half space, weighted for shifts and for widenings."""
    scores = np.random.default_rng(seed).standard_normal((draws, len(PART)))
    failed = scores @ PART > edge(p)
    every = np.ones(len(PART), bool)
    unit = np.eye(len(PART))
    return (
        WeightedDraws(Shift(unit), scores, failed, every, CONFIDENCE),
        WeightedDraws(Widening(unit), scores, failed, every, CONFIDENCE),
    )


def coverage_rows() -> Iterator[tuple[str, float]]:
    """A row of the table for each statement, with the least share of cases in which it holds."""
    for name, (statement, repetitions) in STATEMENTS.items():
        cells = []
        least = 1.0
        for p, limit in LIMITS.items():
            for draws in DRAWS:
                held = [statement(*synthetic(p, draws, seed), p, limit) for seed in range(repetitions)]
                told = [one for one in held if one is not None]
                if len(told) < repetitions // 10:
                    cells.append("refused")
                    continue
                share = float(np.mean(told))
                least = min(least, share)
                refused = repetitions - len(told)
                cells.append(
                    f"{100 * share:.1f} %" + (f" ({100 * refused / repetitions:.0f} % refused)" if refused else "")
                )
        yield f"| {name} | {' | '.join(cells)} |", least


def coverage() -> bool:
    """Write the table of coverage; whether each statement holds often enough."""
    columns = [f"p = {p:g}, {draws:,}" for p in LIMITS for draws in DRAWS]
    rows = [f"| statement | {' | '.join(columns)} |", "|---" * (len(columns) + 1) + "|"]
    least = 1.0
    for row, share in coverage_rows():
        rows.append(row)
        print(row, flush=True)
        least = min(least, share)
    put("coverage of laws", "\n".join(rows), PAGE)
    return least >= LEAST


def vehicle() -> bool:
    """Write what the packaged vehicle says; whether new draws agree with the weights."""
    study = dj.Study.load("uav_robustness").override({"draws": VEHICLE_DRAWS})
    found = dj.laws(study, limit=VEHICLE_LIMIT, within={"kl": 0.005}, shift=0.1, fresh=NEW_DRAWS)
    answer = found.answer
    low, high = answer.failure.interval
    fresh = found.fresh
    assert fresh is not None  # some vehicles fail
    rows = [
        f"{answer.failure.failures:,} of {answer.draws:,} vehicles fail: [{low:.3g}, {high:.3g}]. At most "
        f"{100 * answer.limit:g} % fail up to",
        "",
        f"| | with 95 % confidence | estimate | whatever draws fail | {NEW_DRAWS:,} new draws |",
        "|---|---|---|---|---|",
    ]
    for name, ball in BALLS.items():
        rows.append(f"| {ball.title} | {getattr(answer, name):.3g} | {getattr(answer.estimates, name):.3g} | | |")
    for name, text in (
        ("mean_shift", "shift of all means, in standard deviations"),
        ("widening", "relative width of all laws"),
    ):
        weights = found.weights[name]
        estimate = "not reached" if weights.estimate is None else f"{weights.estimate:.3g}"
        always = getattr(answer.guaranteed, name)
        new = fresh.changes[name].estimate
        told = "not reached" if new is None else f"{new:.3g}"
        rows.append(f"| {text} | {getattr(answer, name):.3g} | {estimate} | {always:.3g} | {told} |")
    rows += ["", "| one law alone | shift of its mean | estimate | its median may be |", "|---|---|---|---|"]
    reached = {name: law for name, law in answer.by_law.items() if law.mean_shift_estimate is not None}
    for name, law in sorted(reached.items(), key=lambda entry: entry[1].mean_shift):
        unit = study.quantities[name].unit
        median = f"{law.shifted_median:.3g} {unit} instead of {law.median:.3g}" if law.shifted_median else ""
        rows.append(f"| `{name}` | {law.mean_shift:.3g} | {law.mean_shift_estimate:.3g} | {median} |")
    others = len(answer.by_law) - len(reached)
    rows += ["", f"The means of the other {others} numbers do not lead to the limit as far as the weights tell."]
    rows += ["", "| known to a tenth of its law | variance removed | decision changes |", "|---|---|---|"]
    for name, law in answer.by_law.items():
        knowledge = law.knowledge
        if knowledge is None or knowledge.removed_interval[0] <= 0.0:
            continue
        low, high = knowledge.removed_interval
        removed = f"{100 * knowledge.removed:.1f} % [{100 * low:.1f}, {100 * high:.1f}]"
        low, high = knowledge.changes_interval
        changes = f"{100 * knowledge.changes:.0f} % [{100 * low:.0f}, {100 * high:.0f}]"
        rows.append(f"| `{name}` | {removed} | {changes} |")
    rows.append("")
    for stated_error in answer.stated:
        ends = stated_error.weighted_interval or stated_error.interval
        assert ends is not None  # the vehicle's laws are not correlated
        what = (
            "within a Kullback-Leibler divergence of"
            if stated_error.kind == "kl"
            else "with all means shifted by up to"
        )
        rows.append(f"The failure probability {what} {stated_error.amount:g} lies in [{ends[0]:.3g}, {ends[1]:.3g}].")
    print("\n".join(rows))
    put("vehicle", "\n".join(rows), PAGE)
    new_shift = fresh.changes["mean_shift"].estimate
    return new_shift is not None and answer.mean_shift < new_shift


def main(words: list[str]) -> int:
    parts = {"vehicle": vehicle, "coverage": coverage, "boxes": boxes}
    held = [part() for name, part in parts.items() if not words or name in words]
    return 0 if all(held) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
