"""Regenerate docs/hostile.md: study files and results folders as accident and malice make them.

Every bad study file must end in exit 2 with one line, in under 2 s of processor time, and nothing written. A file that
is still valid is not simulated. A damaged folder is replayed, verified, exported and resumed: exit 2 with one line and
nothing changed, or, where the harm does not matter or was mended, the very same result. Links, pipes, moves and full
disks: nothing outside of the folder is touched, nothing hangs, and no folder, page or file is falsely complete.
"""

import argparse
import contextlib
import io
import shutil
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from unittest import mock

import xarray as xr

import dssc_jax as dj
from dssc_jax.cli.commands import run, sweep
from dssc_jax.cli.main import guarded
from dssc_jax.console.environment import machine

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from tests.attacks import COMMANDS, LIMITS, PLACES, Ground  # noqa: E402
from tests.mutations import STUDY_KINDS, damage  # noqa: E402
from tests.results.test_durability import SMALL  # noqa: E402

SLOW = 2.0  # s of processor time, which other work on the machine does not stretch


@dataclass
class Tally:
    """What happened so far."""

    ends: Counter = field(default_factory=Counter)
    slowest: float = 0.0
    wrong: list[str] = field(default_factory=list)


def attempt(arguments: list[str]) -> tuple[int | str, str, float]:
    """Exit code, or the exception that got through; what was said; processor time [s]."""
    said, printed = io.StringIO(), io.StringIO()
    began = time.process_time()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(printed):
        try:
            code: int | str = guarded(arguments)
        except BaseException as error:  # a traceback is what this looks for
            code = f"{type(error).__name__}: {error}"[:200]
    return code, said.getvalue(), time.process_time() - began


def mistake(code: int | str, said: str, seconds: float) -> str | None:
    """What is wrong with an end by bad input, if anything."""
    if code != 2:
        return f"ended with {code}"
    if len(said.strip().splitlines()) != 1 or len(said) > 1200:
        return f"said {len(said.strip().splitlines())} lines, {len(said)} characters"
    return f"took {seconds:.1f} s" if seconds > SLOW else None


def study_files(count: int, seed: int) -> Tally:
    """Mutated study files, as ``run`` meets them; valid ones stop where the simulation would begin."""
    tally = Tally()
    random = Random(seed)
    unsimulated = contextlib.ExitStack()
    for command in (run, sweep):
        unsimulated.enter_context(mock.patch.multiple(command, computed_result=mock.DEFAULT, print_result=mock.DEFAULT))
    with unsimulated, tempfile.TemporaryDirectory() as place:
        path, out = Path(place) / "study.toml", Path(place) / "out"
        for number in range(count):
            kind = STUDY_KINDS[number % len(STUDY_KINDS)]
            content = kind(random)
            path.write_bytes(content)
            code, said, seconds = attempt(["sweep" if number % 2 else "run", str(path), "--out", str(out)])
            tally.slowest = max(tally.slowest, seconds)
            wrong = (f"took {seconds:.1f} s" if seconds > SLOW else None) if code == 0 else mistake(code, said, seconds)
            tally.ends[kind.__name__, "valid" if code == 0 else "refused"] += 1
            if wrong or out.exists() or path.read_bytes() != content:
                tally.wrong.append(f"{kind.__name__} {number}: {wrong or 'wrote'}; {content[:300]!r}; {said[:200]}")
    return tally


def state(folder: Path) -> dict[str, tuple[int, int]]:
    """Size and time of every file."""
    files = {file: file.stat() for file in folder.rglob("*") if not file.name.startswith(".")}
    return {str(file): (about.st_size, about.st_mtime_ns) for file, about in files.items() if not file.is_dir()}


def folders(count: int, seed: int) -> Tally:
    """Damaged results folders, as every command meets them."""
    tally = Tally()
    random = Random(seed)
    study = dj.Study.from_table(SMALL)
    with tempfile.TemporaryDirectory() as place:
        whole = dj.run(study, Path(place) / "whole", block=24)
        for number in range(count):
            folder = Path(place) / f"harmed{number}"
            shutil.copytree(whole.path, folder)
            what = damage(random, folder)
            before = state(folder)
            commands = {
                "replay": ["replay", str(folder), "--draw", "1", "--json"],
                "verify": ["verify", str(folder), "--json", "--draws", "144"],
                "export": ["export", str(folder), "--to", "csv", "--out", str(Path(place) / "a.csv")],
            }
            for name, arguments in commands.items():
                code, said, seconds = attempt(arguments)
                wrong = mistake(code, said, seconds) if code != 0 else None
                if code == 0 and not unharmed(folder, whole):
                    wrong = "gave another result"
                tally.ends[name, "wrong" if wrong else "refused" if code == 2 else "the same result"] += 1
                tally.slowest = max(tally.slowest, seconds if code == 2 else 0.0)
                if wrong or state(folder) != before:
                    tally.wrong.append(f"{name} {number}, {what}: {wrong or 'changed the folder'}; {said[:200]}")
            resume(study, whole, folder, what, before, tally)
            shutil.rmtree(folder)
    return tally


def unharmed(folder: Path, whole: dj.Result) -> bool:
    """Whether a folder that is read says what the whole one says: every value, name, unit and interval."""
    found = dj.load(folder)
    return found.dataset.identical(whole.dataset) and found.summary()["points"] == whole.summary()["points"]


def resume(study: dj.Study, whole: dj.Result, folder: Path, what: str, before: dict, tally: Tally) -> None:
    """Going on in a damaged folder mends it, or leaves it alone."""
    began = time.process_time()
    try:
        again = dj.run(study, folder, resume=True)
        xr.testing.assert_identical(again.dataset, whole.dataset)
        assert unharmed(folder, whole), "what was mended is not what was there"
        tally.ends["--resume", "the same result"] += 1
    except dj.ConfigError as error:
        tally.ends["--resume", "refused"] += 1
        tally.slowest = max(tally.slowest, time.process_time() - began)
        if "\n" in str(error) or state(folder) != before:
            tally.wrong.append(f"--resume, {what}: changed the folder; {error}")
    except Exception as error:
        tally.ends["--resume", "wrong"] += 1
        tally.wrong.append(f"--resume, {what}: {type(error).__name__}: {error}")


def attacks(every: int) -> Tally:
    """Links and pipes at places of a folder for commands that write, moves, and full disks.

    Args:
        every: Of all pairs of a place and a command, every so many-th is tried; 1: all, some 800 attacks.
    """
    tally = Tally()
    with tempfile.TemporaryDirectory() as place:
        ground = Ground(Path(place), SMALL)

        def count(kind: str, about: str, wrong: str, code: int | str) -> None:
            tally.ends[kind, "wrong" if wrong else "refused" if code == 2 else "done, and nothing else touched"] += 1
            if wrong:
                tally.wrong.append(f"{kind}, {about}: {wrong}")

        pairs = [(name, command) for name in PLACES for command in COMMANDS]
        for name, command in pairs[::every]:
            for kind in ("full", "dangling", "pipe"):
                ending = ground.link(name, command, kind)
                label = {"full": "a link", "dangling": "a link to nothing", "pipe": "a named pipe"}[kind]
                count(label, f"{name}, {command}", ending.wrong, ending.code)
        for how in ("moved", "deleted", "emptied", "replaced"):
            for block in (0, 3, 6):
                ending = ground.lost(how, block)
                count(f"a folder {how} during a run", f"block {block}", ending.wrong, ending.code)
        for command in COMMANDS:
            for limit in LIMITS:
                ending = ground.full_disk(command, limit, fresh=limit % 2 == 0)
                count("a full disk", f"{command}, {limit} bytes", ending.wrong, ending.code)
    return tally


def rows(tally: Tally) -> list[str]:
    """A Markdown table."""
    ends = sorted({end for _, end in tally.ends})
    lines = [f"| | {' | '.join(ends)} |", "|---|" + "---|" * len(ends)]
    for kind in dict.fromkeys(kind for kind, _ in tally.ends):
        lines.append(f"| {kind} | {' | '.join(str(tally.ends[kind, end]) for end in ends)} |")
    return [
        *lines,
        "",
        f"Wrong: {len(tally.wrong)}.",
    ]


def slowest(tally: Tally) -> str:
    """The longest time of a refusal or a validation."""
    return f"Slowest refusal or validation: {tally.slowest:.2f} s of processor time."


def section_of_attacks(attacked: Tally) -> list[str]:
    """The page's part on attacks."""
    return [
        f"## {attacked.ends.total()} attacks on the files of a folder",
        "",
        "A place of a folder is a symbolic link to a file or folder outside of it, or to nothing, or a "
        "named pipe, for a command that writes. A folder is moved, deleted, emptied or replaced while a run fills "
        "it. No file may grow beyond some bytes, as on a full disk. Nothing outside may change, nothing may hang, no "
        "part of a file may remain, and no folder may say that it is complete when it is not.",
        "",
        *rows(attacked),
    ]


def main() -> int:
    options = argparse.ArgumentParser()
    options.add_argument("--studies", type=int, default=500)
    options.add_argument("--folders", type=int, default=100)
    options.add_argument("--every", type=int, default=7)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--page", type=Path, default=ROOT / "docs" / "hostile.md")
    chosen = options.parse_args()
    harmed = folders(chosen.folders, chosen.seed)
    mutated = study_files(chosen.studies, chosen.seed)
    attacked = attacks(chosen.every)
    for wrong in (*mutated.wrong, *harmed.wrong, *attacked.wrong):
        print(wrong)
    lines = [
        "# Hostile input",
        "",
        f"Regenerated by `python benchmarks/hostile.py`. Machine: {machine()}.",
        "",
        f"## {chosen.studies} mutated study files",
        "",
        "A mutation that leaves the file valid is not simulated. Every other mutation must end with exit code 2 and "
        f"one line, in under {SLOW:g} s of processor time, and must write nothing.",
        "",
        *rows(mutated),
        slowest(mutated),
        "",
        f"## {chosen.folders} damaged results folders",
        "",
        "Files are cut, emptied, replaced, exchanged and copied over each other; values of the manifest, of digests "
        "and of Zarr's metadata are changed, removed and inserted. Each folder is replayed, verified, exported and "
        "resumed. It must either be refused with one line and remain unchanged, or give exactly the same result "
        "because the damage is harmless or `--resume` has repaired it.",
        "",
        *rows(harmed),
        slowest(harmed),
        "",
        *section_of_attacks(attacked),
    ]
    chosen.page.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return 1 if mutated.wrong or harmed.wrong or attacked.wrong else 0


if __name__ == "__main__":
    sys.exit(main())
