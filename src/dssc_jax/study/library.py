"""Lookup of study files by name: in the folder ``studies`` of the current folder, and in the package."""

import difflib
from pathlib import Path

from dssc_jax.core.errors import ConfigError, nearest

LONGEST_NAME = 255
"""Largest number of characters in a file's name that common file systems admit."""
PACKAGED = Path(__file__).parents[1] / "_studies"
"""Folder with the studies of an installed package."""
CHECKOUT = Path(__file__).parents[3] / "studies"
"""Folder with the studies in a checkout of the repository, for a package that is not installed."""


def study_folders() -> list[Path]:
    """Existing folders with studies, each once: the current folder's first, then those of the package."""
    existing: list[Path] = []
    for folder in (Path.cwd() / "studies", PACKAGED, CHECKOUT):
        known_folders = [path.resolve() for path in existing]
        if folder.is_dir() and folder.resolve() not in known_folders:
            existing.append(folder)
    return existing


def available_studies() -> dict[str, Path]:
    """File of each study by name; if several of :func:`study_folders` have a name, the first one counts."""
    files: dict[str, Path] = {}
    for folder in study_folders():
        for path in sorted(folder.glob("*.toml")):
            files.setdefault(path.stem, path)
    return files


def find_study(name: str) -> Path:
    """Find the file of a study, from its path or its name.

    A path is returned as it is, even if there is no such file; the function that reads the file reports that.

    Raises:
        ConfigError: The name belongs neither to a file nor to a study.
    """
    path = Path(name)
    if len(path.name) > LONGEST_NAME:
        raise ConfigError(f"{name[:40]}...", f"is longer than a file's name can be ({LONGEST_NAME} characters)")
    studies = available_studies()
    is_path = path.exists() or path.suffix == ".toml" or path.parent != Path()
    is_results_folder = path.is_dir() and name in studies  # a results folder may have its study's name
    if is_path and not is_results_folder:
        return path
    for spelling in (name, name.replace("-", "_")):
        if spelling in studies:
            return studies[spelling]
    local_files = {file.stem: file for file in Path.cwd().glob("*.toml")}
    similar_stems = difflib.get_close_matches(name, sorted(local_files), n=1, cutoff=0.6)
    if similar_stems:
        raise ConfigError(name, f"is no file; did you mean '{local_files[similar_stems[0]].name}'?")
    raise ConfigError(name, f"is neither a file nor the name of a study; {nearest(name, studies)}")
