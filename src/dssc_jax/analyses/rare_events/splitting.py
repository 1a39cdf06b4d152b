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
from dssc_jax.analyses.rare_events.estimate import Estimate, simulate_plain_draws
from dssc_jax.analyses.slacks import SlackCounter, SlackFunction
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import stream
from dssc_jax.engine.sampling import generator
from dssc_jax.statistics import CONFIDENCE, lognormal_interval

FIRST_MOVE_SIZE = 0.7  # size of the first moves in standard normal space; it adapts to the share of accepted moves
SMALLEST_MOVE_SIZE = 0.02
TARGET_ACCEPTANCE = 0.35  # share of accepted moves at which the size of a move stays
NOISE_REDRAW_SHARE = 0.5  # share of moves that redraw the in-loop noise
MOST_LEVELS = 100_000


@dataclass(frozen=True)
class Splitting:
    """The settings of a splitting, in which particles with large slacks die and clones of the others replace them.

    Args:
        particles: Number N of particles in each repeat.
        killed: Number k of particles that die at each level. For k = 1 the number of levels before a failure of
            probability p has a known law: Poisson with the mean -N ln p.
        moves: Number of moves of a clone's Markov chain at each level.
        repeats: Number of independent repeats, whose scatter gives the interval; at least 10.
        smallest: A repeat stops with the answer 0 when its estimate falls below this probability.
        plain: Number of plain draws that check the answer.

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
        """Refuse settings that are out of range."""
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
        noise_index: Index of the in-loop noise of each particle, shape (N,).
        slacks: Slack of each particle, shape (N,).
        move_size: Size s of a move, in (0, 1]; see :func:`move_clones`.
        estimate: Product of the shares of particles that passed each level.
        levels: Number of levels passed.
        dead: Whether the repeat's answer is 0: no particle passed a level, or the estimate became too small.
    """

    rng: np.random.Generator
    points: np.ndarray
    noise_index: np.ndarray
    slacks: np.ndarray
    move_size: float = FIRST_MOVE_SIZE
    estimate: float = 1.0
    levels: int = 0
    dead: bool = False

    @property
    def failing(self) -> np.ndarray:
        """Whether each particle fails, shape (N,)."""
        return self.slacks < 0.0

    @property
    def answer(self) -> float:
        """Estimate of the failure probability by this repeat."""
        return 0.0 if self.dead else self.estimate * float(self.failing.mean())


class Clones(NamedTuple):
    """The clones that replaced particles of a repeat at a level; moves make them differ from their parents.

    Args:
        repeat: The repeat, whose population contains the clones.
        level: The slack below which the clones have to stay.
        indices: Indices of the clones in the population, shape (clones,).
    """

    repeat: Repeat
    level: float
    indices: np.ndarray


@dataclass(frozen=True)
class SplittingEstimate(Estimate):
    """The estimate of a splitting: the mean over independent repeats. All failing particles have equal weights.

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
        """Confidence interval of the mean estimate over the repeats; [0, 1] if fewer than two reach a failure.

        The estimates are products of shares, hence nearly lognormal; see :func:`lognormal_interval`.
        """
        low, high = lognormal_interval(self.estimates, confidence)
        return min(low, 1.0), min(high, 1.0)

    @property
    def reached(self) -> bool:
        """Whether the repeats reached failures, and at least one of them by passing a level.

        Without any level the particles are just plain draws, fewer than those of :attr:`plain`.
        """
        return self.mean > 0.0 and bool(self.levels.any())

    @property
    def interval_name(self) -> str:
        """How the interval is computed, with the number of repeats."""
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
    """Estimate a failure probability by adaptive multilevel splitting, and make plain draws that check it.

    All repeats advance together, so that slacks are computed in large batches.

    Args:
        slack: Computes slacks in standard normal space; -inf or NaN: the point fails without a slack.
        dimension: Number d of coordinates of standard normal space.
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
        clones_of_repeats = []
        for repeat in repeats:
            repeat.dead = repeat.dead or repeat.estimate < splitting.smallest
            if not is_finished(repeat, splitting):
                clones = raise_level(repeat, splitting)
                if clones is not None:
                    clones_of_repeats.append(clones)
        if not clones_of_repeats:
            break
        for _ in range(splitting.moves):
            move_clones(clones_of_repeats, counter)
    simulations = counter.simulations
    plain = simulate_plain_draws(counter, generator(*seeds, stream("plain")), splitting.plain, dimension)
    failing = np.concatenate([repeat.points[repeat.failing] for repeat in repeats])
    return SplittingEstimate(
        simulations=simulations,
        points=failing,
        noise_index=np.concatenate([repeat.noise_index[repeat.failing] for repeat in repeats]),
        weights=np.ones(len(failing)),
        plain=plain.draws,
        estimates=np.array([repeat.answer for repeat in repeats]),
        levels=np.array([repeat.levels for repeat in repeats]),
    )


def first_populations(
    dimension: int, seeds: Sequence[int], splitting: Splitting, counter: SlackCounter
) -> list[Repeat]:
    """Create the repeats, each with a population of plain draws as its particles.

    Args:
        dimension: Number d of coordinates of standard normal space.
        seeds: Seeds of the random numbers; the index of the repeat is appended as a further seed.
        splitting: The settings.
        counter: Computes the slacks of points and their noise indices, and counts the simulations.
    """
    generators = [generator(*seeds, index) for index in range(splitting.repeats)]
    points = [rng.standard_normal((splitting.particles, dimension)) for rng in generators]
    noise_index = [counter.unused_noise(splitting.particles) for _ in generators]
    slacks = np.split(counter(np.concatenate(points), np.concatenate(noise_index)), splitting.repeats)
    return [Repeat(*parts) for parts in zip(generators, points, noise_index, slacks, strict=True)]


def is_finished(repeat: Repeat, splitting: Splitting) -> bool:
    """Whether a repeat is dead, or has so many failing particles that its next level would be negative."""
    return repeat.dead or next_level(repeat, splitting) < 0.0


def next_level(repeat: Repeat, splitting: Splitting) -> float:
    """Return the slack below which particles have to fall next: the k-th largest slack, where k particles die."""
    return float(np.partition(repeat.slacks, -splitting.killed)[-splitting.killed])


def raise_level(repeat: Repeat, splitting: Splitting) -> Clones | None:
    """Replace the particles of a repeat at its next level or above by clones of the others.

    Particles with equal slacks die together. The level is not negative, so particles that fail survive.

    Args:
        repeat: The repeat; updated.
        splitting: The settings.

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
    for values in (repeat.points, repeat.noise_index, repeat.slacks):
        values[clones] = values[parents]
    return Clones(repeat, level, clones)


def move_clones(clones_of_repeats: list[Clones], counter: SlackCounter) -> None:
    """Propose one step of every clone's Markov chain, and accept those proposals whose slacks are below the level.

    The proposal from the point z is sqrt(1 - s^2) z + s xi, with the size s of the move and a standard normal xi. Such
    a proposal leaves the standard normal law unchanged.

    Args:
        clones_of_repeats: The clones of each repeat; updated.
        counter: Computes slacks.
    """
    proposals = [propose_moves(clones, counter) for clones in clones_of_repeats]
    all_points = np.concatenate([points for points, _ in proposals])
    all_noise = np.concatenate([noise for _, noise in proposals])
    ends = np.cumsum([len(points) for points, _ in proposals])[:-1]
    slacks = np.split(counter(all_points, all_noise), ends)
    for clones, (points, noise), proposal_slacks in zip(clones_of_repeats, proposals, slacks, strict=True):
        repeat = clones.repeat
        is_accepted = proposal_slacks < clones.level
        moved = clones.indices[is_accepted]
        repeat.points[moved] = points[is_accepted]
        repeat.noise_index[moved] = noise[is_accepted]
        repeat.slacks[moved] = proposal_slacks[is_accepted]
        repeat.move_size = adapted_move_size(clones, float(is_accepted.mean()))


def propose_moves(clones: Clones, counter: SlackCounter) -> tuple[np.ndarray, np.ndarray]:
    """Propose a point for each clone, shape (clones, d), and an index of in-loop noise, shape (clones,).

    A share :data:`NOISE_REDRAW_SHARE` of the proposals gets an index of noise that no point has used; the others keep
    the noise of the clone.
    """
    repeat = clones.repeat
    indices = clones.indices
    innovations = repeat.rng.standard_normal((len(indices), repeat.points.shape[1]))
    points = np.sqrt(1.0 - repeat.move_size**2) * repeat.points[indices] + repeat.move_size * innovations
    has_new_noise = repeat.rng.random(len(indices)) < NOISE_REDRAW_SHARE
    noise = np.where(has_new_noise, counter.unused_noise(len(indices)), repeat.noise_index[indices])
    return points, noise


def adapted_move_size(clones: Clones, acceptance: float) -> float:
    """Adapt the size of a repeat's moves: larger if more than :data:`TARGET_ACCEPTANCE` of the moves were accepted.

    The size changes little if few particles move. Otherwise it would depend on the last move of the same particle,
    which would change the stationary law of the Markov chain.

    Args:
        clones: The clones that moved, with their repeat.
        acceptance: Share of the last moves that were accepted.
    """
    share = len(clones.indices) / len(clones.repeat.slacks)
    move_size = clones.repeat.move_size * np.exp(share * (acceptance - TARGET_ACCEPTANCE))
    return float(np.clip(move_size, SMALLEST_MOVE_SIZE, 1.0))
