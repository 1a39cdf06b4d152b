"""Critical values by simulation: each draw is simulated at each value that the search needs."""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from dssc_jax.analyses.defaults import BISECTIONS, MOST_BISECTIONS, MOST_POINTS, POINTS
from dssc_jax.analyses.margins.result import Margins
from dssc_jax.analyses.margins.search import CLOCK, Critical, FirstViolated, Walk, search_critical
from dssc_jax.core.bisection import bisect
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.json_types import JsonObject
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.design.certification import NotCovered
from dssc_jax.engine.batching import BLOCK, Clock, Engine, Layout, execute, values_of_draws
from dssc_jax.engine.evaluation import Evaluator, require_independent
from dssc_jax.engine.sampling import Arrays
from dssc_jax.study import Study, takes_file
from dssc_jax.study.laws import SPREAD

SPREAD_HALVINGS = 10  # in the search for the largest admissible spread
CriticalDraws: TypeAlias = tuple[Critical, Arrays]
"""Critical values of draws, and the drawn numbers by name."""


@takes_file
def margin(
    study: Study,
    *,
    over: str,
    bounds: tuple[float, float],
    log: bool = False,
    points: int = POINTS,
    bisections: int = BISECTIONS,
    prove: bool = False,
    progress: ProgressCallback | None = None,
) -> Margins:
    """Find the critical value of one number of the loop for every draw of a study.

    The number replaces its law; everything else is drawn. With ``spread`` instead of a number, all laws are widened
    together: each drawn number's distance from the median is scaled by the value, in the logarithm if the law is
    logarithmic. The critical values are then margins of the uncertainty as a whole, and the degradation curve is the
    failure probability over nested laws with the same draws. If there are no requirements, a draw fails if it becomes
    non-finite.

    Args:
        study: The study, or its file; its own sweep is ignored.
        over: Dotted name of the number, e.g. ``unmodelled.mu``, or ``spread``. ``loop.sample_time`` is fixed before
            tracing: its grid is rounded to whole numbers of samples, with one program for each value and no bisection.
        bounds: The safe end, where draws are expected to pass, then the other end, which may be the smaller one.
        log: Space the values evenly in the logarithm.
        points: Number of values in the bracketing grid. A failure between two neighbouring values is not noticed if the
            draw passes at both.
        bisections: Number of bisections of the grid cell.
        prove: Also prove the sampled loop along the walk, for all plants of the laws at once, as far as a proof is
            found (:func:`dssc_jax.proved_up_to`).
        progress: Called with the lanes done.

    Raises:
        ConfigError: the number, or a bound, is not admissible, or the draws are not independent.

    Example:
        >>> import dssc_jax as dj
        >>> study = dj.Study.load("studies/mu_robustness.toml").override({"draws": 8, "loop.duration": 45.0})
        >>> swift = study.override({"controller.functions.tau_av": 0.003})
        >>> margins = dj.margin(swift, over="unmodelled.mu", bounds=(0.02, 2.0), log=True, points=5, bisections=4)
        >>> margins.summary()["censored"]
        0.0
    """
    require_independent(study, "a margin")
    began = time.perf_counter()
    study = study.without_sweep()
    clock = Clock()
    parted = study.config.loop.duration if over == CLOCK else None
    walk = admissible_walk(over, bounds, log, points, bisections, parted)
    report = progress or (lambda done, total: None)
    if over == CLOCK:
        critical, values = sample_time_margins(study, walk, clock, report)
    else:
        critical, values = number_margins(study, over, walk, bisections, clock, report)
    seconds = time.perf_counter() - began
    criterion = tuple(requirement.text for requirement in study.requirements) or ("the draw stays finite",)
    margins = Margins.of(study, over, walk, critical, values, criterion, seconds, clock.compile_seconds)
    return replace(margins, proof=proof_along(study, walk, over)) if prove else margins


def proof_along(study: Study, walk: Walk, over: str) -> JsonObject:
    """How far along a walk the sampled loop is proved, or why a proof does not cover it."""
    from dssc_jax.proofs.reach import proved_up_to

    try:
        return proved_up_to(study, over, (walk.start, walk.end), log=walk.log).summary()
    except NotCovered as error:
        return {"over": over, "proved_up_to": None, "statement": f"A proof does not cover the loop: {error}."}


def admissible_walk(
    over: str,
    bounds: tuple[float, float],
    log: bool,
    points: int,
    bisections: int,
    parted: float | None = None,
) -> Walk:
    """The walk of a search.

    Raises:
        ConfigError: the bounds are equal, not finite, or not positive where they must be, or a count is out of range.
    """
    start, end = bounds
    if not (math.isfinite(start) and math.isfinite(end)) or start == end:
        raise ConfigError(over, f"the bounds must be two different finite numbers, got {start:g} and {end:g}")
    if log and not min(bounds) > 0.0:
        raise ConfigError(over, f"a logarithmic walk needs bounds > 0, got {start:g} and {end:g}")
    if over == CLOCK and not min(bounds) > 0.0:
        raise ConfigError(over, f"must be > 0, got {start:g} and {end:g}")
    if not 2 <= points <= MOST_POINTS:
        raise ConfigError("points", f"must be in 2 .. {MOST_POINTS}, got {points}")
    if not 0 <= bisections <= MOST_BISECTIONS:
        raise ConfigError("bisections", f"must be in 0 .. {MOST_BISECTIONS}, got {bisections}")
    return Walk(float(start), float(end), log, points, parted)


def lane_numbers(study: Study, over: str) -> Callable[[Arrays, np.ndarray], Arrays]:
    """(drawn numbers, values of the walk) -> the numbers of each lane: a value replaces the law, or widens all laws."""
    if over != SPREAD:
        return lambda numbers, values: {**numbers, over: values}
    return lambda numbers, values: {name: study.laws[name].spread(column, values) for name, column in numbers.items()}


def require_spread(study: Study, bounds: tuple[float, float]) -> None:
    """Require that the laws can be widened over the given bounds.

    Raises:
        ConfigError: there is no law, or a draw leaves a number's range.
    """
    if not any(law.movable for law in study.laws.values()):
        raise ConfigError(SPREAD, "nothing is uncertain that could be widened; give at least one number a law")
    if min(bounds) < 0.0:
        raise ConfigError(SPREAD, f"must be >= 0, got {bounds[0]:g} and {bounds[1]:g}")
    columns = values_of_draws(study, slice(0, study.config.draws))
    widest = max(bounds)
    violations = range_violations(study, columns, widest)
    if violations:
        share, _ = bisect(
            lambda share: not range_violations(study, columns, float(share) * widest), 0.0, 1.0, SPREAD_HALVINGS
        )
        rule = f"{'; '.join(violations)} at {SPREAD} = {widest:g}"
        limit = f"all stay in their ranges up to {SPREAD} = {widest * float(share):.4g}"
        raise ConfigError(SPREAD, f"{rule}; {limit}; loguniform and lognormal laws never reach 0")


def range_violations(study: Study, columns: Arrays, spread: float) -> list[str]:
    """The numbers that leave their ranges if the laws are widened, in words."""
    widened = {name: study.laws[name].spread(column, spread) for name, column in columns.items()}
    return [f"{name} {rule}" for name, rule in study.violations(widened).items()]


def number_margins(
    study: Study, over: str, walk: Walk, bisections: int, clock: Clock, progress: ProgressCallback
) -> CriticalDraws:
    """Critical values of a traced number, and the drawn numbers: one program for all blocks of draws."""
    if over == SPREAD:
        require_spread(study, (walk.start, walk.end))
    draws = study.config.draws
    total = (walk.points + bisections) * draws
    numbers_at = lane_numbers(study, over)
    extents = {} if over == SPREAD else {over: (walk.start, walk.end)}
    evaluator = Evaluator(study, extents, min(draws, BLOCK))
    evaluator.engine.clock = clock
    blocks: list[CriticalDraws] = []
    for begin in range(0, draws, evaluator.lanes):
        indices = np.arange(begin, min(begin + evaluator.lanes, draws))
        laws = evaluator.values_of_draws(slice(begin, begin + len(indices)))
        violated = FirstViolated(len(indices), walk.start)

        def slack_at(
            lanes: np.ndarray, values: np.ndarray, indices=indices, laws=laws, violated=violated
        ) -> np.ndarray:
            drawn_numbers = {name: column[lanes] for name, column in laws.items()}
            results = evaluator(indices[lanes], numbers_at(drawn_numbers, values))
            slack = violated.slack(lanes, values, evaluator.swept, results)
            progress(clock.lanes, total)
            return slack

        critical = search_critical(slack_at, len(indices), walk, bisections)
        blocks.append((critical._replace(violated=violated.requirement), laws))
    fields = zip(*(critical for critical, _ in blocks), strict=True)
    critical = Critical(*(np.concatenate(arrays, axis=-1) for arrays in fields))
    numbers = {name: np.concatenate([laws[name] for _, laws in blocks]) for name in blocks[0][1]}
    return critical, numbers


def sample_time_margins(study: Study, walk: Walk, clock: Clock, progress: ProgressCallback) -> CriticalDraws:
    """Critical sample times on the grid: the clock is fixed before tracing, so each value needs a separate program.

    Raises:
        ConfigError: two values of the grid fall on the same number of samples, or it follows from parameters.
    """
    study.require_free(CLOCK)
    if len(set(walk.grid)) < walk.points:
        rule = f"{walk.points} points fall on fewer numbers of samples; take fewer, or wider bounds"
        raise ConfigError(CLOCK, rule)
    studies = {value: study.override({CLOCK: float(value)}) for value in walk.grid}  # checks all before the first run
    numbers: Arrays = {}
    violated = FirstViolated(study.config.draws, walk.start)

    def slack_at(draws: np.ndarray, values: np.ndarray) -> np.ndarray:
        study_at_value = studies[values[0]]
        layout = Layout.of(study_at_value)
        engine = Engine(study_at_value, layout.lanes, clock=clock)
        blocks = list(execute(engine, layout.blocks()))
        for name in study_at_value.laws:
            numbers[name] = np.concatenate([laws[name] for _, _, laws in blocks])
        progress(clock.lanes, len(studies) * len(draws))
        results = {name: np.concatenate([block[name] for _, block, _ in blocks]) for name in blocks[0][1]}
        return violated.slack(draws, values, study_at_value, results)

    critical = search_critical(slack_at, study.config.draws, walk, bisections=0)
    return critical._replace(violated=violated.requirement), numbers
