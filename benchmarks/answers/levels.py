"""``python -m benchmarks.answers.levels``: what two levels of accuracy, and refilled lanes, would save at most."""

import numpy as np

import dssc_jax as dj
from benchmarks.answers.studies import COMMON, STUDIES, study_of
from dssc_jax.core.signals import Outcome

DRAWS = 4096
COARSE_COST = 0.5  # of a draw with twice the sampling time, or in float32
STUDIES_OF_LANES = (
    "rotor_loss",
    "uav_robustness",
    "hover_wind",
    "buck",
    "mu_robustness",
    "compare_mu",
    "noise_robustness",
)
DRAWS_OF_LANES = 512
WIDTHS = (8, 16, 32)


def failures(study: dj.Study) -> np.ndarray:
    """1 for each draw that fails, else 0."""
    return (dj.run(study, check=False).dataset["outcome"].values.ravel() != Outcome.OK).astype(float)


def cost_of_levels(fine: np.ndarray, coarse: np.ndarray) -> float:
    """Cost of a probability by two levels, with the best numbers of draws on each, over that by plain draws."""
    spread = np.sqrt(coarse.var() * COARSE_COST) + np.sqrt((fine - coarse).var() * (1.0 + COARSE_COST))
    return float(spread**2 / fine.var())


def cost_of_waiting(ends: np.ndarray, width: int) -> float:
    """Time of vectors that wait for their slowest draw, over that of draws which do not; ``ends`` (points, draws)."""
    vectors = ends[:, : ends.shape[1] // width * width].reshape(-1, width)
    return float(width * vectors.max(axis=1).sum() / vectors.sum())


def end_times(study: dj.Study) -> np.ndarray:
    """When each draw ends, shape (points, draws) [s]."""
    data = dj.run(study, check=False).dataset
    ends = data["failed_at"].values
    if "settled_at" in data:
        ends = np.fmin(ends, data["settled_at"].values)
    duration = study.loop.steps * study.loop.sample_time
    return np.where(np.isnan(ends), duration, ends).reshape(-1, ends.shape[-1])


def main() -> None:
    """Print both answers for some studies."""
    for model in ("axis", "gust"):
        study = study_of(model, COMMON).override({"draws": DRAWS})
        fine = failures(study)
        for label, change in (
            ("twice the sampling time", {"loop.sample_time": 2.0 * study.loop.sample_time}),
            ("float32", {"loop.precision": 32}),
        ):
            coarse = failures(study.override(change))
            differing = int((fine != coarse).sum())
            print(f"{model}, {label}: {differing} of {DRAWS} verdicts differ, cost {cost_of_levels(fine, coarse):.2f}")
    for name in STUDIES_OF_LANES:
        study = dj.Study.load(STUDIES / f"{name}.toml")
        ends = end_times(study.override({"draws": min(study.config.draws, DRAWS_OF_LANES)}))
        print(name, *(f"{width} lanes: {cost_of_waiting(ends, width):.3f}" for width in WIDTHS))


if __name__ == "__main__":
    main()
