"""Lookup of study files by name: in the current folder's ``studies``, and among those in the package."""

import difflib
from pathlib import Path

from dssc_jax.core.errors import ConfigError, nearest

LONGEST_NAME = 255
PACKAGED = Path(__file__).parents[1] / "_studies"
CHECKOUT = Path(__file__).parents[3] / "studies"


def study_folders() -> list[Path]:
    """Folders with studies, nearest first."""
    existing: list[Path] = []
    for folder in (Path.cwd() / "studies", PACKAGED, CHECKOUT):
        if folder.is_dir() and folder.resolve() not in [path.resolve() for path in existing]:
            existing.append(folder)
    return existing


def available_studies() -> dict[str, Path]:
    """Every study by name; the nearest folder takes precedence."""
    files: dict[str, Path] = {}
    for folder in study_folders():
        for path in sorted(folder.glob("*.toml")):
            files.setdefault(path.stem, path)
    return files


def find_study(name: str) -> Path:
    """The file of a study given by path or by name.

    Raises:
        ConfigError: There is none.
    """
    path = Path(name)
    if len(path.name) > LONGEST_NAME:
        raise ConfigError(f"{name[:40]}...", f"is longer than a file's name can be ({LONGEST_NAME} characters)")
    studies = available_studies()
    is_results_folder = path.is_dir() and name in studies  # a results folder may have its study's name
    if not is_results_folder and (path.exists() or path.suffix == ".toml" or path.parent != Path()):
        return path
    if name in studies:
        return studies[name]
    if name.replace("-", "_") in studies:
        return studies[name.replace("-", "_")]
    local_stems = {str(file): file.stem for file in sorted(Path.cwd().glob("*.toml"))}
    similar = difflib.get_close_matches(name, local_stems.values(), n=1, cutoff=0.6)
    if similar:
        file = next(path for path, stem in local_stems.items() if stem == similar[0])
        raise ConfigError(name, f"is no file; did you mean '{Path(file).name}'?")
    raise ConfigError(name, f"is neither a file nor the name of a study; {nearest(name, studies)}")
