"""Actions of a study's page on request: a margin, a proof, and the file that reproduces what is shown."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias, TypeVar

import numpy as np

from dssc_jax.analyses.laws.law_ranges import law_ranges
from dssc_jax.analyses.margins import margin
from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError
from dssc_jax.design.certification import NotCovered
from dssc_jax.exploration.live import LiveRun
from dssc_jax.exploration.sliders import Slider
from dssc_jax.exploration.worker import Stale
from dssc_jax.runs.run import run
from dssc_jax.study import Study

PROOF_BOXES = 4
FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}\.toml")

Answer = TypeVar("Answer")
Question: TypeAlias = Callable[[LiveRun, Callable[..., None]], Answer]
"""Answers for a run; calls its second argument now and then."""


class Superseded(Exception):
    """The answer is no longer wanted."""


def ending_when(stale: Stale) -> Callable[..., None]:
    """A progress callback that ends a computation when it is stale."""

    def check(*_: object) -> None:
        if stale():
            raise Superseded

    return check


def margins_of(slider: Slider, position: float) -> Question[str]:
    """How far a number may go from a position in both directions before draws fail, within the ends of its slider."""

    def answer(run: LiveRun, check: Callable[..., None]) -> str:
        answers = []
        for direction, end in (("upwards", slider.high), ("downwards", slider.low)):
            if end != position:
                result = margin(run.study, over=slider.name, bounds=(position, end), log=slider.log, progress=check)
                answers.append(f"{direction} to {end:.4g}: {result.headline}")
        return f"margin of {slider.name}, {run.failed.size:,} draws; " + "; ".join(answers)

    return answer


def over_ranges(study: Study) -> Question[str]:
    """The failure probability over all laws of a study whose arguments are ranges."""

    def answer(_: LiveRun, check: Callable[..., None]) -> str:
        return law_ranges(study, progress=check).headline

    return answer


def proof(run: LiveRun, check: Callable[..., None]) -> str:
    """What can be proved of the sampled loop for every plant, or vehicle and wind, within the bounds."""
    try:
        from dssc_jax.proofs.prove import prove  # needs an optional extra

        proved = prove(run.study, boxes=PROOF_BOXES, progress=check)
    except ImportError as absent:
        return f"a proof needs {absent.name}: pip install 'dssc_jax[proofs]'"
    except NotCovered as outside:
        return f"not proved: {outside}"
    if proved.complete:
        return f"proved: {proved.statement()}"
    return f"not proved for {proved.claim.covered}: {proved.statement()}"


def save_study(live_run: LiveRun, folder: Path, name: str) -> Path:
    """Write the study of a run as a new file of a folder.

    Raises:
        ConfigError: The name is not one of a TOML file in this folder, it exists, or it cannot be written.
    """
    if not FILE_NAME.fullmatch(name):
        rule = "must be a name of letters, digits, '.', '_' and '-' that ends in .toml"
        raise ConfigError("save", f"{rule}, got '{name}'")
    path = folder / name
    try:
        files.create_text(path, live_run.toml())
    except FileExistsError:
        raise ConfigError("save", f"{path} exists; choose another name") from None
    except OSError as error:
        raise ConfigError("save", f"{path} cannot be written: {error.strerror or error}") from None
    return path


def differing_draws(live_run: LiveRun, path: Path) -> int:
    """Number of draws whose outcome differs between what is shown and a run of the saved study.

    The study's own program has its constants compiled in, and may round its last digits differently.
    """
    result = run(Study.load(path))
    return int(np.count_nonzero(result.dataset["outcome"].values != live_run.results["outcome"]))
