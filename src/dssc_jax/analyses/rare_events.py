"""A study's failure probability that is too small for plain draws: splitting on the worst requirement's slack."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special

from dssc_jax.analyses.splitting import USUAL, Estimate, Splitting, split
from dssc_jax.closed_loop.requirements import worst_slack
from dssc_jax.core.errors import ConfigError
from dssc_jax.engine.batching import Arrays, Engine, evaluate, is_noisy
from dssc_jax.engine.sampling import inside, values_at
from dssc_jax.statistics import CONFIDENCE
from dssc_jax.study import Study


@dataclass(frozen=True)
class RareEvent:
    """A study's rare failure.

    Args:
        study: The study.
        how: What was spent.
        estimate: The probability and how it was found.
        noisy: Whether the loop has in-loop noise.
        where: Values of each uncertain number among the failing particles, shape (n,); among the failed plain draws
            where theirs is the answer.
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
            "interval_method": found.method,
            "confidence": confidence,
            "splitting": {"probability": found.mean, "interval": list(found.mean_interval(confidence))},
            "plain": {
                "draws": found.plain.draws,
                "failures": found.plain.failures,
                "interval": list(found.plain.interval(confidence)),
                "contradicts": found.contradicted,
            },
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


def rare(study: Study, how: Splitting = USUAL, progress: Callable[[int], None] | None = None) -> RareEvent:
    """The failure probability of a study at its own values, by splitting on the worst requirement's scaled slack.

    Args:
        study: The study; a sweep is left aside, so is its number of draws.
        how: How much to spend.
        progress: Told of the simulations done.

    Raises:
        ConfigError: the study requires nothing, or nothing is uncertain.
    """
    study = study.without_sweep()
    if not study.requirements:
        raise ConfigError(study.source, "rare needs at least one [[requirement]]: its slack leads to the failures")
    if not study.laws:
        raise ConfigError(study.source, "nothing is uncertain; give at least one number a law")
    engine = Engine(study, how.repeats * how.killed)
    finished = 0

    def slack(points: np.ndarray, noise: np.ndarray) -> np.ndarray:
        nonlocal finished
        results = evaluate(engine, values_at(study, inside(special.ndtr(points))), noise)
        finished += len(points)
        if progress:
            progress(finished)
        return worst_slack(study.requirements, results)

    estimate = split(slack, len(study.laws), (study.config.seed,), how)
    failing = estimate.points if estimate.answered else estimate.plain.points
    where = values_at(study, inside(special.ndtr(failing)))
    return RareEvent(study, how, estimate, is_noisy(engine), where)
