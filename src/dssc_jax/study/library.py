"""Lookup of study files by name: in the folder ``studies`` of the current folder, and in the package."""

import difflib
from pathlib import Path

from dssc_jax.core.errors import ConfigError, nearest

LONGEST_NAME = 255
PACKAGED = Path(__file__).parents[1] / "_studies"
CHECKOUT = Path(__file__).parents[3] / "studies"


def study_folders() -> list[Path]:
    """Existing folders with studies, in the order of precedence."""
    existing: list[Path] = []
    for folder in (Path.cwd() / "studies", PACKAGED, CHECKOUT):
        if folder.is_dir() and folder.resolve() not in [path.resolve() for path in existing]:
            existing.append(folder)
    return existing


def available_studies() -> dict[str, Path]:
    """File of each study by name, from the first folder that has the name."""
    files: dict[str, Path] = {}
    for folder in study_folders():
        for path in sorted(folder.glob("*.toml")):
            files.setdefault(path.stem, path)
    return files


def find_study(name: str) -> Path:
    """The file of a study, from its path or its name.

    A path is returned as it is, even if there is no such file.

    Raises:
        ConfigError: A name is neither that of a file nor that of a study.
    """
    path = Path(name)
    if len(path.name) > LONGEST_NAME:
        raise ConfigError(f"{name[:40]}...", f"is longer than a file's name can be ({LONGEST_NAME} characters)")
    studies = available_studies()
    is_results_folder = path.is_dir() and name in studies  # a results folder may have its study's name
    if not is_results_folder and (path.exists() or path.suffix == ".toml" or path.parent != Path()):
        return path
    for spelling in (name, name.replace("-", "_")):
        if spelling in studies:
            return studies[spelling]
    local_stems = {str(file): file.stem for file in sorted(Path.cwd().glob("*.toml"))}
    similar = difflib.get_close_matches(name, local_stems.values(), n=1, cutoff=0.6)
    if similar:
        file = next(path for path, stem in local_stems.items() if stem == similar[0])
        raise ConfigError(name, f"is no file; did you mean '{Path(file).name}'?")
    raise ConfigError(name, f"is neither a file nor the name of a study; {nearest(name, studies)}")
