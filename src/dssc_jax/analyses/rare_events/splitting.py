"""Adaptive multilevel splitting: the probability that a slack is negative, if too small for plain draws alone.

A population of particles, points of the standard normal space behind the draws, is pushed towards failure. The
particles with the largest slacks die. Clones of the others replace them and move by a Markov chain that never returns
above the level. With J levels, each of which k of N particles did not pass, the estimate is prod (1 - k_j/N).

In-loop noise is part of a particle: a clone keeps the draw index of its parent until a move redraws it, which half of
the moves propose. A fixed index would give the answer for one realisation of the noise only.

If the slack does not lead to some kind of failure, every particle may miss it. Plain draws are therefore made as well.
If they contradict the particles, their answer is reported instead.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dssc_jax.analyses.defaults import LEAST_PARTICLES, LEAST_REPEATS, MOVES, PARTICLES, PLAIN, REPEATS
from dssc_jax.analyses.rare_events.estimate import Counter, Estimate, SlackFunction, plain_draws
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import stream
from dssc_jax.engine.sampling import generator
from dssc_jax.statistics import CONFIDENCE, lognormal_interval

FIRST_STEP = 0.7  # size of a move in standard normal space; it adapts to what is accepted
SMALLEST_STEP = 0.02
ACCEPTED = 0.35  # share of moves to accept
REFRESHED = 0.5  # share of moves that redraw the in-loop noise
MOST_LEVELS = 100_000


@dataclass(frozen=True)
class Splitting:
    """The settings of a splitting.

    Args:
        particles: N of each repeat.
        killed: k of N at each level; 1 is the last-particle form, whose law is known: J ~ Poisson(-N ln p).
        moves: Number of moves of a clone's Markov chain at each level.
        repeats: Number of independent repeats, whose scatter gives the interval; at least 10.
        smallest: Stop a repeat whose estimate falls below this value; it counts as 0.
        plain: Number of additional plain draws.

    Raises:
        ConfigError: a number is out of range.
    """

    particles: int = PARTICLES
    killed: int = PARTICLES // 2
    moves: int = MOVES
    repeats: int = REPEATS
    smallest: float = 1e-12
    plain: int = PLAIN

    def __post_init__(self) -> None:
        if self.particles < LEAST_PARTICLES or not 0 < self.killed < self.particles:
            rule = f"needs particles >= {LEAST_PARTICLES} and 0 < killed < particles"
            raise ConfigError("rare", f"{rule}, got {self.particles} and {self.killed}")
        if self.repeats < LEAST_REPEATS or self.moves < 1 or not 0.0 < self.smallest < 1.0:
            rule = f"needs repeats >= {LEAST_REPEATS}, moves >= 1 and smallest in (0, 1)"
            raise ConfigError("rare", f"{rule}, got {self.repeats}, {self.moves} and {self.smallest}")
        if self.plain < 1:
            raise ConfigError("rare", f"needs plain >= 1, got {self.plain}")


USUAL = Splitting()
"""The default settings."""


@dataclass
class Repeat:
    """One repeat of the splitting.

    Args:
        rng: Its random generator.
        points: Particles in standard normal space, shape (N, d).
        noise: Their noise indices, shape (N,).
        slacks: Their slacks, shape (N,).
        step: Size of a move.
        estimate: Product over the levels passed.
        levels: Number of levels passed.
        dead: Every particle was at the same level, or the estimate became too small: the repeat's answer is 0.
    """

    rng: np.random.Generator
    points: np.ndarray
    noise: np.ndarray
    slacks: np.ndarray
    step: float = FIRST_STEP
    estimate: float = 1.0
    levels: int = 0
    dead: bool = False

    @property
    def failing(self) -> np.ndarray:
        """Which particles fail, shape (N,)."""
        return self.slacks < 0.0

    @property
    def answer(self) -> float:
        """The repeat's failure probability."""
        return 0.0 if self.dead else self.estimate * float(self.failing.mean())


class Clones(NamedTuple):
    """The particles of a repeat that a level has replaced by clones.

    Args:
        repeat: The repeat.
        level: The level, below which they have to stay.
        places: Their indices in the population, shape (clones,).
    """

    repeat: Repeat
    level: float
    places: np.ndarray


@dataclass(frozen=True)
class SplittingEstimate(Estimate):
    """The estimate of a splitting; its failing particles have equal weights.

    Args:
        estimates: Estimate of each independent repeat, shape (R,).
        levels: Number of levels that each repeat passed, shape (R,).
    """

    estimates: np.ndarray
    levels: np.ndarray

    @property
    def mean(self) -> float:
        """Mean over the repeats."""
        return float(self.estimates.mean())

    def mean_interval(self, confidence: float = CONFIDENCE) -> tuple[float, float]:
        """Interval from the repeats alone; [0, 1] if fewer than two of them reach a failure.

        An estimate is a product of shares, so its logarithm is nearly normal: :func:`lognormal_interval`.
        """
        low, high = lognormal_interval(self.estimates, confidence)
        return min(low, 1.0), min(high, 1.0)

    @property
    def reached(self) -> bool:
        """Whether repeats reached failures by levels; without a level they amount to fewer plain draws."""
        return self.mean > 0.0 and bool(self.levels.any())

    @property
    def interval_name(self) -> str:
        """See :class:`Estimate`."""
        return f"lognormal mean over {len(self.estimates)} independent repeats"

    @property
    def variation(self) -> float:
        """Coefficient of variation of :attr:`mean`, from the scatter of the repeats."""
        if self.mean == 0.0:
            return np.inf
        return float(self.estimates.std(ddof=1) / np.sqrt(len(self.estimates)) / self.mean)


def split(
    slack: SlackFunction, dimension: int, seeds: Sequence[int], splitting: Splitting = USUAL
) -> SplittingEstimate:
    """Run adaptive multilevel splitting, and additional plain draws.

    All repeats advance together, so that slacks are computed in large batches.

    Args:
        slack: Computes the slacks; -inf if there is none.
        dimension: d of the standard normal space.
        seeds: Seeds of the random numbers.
        splitting: The settings.

    Reference:
        A. Guyader, N. Hengartner, E. Matzner-Lober, Applied Mathematics and Optimization 64 (2011) 171-196;
        S.-K. Au, J. L. Beck, Probabilistic Engineering Mechanics 16 (2001) 263-277; moves after
        I. Papaioannou et al., Probabilistic Engineering Mechanics 41 (2015) 89-103.
    """
    counter = Counter(slack)
    repeats = [started(generator(*seeds, index), dimension, splitting, counter) for index in range(splitting.repeats)]
    for repeat, slacks in zip(repeats, np.split(slacks_of(repeats, counter), splitting.repeats), strict=True):
        repeat.slacks = slacks
    for _ in range(MOST_LEVELS):
        moving = []
        for repeat in repeats:
            repeat.dead = repeat.dead or repeat.estimate < splitting.smallest
            if not is_finished(repeat, splitting):
                clones = raised(repeat, splitting)
                if clones is not None:
                    moving.append(clones)
        if not moving:
            break
        for _ in range(splitting.moves):
            move(moving, counter)
    simulations = counter.simulations
    plain, _, _ = plain_draws(counter, generator(*seeds, stream("plain")), splitting.plain, dimension)
    failing = np.concatenate([repeat.points[repeat.failing] for repeat in repeats])
    return SplittingEstimate(
        simulations=simulations,
        points=failing,
        noise=np.concatenate([repeat.noise[repeat.failing] for repeat in repeats]),
        weights=np.ones(len(failing)),
        plain=plain,
        estimates=np.array([repeat.answer for repeat in repeats]),
        levels=np.array([repeat.levels for repeat in repeats]),
    )


def slacks_of(repeats: list[Repeat], counter: Counter) -> np.ndarray:
    """Compute the slacks of the particles of all repeats, in one batch."""
    points = np.concatenate([repeat.points for repeat in repeats])
    return counter(points, np.concatenate([repeat.noise for repeat in repeats]))


def started(rng: np.random.Generator, dimension: int, splitting: Splitting, counter: Counter) -> Repeat:
    """Create a repeat before its first level."""
    points = rng.standard_normal((splitting.particles, dimension))
    return Repeat(
        rng=rng,
        points=points,
        noise=counter.fresh(splitting.particles),
        slacks=np.full(splitting.particles, np.nan),  # computed before the first level
    )


def is_finished(repeat: Repeat, splitting: Splitting) -> bool:
    """Whether a repeat is dead, or its next level would be at failure or beyond."""
    return repeat.dead or bool(np.partition(repeat.slacks, -splitting.killed)[-splitting.killed] < 0.0)


def raised(repeat: Repeat, splitting: Splitting) -> Clones | None:
    """Raise a repeat to its next level, at which clones replace the particles that do not pass.

    Ties die together. Particles that already fail are never killed, so the level is at least 0: at the last level, the
    particles that do not fail die.

    Returns:
        The clones; None if no particle survives.
    """
    level = float(np.partition(repeat.slacks, -splitting.killed)[-splitting.killed])
    dies = repeat.slacks >= level
    survivors = np.flatnonzero(~dies)
    if not len(survivors):
        repeat.dead = True
        return None
    clones = np.flatnonzero(dies)
    parents = repeat.rng.choice(survivors, len(clones))
    repeat.estimate *= len(survivors) / len(repeat.slacks)
    repeat.levels += 1
    for values in (repeat.points, repeat.noise, repeat.slacks):
        values[clones] = values[parents]
    return Clones(repeat, level, clones)


def move(moving: list[Clones], counter: Counter) -> None:
    """Make one step of every clone's chain: z' = sqrt(1 - s^2) z + s xi, accepted below the level.

    The step s adapts to the acceptance rate, separately in each repeat. It adapts slowly if few particles move, since a
    step that depends on the last move of the same particle would change the limit distribution of the chain.
    """
    proposals = []
    indices = []
    for repeat, _, clones in moving:
        innovations = repeat.rng.standard_normal((len(clones), repeat.points.shape[1]))
        proposals.append(np.sqrt(1.0 - repeat.step**2) * repeat.points[clones] + repeat.step * innovations)
        has_new_noise = repeat.rng.random(len(clones)) < REFRESHED
        indices.append(np.where(has_new_noise, counter.fresh(len(clones)), repeat.noise[clones]))
    slacks = counter(np.concatenate(proposals), np.concatenate(indices))
    ends = np.cumsum([len(points) for points in proposals])[:-1]
    batches = zip(moving, proposals, indices, np.split(slacks, ends), strict=True)
    for (repeat, level, clones), points, noise, proposal_slacks in batches:
        is_accepted = proposal_slacks < level
        repeat.points[clones[is_accepted]] = points[is_accepted]
        repeat.noise[clones[is_accepted]] = noise[is_accepted]
        repeat.slacks[clones[is_accepted]] = proposal_slacks[is_accepted]
        weight = len(clones) / len(repeat.slacks)
        repeat.step = float(np.clip(repeat.step * np.exp(weight * (is_accepted.mean() - ACCEPTED)), SMALLEST_STEP, 1.0))
