"""Failure probabilities too small for plain draws: adaptive multilevel splitting on the worst requirement's margin.

A population of particles, points of the standard normal space behind the draws, is pushed towards failure: those with
the largest margins die, clones of the others take their places and move on by a Markov chain that never goes back
above the level. With J levels, each of which k of N particles did not pass, the estimate is prod (1 - k_j/N).

In-loop noise is part of a particle: a clone keeps the draw index of its parent until a move redraws it, which half of
the moves propose. A fixed index would answer for one realisation of the noise only.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy import special

from dssc_jax.engine import Arrays, Engine, evaluate, is_noisy
from dssc_jax.errors import ConfigError
from dssc_jax.requirements import worst_margin
from dssc_jax.sampling import generator, inside, values_at
from dssc_jax.statistics import CONFIDENCE, replicate_interval
from dssc_jax.study import Study

Margin = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Margins, shape (n,), of points (n, d) in standard normal space with noise indices (n,); negative: failure."""

FIRST_STEP, LEAST_STEP = 0.7, 0.02  # size of a move in standard normal space; it adapts to what is accepted
ACCEPTED = 0.35  # share of moves to accept
REFRESHED = 0.5  # share of moves that redraw the in-loop noise
MOST_LEVELS = 100_000


@dataclass(frozen=True)
class Splitting:
    """How much to spend.

    Args:
        particles: N of each repeat.
        killed: k of N at each level; 1 is the last-particle form, whose law is known: J ~ Poisson(-N ln p).
        moves: Steps of a clone's Markov chain at each level.
        repeats: Independent repeats, from whose scatter the interval comes; at least 10.
        smallest: Give up on a repeat whose estimate falls below; it counts as 0.

    Raises:
        ConfigError: a number is out of range.
    """

    particles: int = 200
    killed: int = 100
    moves: int = 5
    repeats: int = 20
    smallest: float = 1e-12

    def __post_init__(self) -> None:
        if self.particles < 10 or not 0 < self.killed < self.particles:
            found = f"{self.particles} and {self.killed}"
            raise ConfigError("rare", f"needs particles >= 10 and 0 < killed < particles, got {found}")
        if self.repeats < 10 or self.moves < 1 or not 0.0 < self.smallest < 1.0:
            found = f"{self.repeats}, {self.moves} and {self.smallest}"
            raise ConfigError("rare", f"needs repeats >= 10, moves >= 1 and smallest in (0, 1), got {found}")


@dataclass
class Repeat:
    """One repeat of the splitting.

    Args:
        rng: Its own generator.
        points: Particles in standard normal space, shape (N, d).
        noise: Their noise indices, shape (N,).
        margins: Shape (N,).
        step: Size of a move.
        estimate: Product over the levels passed.
        levels: How many were passed.
        dead: Every particle stood on one level, or the estimate became too small: the repeat's answer is 0.
    """

    rng: np.random.Generator
    points: np.ndarray
    noise: np.ndarray
    margins: np.ndarray
    step: float = FIRST_STEP
    estimate: float = 1.0
    levels: int = 0
    dead: bool = False


@dataclass(frozen=True)
class Estimate:
    """A rare event's probability.

    Args:
        estimates: Of each independent repeat, shape (R,).
        levels: Levels that each repeat passed, shape (R,).
        simulations: Evaluations of the margin, all repeats together.
        points: Failing particles of all repeats in standard normal space, shape (n, d).
        noise: Their noise indices, shape (n,).
    """

    estimates: np.ndarray
    levels: np.ndarray
    simulations: int
    points: np.ndarray = field(repr=False)
    noise: np.ndarray = field(repr=False)

    @property
    def probability(self) -> float:
        """Mean over the repeats."""
        return float(self.estimates.mean())

    @property
    def variation(self) -> float:
        """Coefficient of variation of :attr:`probability`, from the scatter of the repeats."""
        if self.probability == 0.0:
            return np.inf
        return float(self.estimates.std(ddof=1) / np.sqrt(len(self.estimates)) / self.probability)

    def interval(self, confidence: float = CONFIDENCE) -> tuple[float, float]:
        """Student's t interval over the repeats, not below 0; without a failing repeat it says nothing: [0, 1]."""
        if self.probability == 0.0:
            return 0.0, 1.0
        low, high = replicate_interval(self.estimates, len(self.estimates), confidence)
        return max(float(low), 0.0), min(float(high), 1.0)

    @property
    def plain_draws(self) -> float:
        """Plain draws that would reach the same coefficient of variation."""
        p = self.probability
        return (1.0 - p) / (p * self.variation**2) if p > 0.0 and self.variation > 0.0 else np.inf


def split(margin: Margin, dimension: int, words: Sequence[int], how: Splitting = Splitting()) -> Estimate:
    """Adaptive multilevel splitting; all repeats move at once, so that margins are computed in large batches.

    Args:
        margin: The margins; -inf where there is none.
        dimension: d of the standard normal space.
        words: Seeds of the random numbers.
        how: How much to spend.

    Reference:
        A. Guyader, N. Hengartner, E. Matzner-Lober, Applied Mathematics and Optimization 64 (2011) 171-196;
        S.-K. Au, J. L. Beck, Probabilistic Engineering Mechanics 16 (2001) 263-277; moves after
        I. Papaioannou et al., Probabilistic Engineering Mechanics 41 (2015) 89-103.
    """
    counter = Counter(margin)
    repeats = [started(generator(*words, index), dimension, how, counter) for index in range(how.repeats)]
    for repeat, margins in zip(repeats, np.split(counter.of(repeats, slice(None)), how.repeats), strict=True):
        repeat.margins = margins
    for _ in range(MOST_LEVELS):
        moving = [(repeat, *raised(repeat, how)) for repeat in repeats if not done(repeat, how)]
        moving = [(repeat, level, clones) for repeat, level, clones in moving if len(clones)]
        if not moving:
            break
        for _ in range(how.moves):
            move(moving, counter)
    failing = [repeat.margins < 0.0 for repeat in repeats]
    return Estimate(
        estimates=np.array([0.0 if r.dead else r.estimate * f.mean() for r, f in zip(repeats, failing, strict=True)]),
        levels=np.array([repeat.levels for repeat in repeats]),
        simulations=counter.simulations,
        points=np.concatenate([repeat.points[f] for repeat, f in zip(repeats, failing, strict=True)]),
        noise=np.concatenate([repeat.noise[f] for repeat, f in zip(repeats, failing, strict=True)]),
    )


class Counter:
    """A margin that counts its evaluations and hands out fresh noise indices."""

    def __init__(self, margin: Margin) -> None:
        self.margin, self.simulations, self.indices = margin, 0, 0

    def fresh(self, count: int) -> np.ndarray:
        """Noise indices that no particle has had."""
        self.indices += count
        return np.arange(self.indices - count, self.indices)

    def __call__(self, points: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """Margins; what has none fails."""
        self.simulations += len(points)
        found = self.margin(points, noise)
        return np.where(np.isnan(found), -np.inf, found)

    def of(self, repeats: list[Repeat], particles: slice) -> np.ndarray:
        """Margins of particles of all repeats, in one batch."""
        return self(
            np.concatenate([repeat.points[particles] for repeat in repeats]),
            np.concatenate([repeat.noise[particles] for repeat in repeats]),
        )


def started(rng: np.random.Generator, dimension: int, how: Splitting, counter: Counter) -> Repeat:
    """A repeat before its first level."""
    points = rng.standard_normal((how.particles, dimension))
    return Repeat(rng, points, counter.fresh(how.particles), np.full(how.particles, np.nan))


def done(repeat: Repeat, how: Splitting) -> bool:
    """Whether the next level would lie at failure or beyond; also marks repeats that are too small to go on with."""
    repeat.dead = repeat.dead or repeat.estimate < how.smallest
    return repeat.dead or bool(np.partition(repeat.margins, -how.killed)[-how.killed] < 0.0)


def raised(repeat: Repeat, how: Splitting) -> tuple[float, np.ndarray]:
    """The next level, and the particles that clones of the others replace.

    Ties die together. Particles that fail already are never killed, hence the level is 0 at least: at the last one
    those die that do not fail.

    Returns:
        The level, which clones must stay below, and the clones' positions; none where nobody survives.
    """
    level = float(np.partition(repeat.margins, -how.killed)[-how.killed])
    dying = repeat.margins >= level
    survivors = np.flatnonzero(~dying)
    if not len(survivors):
        repeat.dead = True
        return level, survivors
    clones = np.flatnonzero(dying)
    parents = repeat.rng.choice(survivors, len(clones))
    repeat.estimate *= len(survivors) / len(repeat.margins)
    repeat.levels += 1
    for values in (repeat.points, repeat.noise, repeat.margins):
        values[clones] = values[parents]
    return level, clones


def move(moving: list[tuple[Repeat, float, np.ndarray]], counter: Counter) -> None:
    """One step of every clone's chain: z' = sqrt(1 - s^2) z + s xi, accepted below the level.

    The step s follows the share accepted, in each repeat by itself; slowly where few move, since a step that answers
    to the last move of the same particle would change what the chain converges to.
    """
    proposals, indices = [], []
    for repeat, _, clones in moving:
        fresh = repeat.rng.standard_normal((len(clones), repeat.points.shape[1]))
        proposals.append(np.sqrt(1.0 - repeat.step**2) * repeat.points[clones] + repeat.step * fresh)
        redrawn = repeat.rng.random(len(clones)) < REFRESHED
        indices.append(np.where(redrawn, counter.fresh(len(clones)), repeat.noise[clones]))
    margins = counter(np.concatenate(proposals), np.concatenate(indices))
    ends = np.cumsum([len(clones) for *_, clones in moving])[:-1]
    for (repeat, level, clones), points, noise, found in zip(
        moving, proposals, indices, np.split(margins, ends), strict=True
    ):
        accepted = found < level
        repeat.points[clones[accepted]] = points[accepted]
        repeat.noise[clones[accepted]] = noise[accepted]
        repeat.margins[clones[accepted]] = found[accepted]
        weight = len(clones) / len(repeat.margins)
        repeat.step = float(np.clip(repeat.step * np.exp(weight * (accepted.mean() - ACCEPTED)), LEAST_STEP, 1.0))


@dataclass(frozen=True)
class RareEvent:
    """A study's rare failure.

    Args:
        study: The study.
        how: What was spent.
        estimate: The probability and how it was found.
        noisy: Whether the loop has in-loop noise.
        where: Values of each uncertain number among the failing particles, shape (n,).
    """

    study: Study
    how: Splitting
    estimate: Estimate
    noisy: bool
    where: Arrays

    def to_dict(self, confidence: float = CONFIDENCE) -> dict[str, Any]:
        """For JSON: quantiles of each number among failures stand beside its median."""
        found = self.estimate
        levels = (0.05, 0.5, 0.95)
        return {
            "study": self.study.name,
            "requirements": [r.text for r in self.study.requirements],
            "probability": found.probability,
            "interval": list(found.interval(confidence)),
            "interval_method": f"Student's t over {self.how.repeats} independent repeats",
            "confidence": confidence,
            "variation": found.variation,
            "simulations": found.simulations,
            "plain_draws": found.plain_draws,
            "estimates": found.estimates.tolist(),
            "levels": found.levels.tolist(),
            "in_loop_noise": self.noisy,
            "where": {
                name: {
                    "median": self.study.laws[name].median,
                    "failing": np.quantile(values, levels).tolist() if len(values) else None,
                }
                for name, values in self.where.items()
            },
            "particles": self.how.particles,
            "killed": self.how.killed,
            "moves": self.how.moves,
            "repeats": self.how.repeats,
        }


def rare(study: Study, how: Splitting = Splitting(), progress: Callable[[int], None] | None = None) -> RareEvent:
    """The failure probability of a study at its own values, by splitting on the worst requirement's scaled margin.

    Args:
        study: The study; a sweep is left aside, so is its number of draws.
        how: How much to spend.
        progress: Told of the simulations done.

    Raises:
        ConfigError: the study requires nothing, or nothing is uncertain.
    """
    study = study.without_sweep()
    if not study.requirements:
        raise ConfigError(study.source, "rare needs at least one [[requirement]]: its margin leads to the failures")
    if not study.laws:
        raise ConfigError(study.source, "nothing is uncertain; give at least one number a law")
    engine = Engine(study, how.repeats * how.killed)
    finished = 0

    def margin(points: np.ndarray, noise: np.ndarray) -> np.ndarray:
        nonlocal finished
        results = evaluate(engine, values_at(study, inside(special.ndtr(points))), noise)
        finished += len(points)
        if progress:
            progress(finished)
        return worst_margin(study.requirements, results)

    estimate = split(margin, len(study.laws), (study.config.seed,), how)
    where = values_at(study, inside(special.ndtr(estimate.points)))
    return RareEvent(study, how, estimate, is_noisy(engine), where)
