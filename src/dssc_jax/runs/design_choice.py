"""The choice of the design of a run's draws for a study with ``sampling = "auto"``.

A pilot estimates the failure probability. Sobol points give a narrower interval unless failures, or draws without a
failure, are few. The points of the run are randomised independently of the pilot. So the interval holds for either
choice.
"""

import math
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dssc_jax.core.json_types import JsonObject
from dssc_jax.core.numerics import stream
from dssc_jax.core.signals import Outcome
from dssc_jax.engine.batching import PROBES, Engine, evaluate, is_noisy
from dssc_jax.engine.sampling import inside_cube, sobol_points, values_at
from dssc_jax.results.manifest import MANIFEST, Manifest, read_manifest
from dssc_jax.study import Study

PILOT = 256  # draws of the pilot
PILOT_NETS = 16  # independently scrambled nets of the pilot
PILOT_INDEX = 2**30  # draw index of the pilot's first in-loop noise, beyond those of all runs
NETS = 16  # least number of nets of a run, which has up to twice as many
LEAST_NET = 8  # least number of points of a net
LEAST_CASES = 50  # failures, and draws without failure, that a run must expect for Sobol points


class DesignWarning(UserWarning):
    """Warning that a draw may differ from that of the study's run, because the run chooses the design of its draws."""


@dataclass(frozen=True)
class DesignChoice:
    """The chosen design of a study's draws.

    Args:
        study: The study with ``random`` or ``sobol`` as its sampling.
        reason: Reason for the choice, in words.
        pilot: Number of simulations that the choice took.
        request: Hash of the study with ``sampling = "auto"``, and number of draws of this study.
    """

    study: Study
    reason: str
    pilot: int
    request: tuple[str, int]

    @property
    def entry(self) -> Manifest:
        """The manifest's entry on the choice."""
        hash_of_study, draws = self.request
        content: JsonObject = {"reason": self.reason, "pilot": self.pilot, "asked": hash_of_study, "asked_draws": draws}
        return {"design": content}


def choose_design(study: Study, folder: Path | None, resume: bool) -> DesignChoice:
    """Choose the design of a study's draws.

    Args:
        study: The study, with ``sampling = "auto"``.
        folder: The results folder; if it records a choice for the same study, this choice is taken again. None: there
            is no folder.
        resume: Whether the study may have more draws than the study in the folder.

    Raises:
        ConfigError: The folder is damaged.
    """
    request = study.hash, study.config.draws
    nets, size = nets_of(study.config.draws)
    if size < LEAST_NET:
        return DesignChoice(
            with_plain_draws(study), f"plain draws: too few for {NETS} Sobol nets", pilot=0, request=request
        )
    if not study.laws:
        return DesignChoice(with_plain_draws(study), "plain draws: no number is uncertain", pilot=0, request=request)
    earlier_choice = recorded_choice(study, folder, resume) if folder else None
    if earlier_choice:
        return earlier_choice
    middle = {name: axis[len(axis) // 2] for name, axis in study.axes.items()}
    engine = Engine(with_plain_draws(study).without_sweep().override(middle), PILOT)
    place = " in the middle of the sweep" if middle else ""
    if is_noisy(engine):
        reason = f"plain draws: the loop has in-loop noise{place}, which Sobol points leave as random as it is"
        return DesignChoice(with_plain_draws(study), reason, pilot=2 * PROBES, request=request)
    simulations = PILOT + 2 * PROBES
    failures = count_pilot_failures(engine)
    expected_failures = (failures + 0.5) / (PILOT + 1) * study.config.draws  # never 0 nor all of them
    share = f"{failures} of {PILOT} pilot draws fail{place}"
    if min(expected_failures, study.config.draws - expected_failures) < LEAST_CASES:
        rule = f"Sobol points save nothing with fewer than {LEAST_CASES} failures, or draws without"
        reason = f"plain draws: {share}; {rule}"
        return DesignChoice(with_plain_draws(study), reason, simulations, request)
    reason = f"{nets} Sobol nets of {size} points: {share}, and the loop has no in-loop noise"
    return DesignChoice(with_sobol_draws(study, nets, size), reason, simulations, request)


def warn_of_open_choice(study: Study) -> None:
    """Warn if a run of the study may have other draws than plain ones, because it may choose Sobol points.

    Warns:
        DesignWarning: The run makes the choice after a pilot.
    """
    _, size = nets_of(study.config.draws)
    if study.config.sampling == "auto" and study.laws and size >= LEAST_NET:
        warnings.warn(
            "sampling = 'auto' counts as 'random' here, and a run may choose Sobol points, whose draws are others; "
            "`dssc-jax replay FOLDER --draw I` (dj.replay) has the draws of a run, as has the study of its result",
            DesignWarning,
            stacklevel=3,
        )


def with_plain_draws(study: Study) -> Study:
    """Copy a study, with plain draws: independent random points."""
    return study.override({"sampling": "random"})


def with_sobol_draws(study: Study, nets: int, size: int) -> Study:
    """Copy a study, with Sobol points as draws: ``nets`` independently scrambled nets of ``size`` points each."""
    return study.override({"sampling": "sobol", "replicates": nets, "draws": nets * size})


def nets_of(draws: int) -> tuple[int, int]:
    """The number of Sobol nets of a run, and the number of points of each net, a power of two.

    For at least :data:`NETS` draws, there are from :data:`NETS` to twice as many nets. All nets together have at least
    ``draws`` points.
    """
    size = 1 << max(0, (draws // NETS).bit_length() - 1)  # draws / NETS rounded down to a power of two, or 1
    return math.ceil(draws / size), size


def count_pilot_failures(engine: Engine) -> int:
    """Simulate the draws of the pilot, and count the failures.

    The draws are Sobol points. No run has their scramblings and their in-loop noise, so they are independent of runs.
    """
    study = engine.study
    size = PILOT // PILOT_NETS
    nets = []
    for net in range(PILOT_NETS):
        words = (study.config.seed, stream("pilot"), net)
        nets.append(sobol_points(len(study.laws), start=0, end=size, words=words))
    values = values_at(study, inside_cube(np.concatenate(nets)))
    results = evaluate(engine, values, PILOT_INDEX + np.arange(PILOT))
    return int(np.count_nonzero(results["outcome"] != Outcome.OK))


def recorded_choice(study: Study, folder: Path, resume: bool) -> DesignChoice | None:
    """The choice that a results folder records for the study; None if it records no such choice.

    Args:
        study: The study, with ``sampling = "auto"``.
        folder: The folder.
        resume: Whether a choice for fewer draws of the same study counts, too.
    """
    if not (folder / MANIFEST).exists():
        return None
    manifest = read_manifest(folder)
    entry = manifest.get("design")
    if not entry:
        return None
    # the present study with the recorded number of draws: an equal hash means that nothing else differs
    earlier = study.override({"draws": entry["asked_draws"]})
    is_same_number = earlier.hash == study.hash
    is_extended = resume and study.config.draws > entry["asked_draws"]
    if earlier.hash != entry["asked"] or not (is_same_number or is_extended):
        return None
    request = study.hash, study.config.draws
    recorded_study = manifest["study"]
    if recorded_study["sampling"] == "random":
        return DesignChoice(with_plain_draws(study), entry["reason"], entry["pilot"], request)
    nets = recorded_study["replicates"]
    points = math.ceil(study.config.draws / nets)  # of each net
    size = 1 << (points - 1).bit_length()  # rounded up to a power of two, as a Sobol net needs
    return DesignChoice(with_sobol_draws(study, nets, size), entry["reason"], entry["pilot"], request)
