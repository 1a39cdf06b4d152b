"""Regenerate docs/durability.md: runs that are killed at random moments, and a disk that fills up.

Each run is a process of its own with the real command line, killed by SIGKILL at a moment drawn uniformly from the
time that a whole run takes, or, every other time, from the time in which it writes its blocks; then ``--resume`` must
give the bits of the uninterrupted run. The disk is a
small tmpfs (needs root): the message is one line, and ``--resume`` works once the disk has grown.
"""

import argparse
import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from random import Random

import xarray as xr

import dssc_jax as dj
from dssc_jax.console.environment import machine

ROOT = Path(__file__).parents[1]
STUDY = """
name = "crash"
seed = 5
draws = 17000
[loop]
duration = 2.0
sample_time = 0.01
[plant]
kind = "normal_form"
k_p = { uniform = [0.8, 1.2] }
a_p = { normal = [1.0, 0.1] }
initial = [1.0, 0.0]
[controller]
kind = "pi"
l0 = 1.0
k_p = 1.0
k_i = 0.5
[[requirement]]
metric = "error_max"
after = 1.0
max = 0.6
[sweep]
"controller.k_p" = { linspace = [0.5, 2.0, 6] }
"controller.k_i" = { linspace = [0.1, 1.0, 2] }
"""


def command(study: Path, out: Path, *options: str) -> list[str]:
    """The command line of a run."""
    return [sys.executable, "-m", "dssc_jax.cli", "sweep", str(study), "--out", str(out), "--json", *options]


def marks(folder: Path) -> list[Path]:
    """The files that say which blocks are done."""
    return [*(folder / "digests").glob("*.json")]


def stage(folder: Path) -> str:
    """How far a run had come."""
    if not (folder / "manifest.json").exists():
        return "before its folder was laid out"
    try:
        dj.load(folder)
    except dj.ConfigError:
        return "while blocks were written" if marks(folder) else "before the first block"
    return "after the last block"


def same(folder: Path, whole: xr.Dataset) -> bool:
    """Whether a folder holds the very bits of another."""
    return dj.load(folder).dataset.identical(whole)


def killed(rounds: int, seed: int, place: Path) -> tuple[int, Counter, int]:
    """Rounds that ended with the bits of the uninterrupted run, where the kills fell, and the blocks of a run."""
    study = place / "crash.toml"
    study.write_text(STUDY)
    began = time.perf_counter()
    subprocess.run(command(study, place / "whole"), check=True, capture_output=True)
    seconds = time.perf_counter() - began
    whole = dj.load(place / "whole")
    written = [file.stat().st_mtime for file in marks(place / "whole")]
    random, good, stages = Random(seed), 0, Counter()
    for number in range(rounds):
        folder = place / f"killed{number}"
        process = subprocess.Popen(command(study, folder), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while number % 2 and not marks(folder) and process.poll() is None:
            time.sleep(0.001)
        time.sleep(random.uniform(0.0, max(written) - min(written) if number % 2 else seconds))
        process.send_signal(signal.SIGKILL)
        process.wait()
        stages[stage(folder)] += 1
        done = subprocess.run(command(study, folder, "--resume"), capture_output=True, text=True)
        good += done.returncode == 0 and same(folder, whole.dataset)
        if done.returncode != 0:
            print(number, done.stderr)
        subprocess.run(["rm", "-r", str(folder)], check=True)
    return good, stages, len(written)


@contextlib.contextmanager
def small_disk(place: Path, kilobytes: int) -> Iterator[Path]:
    """A tmpfs of so many kilobytes."""
    folder = place / "disk"
    folder.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "tmpfs", str(folder)], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def full(place: Path) -> list[tuple[int, int, str, bool]]:
    """For disks of several sizes: exit code, message, and whether going on after making room gives the same bits."""
    study, whole = place / "crash.toml", dj.load(place / "whole").dataset
    needed = int(subprocess.run(["du", "-sk", str(place / "whole")], capture_output=True, check=True).stdout.split()[0])
    found = []
    for share in (0.002, 0.2, 0.5, 0.8):
        kilobytes = max(int(share * needed), 4)
        with small_disk(place, kilobytes) as disk:
            first = subprocess.run(command(study, disk / "r"), capture_output=True, text=True)
            subprocess.run(["mount", "-o", "remount,size=1g", str(disk)], check=True)
            again = subprocess.run(command(study, disk / "r", "--resume"), capture_output=True, text=True)
            good = again.returncode == 0 and same(disk / "r", whole)
            found.append((kilobytes, first.returncode, first.stderr.strip().replace(str(disk), "DISK"), good))
        (place / "disk").rmdir()
    return found


def main() -> int:
    options = argparse.ArgumentParser()
    options.add_argument("--rounds", type=int, default=50)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--page", type=Path, default=ROOT / "docs" / "durability.md")
    chosen = options.parse_args()
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        good, stages, blocks = killed(chosen.rounds, chosen.seed, place)
        disks = full(place) if hasattr(os, "geteuid") and os.geteuid() == 0 else []
    lines = [
        "# Durability",
        "",
        f"Regenerated by `python benchmarks/crash.py`. Machine: {machine()}.",
        "",
        "## kill -9",
        "",
        f"A sweep of {blocks} blocks is killed at a random moment (in every other round: while it writes blocks) and "
        f"resumed with `--resume`: **{good} of {chosen.rounds}** are bit-identical to the uninterrupted run.",
        "",
        "| killed | rounds |",
        "|---|---|",
        *(f"| {name} | {count} |" for name, count in stages.most_common()),
        "",
        "## A full disk",
        "",
        "| size of the disk | exit code | message | `--resume` after freeing space is bit-identical |",
        "|---|---|---|---|",
        *(f"| {size} kB | {code} | {said} | {'yes' if same else 'no'} |" for size, code, said, same in disks),
    ]
    chosen.page.write_text("\n".join(lines) + "\n", encoding="utf-8")
    right = all(code == 2 and same and len(said.splitlines()) == 1 for _, code, said, same in disks)
    print(f"{good} of {chosen.rounds}; disks {'right' if right else 'wrong'}")
    return 0 if good == chosen.rounds and right else 1


if __name__ == "__main__":
    sys.exit(main())
