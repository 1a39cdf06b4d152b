"""Critical values by simulation: each draw is simulated at each value that the search needs."""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from dssc_jax.analyses.defaults import BISECTIONS, MOST_BISECTIONS, MOST_POINTS, POINTS
from dssc_jax.analyses.margins.result import Margins
from dssc_jax.analyses.margins.search import CLOCK, Critical, FirstViolated, Walk, search_critical
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.design.certification import NotCovered
from dssc_jax.engine.batching import BLOCK, Arrays, Clock, Engine, Layout, drawn, execute
from dssc_jax.engine.evaluation import Evaluator, require_independent
from dssc_jax.study import Study
from dssc_jax.study.laws import SPREAD


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
        study: The study; its own sweep is ignored.
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
    study, began, clock = study.without_sweep(), time.perf_counter(), Clock()
    parted = study.config.loop.duration if over == CLOCK else None
    walk = Walk(*checked_walk(over, bounds, log, points, bisections), log, points, parted)
    find = over_sample_time if over == CLOCK else over_number
    critical, values = find(study, over, walk, bisections, clock, progress or (lambda done, total: None))
    times = {"seconds": time.perf_counter() - began, "compile_seconds": clock.compile_seconds}
    criterion = tuple(requirement.text for requirement in study.requirements) or ("the draw stays finite",)
    margins = Margins.of(study, over, walk, critical, values, times, criterion)
    return replace(margins, proof=proof_along(study, walk, over)) if prove else margins


def proof_along(study: Study, walk: Walk, over: str) -> dict[str, Any]:
    """How far along a walk the sampled loop is proved, or why a proof does not cover it."""
    from dssc_jax.proofs.reach import proved_up_to

    try:
        return proved_up_to(study, over, (walk.start, walk.end), log=walk.log).summary()
    except NotCovered as error:
        return {"over": over, "proved_up_to": None, "statement": f"A proof does not cover the loop: {error}."}


def checked_walk(
    over: str, bounds: tuple[float, float], log: bool, points: int, bisections: int
) -> tuple[float, float]:
    """Check the settings of a walk and return its bounds as floats.

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
    return float(start), float(end)


def placed(study: Study, over: str) -> Callable[[Arrays, np.ndarray], Arrays]:
    """The function that puts the values of the walk into each lane's numbers, replacing a law or as spread."""
    if over != SPREAD:
        return lambda drawn, values: {**drawn, over: values}
    return lambda drawn, values: {name: study.laws[name].spread(column, values) for name, column in drawn.items()}


def require_spread(study: Study, bounds: tuple[float, float]) -> None:
    """Require that the laws can be widened over the given bounds.

    Raises:
        ConfigError: there is no law, or a draw leaves a number's range.
    """
    if not any(law.movable for law in study.laws.values()):
        raise ConfigError(SPREAD, "nothing is uncertain that could be widened; give at least one number a law")
    if min(bounds) < 0.0:
        raise ConfigError(SPREAD, f"must be >= 0, got {bounds[0]:g} and {bounds[1]:g}")
    columns = drawn(study, slice(0, study.config.draws))
    beyond = [text for name, column in columns.items() if (text := out_of_range(study, name, column, max(bounds)))]
    if beyond:
        widest = max(bounds)
        most = widest * largest_share(
            lambda share: not any(out_of_range(study, *column, share * widest) for column in columns.items())
        )
        rule = f"{'; '.join(beyond)} at {SPREAD} = {widest:g}; all stay in their ranges up to {SPREAD} = {most:.4g}"
        raise ConfigError(SPREAD, f"{rule}; loguniform and lognormal laws never reach 0")


def out_of_range(study: Study, name: str, column: np.ndarray, spread: float) -> str | None:
    """How a widened number leaves its range; None if it does not."""
    widest = study.laws[name].spread(column, spread)
    low, high = float(widest.min()), float(widest.max())
    broken = study.quantities[name].violated_by(low, high)
    return f"{name} {broken}, got [{low:.4g}, {high:.4g}]" if broken else None


def largest_share(holds: Callable[[float], bool]) -> float:
    """The largest number in [0, 1] up to which a condition holds, rounded down to 1/1024."""
    low, high = 0, 1024
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if holds(middle / 1024) else (low, middle)
    return low / 1024


def over_number(
    study: Study, over: str, walk: Walk, bisections: int, clock: Clock, progress: ProgressCallback
) -> tuple[Critical, Arrays]:
    """Critical values of a traced number, and the drawn numbers: one program for all blocks of draws."""
    if over == SPREAD:
        require_spread(study, (walk.start, walk.end))
    draws, evaluations, place = study.config.draws, walk.points + bisections, placed(study, over)
    extents = {} if over == SPREAD else {over: (walk.start, walk.end)}
    evaluator = Evaluator(study, extents, min(draws, BLOCK))
    evaluator.engine.clock = clock
    parts, columns = [], []
    for begin in range(0, draws, evaluator.lanes):
        indices = np.arange(begin, min(begin + evaluator.lanes, draws))
        laws = evaluator.drawn(slice(begin, begin + len(indices)))
        first = FirstViolated(len(indices), walk.start)

        def slack_of(which: np.ndarray, values: np.ndarray, indices=indices, laws=laws, first=first) -> np.ndarray:
            chosen = {name: column[which] for name, column in laws.items()}
            slack = first.slack(which, values, evaluator.swept, evaluator(indices[which], place(chosen, values)))
            progress(clock.lanes, evaluations * draws)
            return slack

        parts.append(search_critical(slack_of, len(indices), walk, bisections)._replace(violated=first.which))
        columns.append(laws)
    joined = {name: np.concatenate([part[name] for part in columns]) for name in columns[0]}
    return Critical(*(np.concatenate(arrays, axis=-1) for arrays in zip(*parts, strict=True))), joined


def over_sample_time(
    study: Study, over: str, walk: Walk, bisections: int, clock: Clock, progress: ProgressCallback
) -> tuple[Critical, Arrays]:
    """Critical sample times on the grid: the clock is fixed before tracing, so each value needs a separate program.

    Raises:
        ConfigError: two values of the grid fall on the same number of samples.
    """
    del bisections
    if len(set(walk.grid)) < walk.points:
        raise ConfigError(over, f"{walk.points} points fall on fewer numbers of samples; take fewer, or wider bounds")
    studies = {value: study.override({over: float(value)}) for value in walk.grid}  # all checked before the first runs
    columns: Arrays = {}
    first = FirstViolated(study.config.draws, walk.start)

    def slack_of(which: np.ndarray, values: np.ndarray) -> np.ndarray:
        at = studies[values[0]]
        layout = Layout.of(at)
        engine = Engine(at, layout.lanes, clock=clock)
        parts = list(execute(engine, layout.blocks()))
        columns.update({name: np.concatenate([part[name] for _, _, part in parts]) for name in at.laws})
        progress(clock.lanes, len(studies) * len(which))
        results = {name: np.concatenate([part[name] for _, part, _ in parts]) for name in parts[0][1]}
        return first.slack(which, values, at, results)

    return search_critical(slack_of, study.config.draws, walk, bisections=0)._replace(violated=first.which), columns
