"""Actions on request of a study's page: find a margin, prove, answer over ranges of laws, save the present study."""

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
"""Largest number of boxes of uncertain numbers in a proof."""
FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}\.toml")
"""Admissible names of a saved study: none leads to another folder."""

Answer = TypeVar("Answer")
Question: TypeAlias = Callable[[LiveRun, Callable[..., None]], Answer]
"""Computes an answer about a run. The second argument is a progress callback, which ends the computation by raising."""


class Superseded(Exception):
    """Raised to end a computation whose answer a newer request has superseded."""


def stop_when_stale(stale: Stale) -> Callable[..., None]:
    """Return a progress callback that raises :class:`Superseded` once a newer request has come."""

    def check(*_: object) -> None:
        """Raise if the computation is stale; counts of progress are ignored."""
        if stale():
            raise Superseded

    return check


def margin_question(slider: Slider, position: float) -> Question[str]:
    """Return the question how far a number may go up and down before draws fail.

    Args:
        slider: Slider of the number; its ends are the ends of the walks.
        position: Value at which both walks start.
    """

    def answer(run: LiveRun, check: Callable[..., None]) -> str:
        """Find the margins in both directions; a number that is already at an end has none in this direction."""
        answers = []
        for direction, end in (("upwards", slider.high), ("downwards", slider.low)):
            if end != position:
                result = margin(run.study, over=slider.name, bounds=(position, end), log=slider.log, progress=check)
                answers.append(f"{direction} to {end:.4g}: {result.headline}")
        return f"margin of {slider.name}, {run.failed.size:,} draws; " + "; ".join(answers)

    return answer


def law_range_question(study: Study) -> Question[str]:
    """Return the question for the failure probability over all laws within the ranges of a study."""

    def answer(_: LiveRun, check: Callable[..., None]) -> str:
        """Find the probability over the laws' ranges.

        The run has single laws in place of the ranges, so it is not used; the question starts from the study.
        """
        return law_ranges(study, progress=check).headline

    return answer


def proof(run: LiveRun, check: Callable[..., None]) -> str:
    """Answer whether the sampled loop is proved.

    A proof covers all plants, or all vehicles and winds, within their bounds.

    Args:
        run: The run, whose study is proved.
        check: Progress callback, which may raise to end the search for a proof.
    """
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
    """Write the study of a run to a new file, and return the file's path.

    Args:
        live_run: The run.
        folder: Folder of the file.
        name: Name of the file.

    Raises:
        ConfigError: The name is not that of a TOML file in the folder, the file exists, or it cannot be written.
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


def count_differing_draws(live_run: LiveRun, path: Path) -> int:
    """Count the draws whose outcome differs between the page's run and a run of the saved study.

    The saved study's program has all constants compiled in. Therefore it may round the last digits differently.

    Args:
        live_run: The page's run.
        path: File of the saved study.
    """
    result = run(Study.load(path))
    return int(np.count_nonzero(result.dataset["outcome"].values != live_run.results["outcome"]))
