"""Critical values by simulation: each draw is simulated at each value that the search needs."""

import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dssc_jax.analyses.conditions import criterion_of
from dssc_jax.analyses.defaults import BISECTIONS, MOST_BISECTIONS, MOST_POINTS, POINTS
from dssc_jax.analyses.margins.result import Margins
from dssc_jax.analyses.margins.search import (
    CLOCK,
    CriticalDraws,
    CriticalValues,
    FirstViolated,
    Walk,
    join_critical,
    search_critical,
)
from dssc_jax.core.bisection import bisect
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.json_types import JsonObject
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.design.certification import NotCovered
from dssc_jax.engine.batching import BLOCK, Engine, Layout, execute, join_batches, values_of_draws
from dssc_jax.engine.clock import Clock
from dssc_jax.engine.evaluation import Evaluator, require_independent
from dssc_jax.engine.sampling import Arrays
from dssc_jax.study import Study, takes_file
from dssc_jax.study.laws import SPREAD

SPREAD_HALVINGS = 10  # halvings in the search for the largest admissible spread


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
    """Find the critical value of a number of the loop for every draw: the last value before the draw first fails.

    The value of the walk replaces the law of the number; all other uncertain numbers are drawn. With ``spread`` instead
    of a number, all laws are widened together: each drawn number's distance from its median is multiplied by the value
    of the walk, in the logarithm if the law is logarithmic. The critical values are then margins of the uncertainty as
    a whole, and the degradation curve is the failure probability over nested laws with the same draws. Without
    requirements, a draw fails if it becomes non-finite.

    Args:
        study: The study, or its file; its own sweep is ignored.
        over: Dotted name of the number, e.g. ``unmodelled.mu``, or ``spread``. The grid of ``loop.sample_time`` is
            rounded to values that divide the flight into whole samples. Each of its values needs a program of its own,
            since the sample time is fixed before tracing, and there is no bisection.
        bounds: The safe end, where draws are expected to pass, then the other end, which may be smaller.
        log: Space the values evenly in the logarithm.
        points: Number of values in the bracketing grid. A failure between two neighbouring values is not noticed if the
            draw passes at both.
        bisections: Number of bisections of the grid cell.
        prove: Also prove the sampled loop along the walk, for all plants of the laws at once, as far as a proof is
            found (:func:`dssc_jax.proved_up_to`).
        progress: Called with the lanes done (one simulation of one draw each) and their largest number.

    Raises:
        ConfigError: The number, or a bound, is not admissible, or the draws are not independent.

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
    duration_of_flight = study.config.loop.duration if over == CLOCK else None
    walk = admissible_walk(over, bounds, log, points, bisections, parted=duration_of_flight)
    report = progress or (lambda done, total: None)
    if over == CLOCK:
        draws = critical_sample_times(study, walk, clock, report)
    else:
        draws = critical_numbers(study, over, walk, bisections, clock, report)
    margins = Margins.of(
        study,
        over,
        walk,
        draws,
        criterion=criterion_of(study),
        seconds=time.perf_counter() - began,
        compile_seconds=clock.compile_seconds,
    )
    return replace(margins, proof=prove_along(study, walk, over)) if prove else margins


def prove_along(study: Study, walk: Walk, over: str) -> JsonObject:
    """Find the range of a walk for which the sampled loop is proved, or the reason why no proof covers it, as JSON.

    Args:
        study: The study without a sweep.
        walk: The walk of a number.
        over: Dotted name of the number.
    """
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
    """Make the walk of a search, if its settings are admissible.

    For a sample time, the ends of the walk are moved from the bounds to sample times within the bounds that divide the
    flight into whole samples.

    Args:
        over: Dotted name of the number.
        bounds: The safe end, then the other end.
        log: Whether the values are even in the logarithm.
        points: Number of values in the bracketing grid.
        bisections: Number of bisections of a grid cell.
        parted: Duration of the flight [s] if the number is the sample time, as in :class:`Walk`; otherwise None.

    Raises:
        ConfigError: The bounds are equal, not finite, or not positive where they must be, or a count is out of range.
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
    walk = Walk(start=float(start), end=float(end), log=log, points=points, parted=parted)
    if parted is None:
        return walk
    first, *_, last = walk.grid.tolist()
    return replace(walk, start=first, end=last)


def numbers_along(study: Study, over: str) -> Callable[[Arrays, np.ndarray], Arrays]:
    """Return a function that puts the values of a walk into drawn numbers: (numbers, values) -> the numbers of n lanes.

    Numbers and values have the shape (n,) each. A value of the walk replaces the drawn value of the walked number. With
    ``spread``, the value multiplies the distance of every drawn number from the median of its law.

    Args:
        study: The study, for its laws.
        over: Dotted name of the number, or ``spread``.
    """

    def with_number(numbers: Arrays, values: np.ndarray) -> Arrays:
        """Return the drawn numbers, with other values of the walked number."""
        return {**numbers, over: values}

    def with_spread(numbers: Arrays, values: np.ndarray) -> Arrays:
        """Return the drawn numbers under laws that are widened by the factors ``values``."""
        return {name: study.laws[name].spread(column, values) for name, column in numbers.items()}

    return with_spread if over == SPREAD else with_number


def require_spread(study: Study, bounds: tuple[float, float]) -> None:
    """Refuse a study whose laws cannot be widened by every factor within the bounds.

    Args:
        study: The study.
        bounds: Both ends of the walk of ``spread``, the factor.

    Raises:
        ConfigError: No law can be widened, a factor is negative, or widened draws leave the admissible range of a
            number; the message then has the largest factor at which all draws stay inside.
    """
    if not any(law.movable for law in study.laws.values()):
        raise ConfigError(SPREAD, "nothing is uncertain that could be widened; give at least one number a law")
    if min(bounds) < 0.0:
        raise ConfigError(SPREAD, f"must be >= 0, got {bounds[0]:g} and {bounds[1]:g}")
    columns = values_of_draws(study, slice(0, study.config.draws))
    widest = max(bounds)
    violations = range_violations(study, columns, widest)
    if not violations:
        return

    def stays_inside(share: np.ndarray) -> bool:
        """Whether all draws stay in the admissible ranges if laws are widened by this share of the largest factor."""
        return not range_violations(study, columns, float(share) * widest)

    share, _ = bisect(stays_inside, inside=0.0, outside=1.0, halvings=SPREAD_HALVINGS)
    rule = f"{'; '.join(violations)} at {SPREAD} = {widest:g}"
    limit = f"all stay in their ranges up to {SPREAD} = {widest * float(share):.4g}"
    raise ConfigError(SPREAD, f"{rule}; {limit}; loguniform and lognormal laws never reach 0")


def range_violations(study: Study, columns: Arrays, spread: float) -> list[str]:
    """One clause for the error message for each number that leaves its admissible range if all laws are widened.

    Args:
        study: The study.
        columns: Value of each uncertain number in each draw, shape (draws,) each.
        spread: The factor by which all laws are widened.
    """
    widened = {name: study.laws[name].spread(column, spread) for name, column in columns.items()}
    return [f"{name} {rule}" for name, rule in study.violations(widened).items()]


def critical_numbers(
    study: Study, over: str, walk: Walk, bisections: int, clock: Clock, progress: ProgressCallback
) -> CriticalDraws:
    """Find the critical values of a number that is an input of the compiled program, block by block of draws.

    Args:
        study: The study without a sweep.
        over: Dotted name of the number, or ``spread``.
        walk: The walk to search.
        bisections: Number of bisections of a grid cell.
        clock: Counts lanes (simulations of one draw each) and compile time.
        progress: Called with the lanes done and their largest number.
    """
    if over == SPREAD:
        require_spread(study, (walk.start, walk.end))
    draws = study.config.draws
    total = (walk.points + bisections) * draws
    numbers_at = numbers_along(study, over)
    extents = {} if over == SPREAD else {over: (walk.start, walk.end)}
    evaluator = Evaluator(study, extents, min(draws, BLOCK))
    evaluator.engine.clock = clock

    def report() -> None:
        """Report the lanes done so far."""
        progress(clock.lanes, total)

    blocks: list[CriticalValues] = []
    block_numbers: list[Arrays] = []
    for begin in range(0, draws, evaluator.lanes):
        block = slice(begin, min(begin + evaluator.lanes, draws))
        draws_of_block = critical_block(evaluator, block, numbers_at, walk, bisections, report)
        blocks.append(draws_of_block.critical)
        block_numbers.append(draws_of_block.uncertain_values)
    return CriticalDraws(join_critical(blocks), join_batches(block_numbers))


def critical_block(
    evaluator: Evaluator,
    block: slice,
    numbers_at: Callable[[Arrays, np.ndarray], Arrays],
    walk: Walk,
    bisections: int,
    report: Callable[[], None],
) -> CriticalDraws:
    """Find the critical values of a block of draws, which are simulated together.

    Args:
        evaluator: The compiled study.
        block: The draws, from the first index to the index after the last.
        numbers_at: Puts values of the walk into drawn numbers, as :func:`numbers_along` returns it.
        walk: The walk to search.
        bisections: Number of bisections of the grid cell.
        report: Called after each batch of simulations.
    """
    indices = np.arange(block.start, block.stop)
    laws = evaluator.values_of_draws(block)
    violated = FirstViolated(len(indices), walk.start)

    def slack_at(lanes: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Simulate draws of the block, each at a value of the walk, record what they violate, and return their slacks.

        ``lanes`` are positions of draws within the block, shape (m,).
        """
        drawn_numbers = {name: column[lanes] for name, column in laws.items()}
        results = evaluator(indices[lanes], numbers_at(drawn_numbers, values))
        slack = violated.record(lanes, values, evaluator.swept, results)
        report()
        return slack

    critical = search_critical(slack_at, len(indices), walk, bisections)
    return CriticalDraws(critical._replace(first_violated=violated.requirement), laws)


def critical_sample_times(study: Study, walk: Walk, clock: Clock, progress: ProgressCallback) -> CriticalDraws:
    """Find critical sample times on the grid of a walk.

    The sample time is fixed before tracing, so each value needs a program of its own, and there is no bisection.

    Args:
        study: The study without a sweep.
        walk: The walk of the sample time.
        clock: Counts lanes and compile time.
        progress: Called with the lanes done and their total.

    Raises:
        ConfigError: Two values of the grid fall on the same number of samples, or the sample time follows from
            parameters.
    """
    study.require_free(CLOCK)
    if len(set(walk.grid)) < walk.points:
        rule = f"{walk.points} points fall on fewer numbers of samples; take fewer, or wider bounds"
        raise ConfigError(CLOCK, rule)
    studies = {value: study.override({CLOCK: float(value)}) for value in walk.grid}  # checks all before the first run
    numbers: Arrays = {}
    violated = FirstViolated(study.config.draws, walk.start)

    def slack_at(draws: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Simulate all draws at one sample time, record what they violate, and return their slacks.

        All entries of ``values`` are this sample time: without bisection, all draws are tried at one grid value after
        the other.
        """
        study_at_value = studies[values[0]]
        layout = Layout.of(study_at_value)
        engine = Engine(study_at_value, layout.lanes, clock=clock)
        blocks = list(execute(engine, layout.blocks()))
        numbers.update(join_batches([laws for _, _, laws in blocks]))
        progress(clock.lanes, len(studies) * len(draws))
        results = join_batches([results for _, results, _ in blocks])
        return violated.record(draws, values, study_at_value, results)

    critical = search_critical(slack_at, study.config.draws, walk, bisections=0)
    return CriticalDraws(critical._replace(first_violated=violated.requirement), numbers)
