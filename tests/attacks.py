"""Attacks on the files of a results folder: links, pipes, moves and full disks; what a command may do about them."""

import contextlib
import hashlib
import io
import os
import resource
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.report.page import is_current
from tests.mutations import document

PLACES = (
    *("manifest.json", "summary.json", ".lock", ".writer.json", "proofs.json", "data.zarr", "data.zarr/zarr.json"),
    *("data.zarr/error_rms", "data.zarr/error_rms/zarr.json", "data.zarr/error_rms/c", "data.zarr/error_rms/c/0/0/0"),
    *("data.zarr/outcome/c/0/0/0", "data.zarr/draw", "digests", "digests/0.0.0.json", "figures", "figures/sweep.png"),
    *("figures/sweep.svg", "report.html", "interactive.html", "draws.csv", "draws.csv-metadata.json"),
    *("draws.parquet", "result.nc", "result.mat", "../index.html"),
)
"""What a folder of a sweep may hold."""

COMMANDS = {
    "report": ["report", "FOLDER", "--worst", "0"],
    "interactive": ["report", "FOLDER", "--interactive"],
    "index": ["report", "--index", "ROOT"],
    "csv": ["export", "FOLDER", "--to", "csv"],
    "parquet": ["export", "FOLDER", "--to", "parquet"],
    "netcdf": ["export", "FOLDER", "--to", "netcdf"],
    "mat": ["export", "FOLDER", "--to", "mat"],
    "again": ["sweep", "STUDY", "--out", "FOLDER", "--json"],
    "resume": ["sweep", "STUDY", "--out", "FOLDER", "--resume", "--fresh", "--json"],
    "fresh": ["sweep", "STUDY", "--out", "FOLDER", "--fresh", "--json"],
}
"""The commands that write into a folder."""

FILES = {
    "report": "report.html",
    "interactive": "interactive.html",
    "csv": "draws.csv",
    "parquet": "draws.parquet",
    "netcdf": "result.nc",
    "mat": "result.mat",
}
"""The file that a command writes, if it is one."""

PATIENCE = 60  # s, after which a command hangs
LIMITS = (0, 1, 100, 500, 1000, 3000, 10_000, 30_000)  # bytes of a file on a full disk


class Ending(NamedTuple):
    """How an attack ended: what is wrong, empty if nothing is; exit code; what was said."""

    wrong: str
    code: int | str
    said: str


class Ground:
    """A complete folder, outside of it what nobody may touch.

    Args:
        place: An empty folder.
        table: The study's table, with two swept parameters.
    """

    def __init__(self, place: Path, table: dict) -> None:
        self.place, self.study_file = place, place / "study.toml"
        self.study_file.write_bytes(document(table))
        self.whole = dj.run(dj.Study.load(self.study_file), place / "whole", block=24)
        with contextlib.redirect_stdout(io.StringIO()):
            for name in ("report", "csv"):
                assert guarded(self.arguments(name, place / "whole")) == 0

    def arguments(self, command: str, folder: Path) -> list[str]:
        """The arguments of a command."""
        names = {"FOLDER": str(folder), "ROOT": str(folder.parent), "STUDY": str(self.study_file)}
        return [names.get(word, word) for word in COMMANDS[command]]

    @contextlib.contextmanager
    def copied(self) -> Iterator[tuple[Path, Path]]:
        """A copy to harm, and a folder outside of it."""
        root, outside = self.place / "root", self.place / "outside"
        folder = Path(shutil.copytree(self.whole.path, root / "received"))
        outside.mkdir()
        try:
            yield folder, outside
        finally:
            shutil.rmtree(root)
            shutil.rmtree(outside)

    def complete(self, folder: Path) -> bool:
        """Whether a folder says that it is complete, and that is not true."""
        try:
            return not dj.load(folder).dataset.identical(self.whole.dataset)
        except dj.ConfigError:
            return False

    def link(self, place: str, command: str, kind: str) -> Ending:
        """A command on a folder in which a place is a link outwards (``full``, ``dangling``), or a ``pipe``."""
        with self.copied() as (folder, outside):
            target, path = outside / "victim", folder / place
            if kind == "pipe":
                remove(path)
                path.parent.mkdir(parents=True, exist_ok=True)
                os.mkfifo(path)
            else:
                moved = kind == "full" and path.exists()
                if moved:
                    shutil.move(path, target)
                elif kind == "full":
                    target.write_text("precious")
                remove(path)
                path.parent.mkdir(parents=True, exist_ok=True)
                path.symlink_to(target)
            before = state(outside)
            code, said = ended(self.arguments(command, folder))
            wrong = flaw(code, said)
            if state(outside) != before:
                wrong = "wrote outside of the folder"
            return Ending(wrong, code, said)

    def full_disk(self, command: str, limit: int, fresh: bool) -> Ending:
        """A command where no file may have more than some bytes, over an older output or where there is none."""
        with self.copied() as (folder, _):
            file = folder / FILES.get(command, "none")
            if fresh:
                remove(file)
            before = state(folder) if file.exists() else {}
            with largest_file(limit):
                code, said = ended(self.arguments(command, folder))
            wrong = flaw(code, said)
            if code != 0 and command in FILES:
                kept = state(folder).get(file.name)
                wrong = wrong or ("left a part" if kept != before.get(file.name) else "")
            if code == 0 and command in ("report", "interactive") and not is_current(file, dj.load(folder)):
                wrong = "took a part for whole"
            if list(folder.rglob("*.partial")):
                wrong = "left a partial file"
            return Ending(wrong or ("is falsely complete" if self.complete(folder) else ""), code, said)

    def lost(self, how: str, block: int) -> Ending:
        """A run whose folder is ``moved``, ``deleted``, ``emptied`` or ``replaced`` after a number of blocks."""
        folder, aside = self.place / "run", self.place / "aside"
        done: list[int] = []

        def progress(lanes: int, total: int) -> None:
            done.append(lanes)
            if len(done) != block + 1:
                return
            if how in ("moved", "replaced"):
                folder.rename(aside)
            else:
                shutil.rmtree(folder if how == "deleted" else folder / "data.zarr" / "error_rms")
            if how == "replaced":
                shutil.copytree(self.whole.path, folder)

        try:
            dj.run(self.whole.study, folder, block=24, progress=progress)
            wrong, said = f"said nothing of a folder that was {how}", ""
        except dj.ConfigError as error:
            said = str(error)
            wrong = "" if "\n" not in said and str(folder) in said else f"said {said}"
            wrong = wrong if how != "moved" or str(aside) in said else "did not say where the folder is"
        for place in (folder, aside):
            false = place.exists() and how != "replaced" and self.complete(place)
            wrong = "is falsely complete" if false else wrong
            shutil.rmtree(place, ignore_errors=True)
        return Ending(wrong, 2, said)


def remove(path: Path) -> None:
    """Delete whatever a path is."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def state(folder: Path) -> dict[str, str]:
    """Digest of every file, and the target of every link."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_symlink():
            found[str(path.relative_to(folder))] = os.readlink(path)
        elif path.is_file():
            found[str(path.relative_to(folder))] = hashlib.sha256(path.read_bytes()).hexdigest()
        else:
            found[str(path.relative_to(folder))] = "folder"
    return found


@contextlib.contextmanager
def largest_file(limit: int) -> Iterator[None]:
    """Let no file of this process grow beyond a number of bytes, as a full disk does; modules leave no cut bytecode."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    writes_bytecode = not sys.dont_write_bytecode
    sys.dont_write_bytecode = True
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        sys.dont_write_bytecode = not writes_bytecode


def ended(arguments: list[str]) -> tuple[int | str, str]:
    """Exit code of a command, or the exception that got through; what it said."""
    said = io.StringIO()
    handler: Callable = signal.signal(signal.SIGALRM, hung)
    signal.alarm(PATIENCE)
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
            code: int | str = guarded(arguments)
    except BaseException as error:
        code = f"{type(error).__name__}: {error}"[:200]
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, handler)
    return code, said.getvalue()


def hung(*_: object) -> None:
    """End a command that waits."""
    raise TimeoutError("hangs")


def flaw(code: int | str, said: str) -> str:
    """What is wrong with the end of a command, as far as code and words tell."""
    if code not in (0, 2):
        return f"ended with {code}"
    if "hangs" in said:
        return "hangs"
    errors = [line for line in said.splitlines() if line.startswith("error: ")]
    return f"said {len(errors)} lines" if len(errors) != (code == 2) else ""
