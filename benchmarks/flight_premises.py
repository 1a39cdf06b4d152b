"""Regenerate a part of docs/flight.md: which flags flights raise that leave one premise of a certificate.

    python -m benchmarks.flight_premises [--flights 32]

Studies are proved, and their monitors watch flights of the same study with one number changed, in strict arithmetic.
"""

import argparse
import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

import dssc_jax as dj
from benchmarks.page import put
from dssc_jax.flight_code.certified_premises import certified_premises
from dssc_jax.flight_code.folder import FlightFolder
from dssc_jax.flight_code.monitor_recording import recorded_flights

PAGE = Path(__file__).parents[1] / "docs" / "flight.md"
STUDIES = {"certified_margin": {"unmodelled.mu": 0.01}, "hover_wind": {}}
"""The proved studies, with the changes under which they are proved."""


class Case(NamedTuple):
    """Flights of a study with changed numbers, of so many samples."""

    study: str
    label: str
    changes: Mapping[str, object]
    samples: int


CASES = (
    Case("certified_margin", "as proved", {}, 20_000),
    Case("certified_margin", "start at 0.3 m instead of 0.2 m", {"plant.initial": [0.3, 0.0]}, 20_000),
    Case("certified_margin", "disturbance 30 % too large", {"disturbance.amplitude": 0.13}, 20_000),
    Case("certified_margin", "disturbance three times as fast", {"disturbance.period": 2.0}, 20_000),
    Case("certified_margin", "disturbance six times as fast", {"disturbance.period": 1.0}, 20_000),
    Case("certified_margin", "half of the smallest gain", {"plant.k_p": 0.45}, 20_000),
    Case("certified_margin", "three times the lag", {"unmodelled.mu": 0.03}, 20_000),
    Case("hover_wind", "as proved", {}, 16_000),
    Case("hover_wind", "wind 30 % too strong", {"wind.speed": 6.5, "wind.vertical": 3.25}, 16_000),
    Case("hover_wind", "horizontal wind of twice the speed", {"wind.speed": 10.0}, 16_000),
    Case("hover_wind", "start 0.5 m away", {"plant.position": [0.5, 0.0, 0.0]}, 16_000),
    Case("hover_wind", "mass 10.6 kg", {"plant.vehicle.mass": 10.6}, 16_000),
)


def proved_folder(name: str) -> FlightFolder:
    """The folder of a study with the monitor of its certificate."""
    study = dj.Study.load(name).override(STUDIES[name]).without_sweep()
    content = json.loads(json.dumps(dj.prove(study).certificate()))
    return FlightFolder(study, certified_premises(study, content, name))


def first_raised(folder: FlightFolder, changes: Mapping[str, object], draws: int, samples: int) -> list[dict[str, int]]:
    """Of each flight of the changed study, the first sample of each flag that the study's monitor raises."""
    assert folder.monitor is not None
    names = [flag.name for flag in folder.monitor.premises.flags()]
    place = len(folder.monitor.inputs)
    study = folder.code.study.override(changes)
    found = []
    for number, rows in enumerate(recorded_flights(study, folder.monitor, draws, samples)):
        if number % 2:  # the strained flight
            continue
        current = rows[:, place].astype(np.int64)
        raised = {name: np.flatnonzero(current >> bit & 1) for bit, name in enumerate(names)}
        found.append({name: int(at[0]) for name, at in raised.items() if len(at)})
    return found


def earliest(found: Mapping[str, int]) -> list[str]:
    """The flags that a flight raises first."""
    return [name for name, sample in found.items() if sample == min(found.values())]


def main() -> None:
    """Watch the flights and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=32, help="flights of each case")
    flights = parser.parse_args().flights
    lines = [
        "| study | flights | with a flag | first flags, in flights | first at [s], median |",
        "|---|---|---|---|---|",
    ]
    folders = {name: proved_folder(name) for name in STUDIES}
    for case in CASES:
        folder = folders[case.study]
        found = [raised for raised in first_raised(folder, case.changes, flights, case.samples) if raised]
        counts = Counter(name for raised in found for name in earliest(raised))
        words = ", ".join(f"`{name}` {count}" for name, count in counts.most_common()) or "-"
        times = [min(raised.values()) * folder.code.study.loop.sample_time for raised in found]
        median = f"{np.median(times):.3g}" if times else "-"
        lines.append(f"| `{case.study}` | {case.label} | {len(found)} of {flights} | {words} | {median} |")
        print(lines[-1], flush=True)
    put("premises", "\n".join(lines), PAGE)


if __name__ == "__main__":
    main()
