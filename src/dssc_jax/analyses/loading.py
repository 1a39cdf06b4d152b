"""Whatever a command has left in a folder, as an object again."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

from dssc_jax.analyses.comparison import Comparison
from dssc_jax.analyses.margins import Margins
from dssc_jax.core.errors import ConfigError
from dssc_jax.results import result as results
from dssc_jax.results.manifest import MANIFEST
from dssc_jax.results.result import Result

Loaded: TypeAlias = Result | Margins | Comparison
READERS: dict[str, Callable[[Path, bool], Loaded]] = {
    MANIFEST: results.load,
    "margin.json": Margins.load,
    "compare.json": Comparison.load,
}
"""How a folder is read, by the file that tells what it holds."""


def load(folder: str | Path, trust_code: bool = False) -> Loaded:
    """Read a folder that ``run``, ``sweep``, ``margin`` or ``compare`` wrote, or a ``save`` of what these return.

    Args:
        folder: The folder. Nothing in it is run, see docs/trust.md.
        trust_code: Import the models that its study names as ``module:object``. Whatever simulates again needs them:
            :func:`dssc_jax.replay`, :func:`dssc_jax.verify`, any change of the study. Nothing else does.

    Returns:
        A :class:`Result`, :class:`Margins` or :class:`Comparison`, equal to the one that was saved.

    Raises:
        ConfigError: it holds none of these, it is damaged, or its run did not finish.
    """
    path = Path(folder)
    if not path.is_dir():
        raise ConfigError(str(path), "is no folder")
    found = [name for name in READERS if (path / name).exists()]
    if found:
        return READERS[found[0]](path, trust_code)
    answers = sorted(file.name for file in path.glob("*.json"))
    told = f"; what it has is plain JSON: {', '.join(answers)}" if answers else ""
    raise ConfigError(str(path), f"is not a results folder: it has no {' or '.join(READERS)}{told}")
