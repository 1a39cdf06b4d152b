"""Save what a page shows as a study file, and check that the file reproduces it."""

import re
from pathlib import Path

import numpy as np

from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError
from dssc_jax.exploration.live import LiveRun
from dssc_jax.runs.run import run
from dssc_jax.study import Study

FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}\.toml")


def save_study(shown: LiveRun, folder: Path, name: str) -> Path:
    """Write the study of a run.

    Args:
        shown: The run.
        folder: An existing folder.
        name: Name of a new file in it.

    Raises:
        ConfigError: The name is not one of a TOML file in this folder, it exists, or it cannot be written.
    """
    if not FILE_NAME.fullmatch(name):
        raise ConfigError(
            "save", f"must be a name of letters, digits, '.', '_' and '-' that ends in .toml, got '{name}'"
        )
    path = folder / name
    try:
        files.create_text(path, shown.toml())
    except FileExistsError:
        raise ConfigError("save", f"{path} exists; choose another name") from None
    except OSError as error:
        raise ConfigError("save", f"{path} cannot be written: {error.strerror or error}") from None
    return path


def differing_draws(shown: LiveRun, path: Path) -> int:
    """Number of draws whose outcome differs between what is shown and a run of the saved study.

    The study's own program has its constants compiled in, and may round its last digits differently.
    """
    result = run(Study.load(path))
    return int(np.count_nonzero(result.dataset["outcome"].values != shown.results["outcome"]))
