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
from dssc_jax.analyses.rare_events.estimate import Estimate, make_plain_draws
from dssc_jax.analyses.slacks import SlackCounter, SlackFunction
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import stream
from dssc_jax.engine.sampling import generator
from dssc_jax.statistics import CONFIDENCE, lognormal_interval

FIRST_STEP = 0.7  # size of the first moves in standard normal space; it adapts to the share of accepted moves
SMALLEST_STEP = 0.02
ACCEPTED = 0.35  # share of accepted moves at which the size of a move stays
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
        ConfigError: A number is out of range.
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


DEFAULT_SPLITTING = Splitting()
"""The default settings."""


@dataclass
class Repeat:
    """One repeat of the splitting: a population of N particles on its way to failure.

    Args:
        rng: Random generator.
        points: Particles in standard normal space, shape (N, d).
        noise: Index of the in-loop noise of each particle, shape (N,).
        slacks: Slack of each particle, shape (N,).
        step: Size of a move.
        estimate: Product of the shares of particles that passed each level.
        levels: Number of levels passed.
        dead: Whether the repeat's answer is 0: no particle passed a level, or the estimate became too small.
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
        """Whether each particle fails, shape (N,)."""
        return self.slacks < 0.0

    @property
    def answer(self) -> float:
        """The failure probability by this repeat."""
        return 0.0 if self.dead else self.estimate * float(self.failing.mean())


class Clones(NamedTuple):
    """The particles of a repeat that were replaced by clones at a level.

    Args:
        repeat: The repeat.
        level: The slack below which the clones have to stay.
        places: Indices of the clones in the population, shape (clones,).
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
        """The failure probability: the mean over the repeats."""
        return float(self.estimates.mean())

    def mean_interval(self, confidence: float = CONFIDENCE) -> tuple[float, float]:
        """The interval of the mean over the repeats; [0, 1] if fewer than two of them reach a failure.

        An estimate is a product of shares, so its logarithm is nearly normal: :func:`lognormal_interval`.
        """
        low, high = lognormal_interval(self.estimates, confidence)
        return min(low, 1.0), min(high, 1.0)

    @property
    def reached(self) -> bool:
        """Whether repeats reached failures by levels; without a level the particles are plain draws, but fewer."""
        return self.mean > 0.0 and bool(self.levels.any())

    @property
    def interval_name(self) -> str:
        """Name of the interval: that of a lognormal mean over so many repeats."""
        return f"lognormal mean over {len(self.estimates)} independent repeats"

    @property
    def variation(self) -> float:
        """Coefficient of variation of the mean, from the scatter of the repeats; infinite without a failure."""
        if self.mean == 0.0:
            return np.inf
        return float(self.estimates.std(ddof=1) / np.sqrt(len(self.estimates)) / self.mean)


def split(
    slack: SlackFunction, dimension: int, seeds: Sequence[int], splitting: Splitting = DEFAULT_SPLITTING
) -> SplittingEstimate:
    """Estimate a failure probability by adaptive multilevel splitting, and make plain draws beside it.

    All repeats advance together, so that slacks are computed in large batches.

    Args:
        slack: Computes slacks in standard normal space; -inf if there is none.
        dimension: Number d of coordinates of that space.
        seeds: Seeds of the random numbers.
        splitting: The settings.

    Reference:
        A. Guyader, N. Hengartner, E. Matzner-Lober, Applied Mathematics and Optimization 64 (2011) 171-196;
        S.-K. Au, J. L. Beck, Probabilistic Engineering Mechanics 16 (2001) 263-277; moves after
        I. Papaioannou et al., Probabilistic Engineering Mechanics 41 (2015) 89-103.
    """
    counter = SlackCounter(slack)
    repeats = first_populations(dimension, seeds, splitting, counter)
    for _ in range(MOST_LEVELS):
        moving = []
        for repeat in repeats:
            repeat.dead = repeat.dead or repeat.estimate < splitting.smallest
            if not is_finished(repeat, splitting):
                clones = raise_level(repeat, splitting)
                if clones is not None:
                    moving.append(clones)
        if not moving:
            break
        for _ in range(splitting.moves):
            move_clones(moving, counter)
    simulations = counter.simulations
    plain, _, _ = make_plain_draws(counter, generator(*seeds, stream("plain")), splitting.plain, dimension)
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


def first_populations(
    dimension: int, seeds: Sequence[int], splitting: Splitting, counter: SlackCounter
) -> list[Repeat]:
    """The repeats before their first levels, each with plain draws as particles; arguments as of :func:`split`."""
    generators = [generator(*seeds, index) for index in range(splitting.repeats)]
    points = [rng.standard_normal((splitting.particles, dimension)) for rng in generators]
    noise = [counter.fresh(splitting.particles) for _ in generators]
    slacks = np.split(counter(np.concatenate(points), np.concatenate(noise)), splitting.repeats)
    return [Repeat(*parts) for parts in zip(generators, points, noise, slacks, strict=True)]


def is_finished(repeat: Repeat, splitting: Splitting) -> bool:
    """Whether a repeat is dead, or has so many failing particles that its next level would be a failure."""
    return repeat.dead or next_level(repeat, splitting) < 0.0


def next_level(repeat: Repeat, splitting: Splitting) -> float:
    """The next level of a repeat: the k-th largest slack of its particles."""
    return float(np.partition(repeat.slacks, -splitting.killed)[-splitting.killed])


def raise_level(repeat: Repeat, splitting: Splitting) -> Clones | None:
    """Replace the particles of a repeat at its next level or above by clones of the others.

    Particles with equal slacks die together. The level is not negative, so particles that fail survive.

    Returns:
        The clones; None if no particle survives, which makes the repeat dead.
    """
    level = next_level(repeat, splitting)
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


def move_clones(moving: list[Clones], counter: SlackCounter) -> None:
    """Make one step of every clone's Markov chain: z' = sqrt(1 - s^2) z + s xi, accepted if it lies below the level.

    The step s adapts to the acceptance rate, separately in each repeat. It adapts slowly if few particles move, since a
    step that depends on the last move of the same particle would change the limit distribution of the chain.

    Args:
        moving: The clones of all repeats; updated.
        counter: Computes slacks.
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
