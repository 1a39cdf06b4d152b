"""Writes the measured part of docs/fmu.md: rates of loops with an FMU beside those without. Run it as ``make fmu``."""

import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import dssc_jax as dj
from benchmarks.page import put
from dssc_jax.cli.native_build import build_fmu_library
from dssc_jax.engine.batching import Engine, lanes_of, values_of_draws
from dssc_jax.flight_code.folder import FlightFolder
from tests import fmus

PAGE = Path(__file__).parents[1] / "docs" / "fmu.md"
FMU_DRAWS = 16
OWN_DRAWS = 1024
REPEATS = 3
OUTER = {"kind": "pid", "k_p": 6.0, "k_i": 2.0, "k_d": 3.0, "filter": 0.02}
INPUTS = {"y": "measurement.y", "y_dot": "measurement.y_dot", "y_ref": "reference.y"}
INPUTS |= {"y_ref_dot": "reference.y_dot", "y_ref_ddot": "reference.y_ddot"}


def rate(study: dj.Study, draws: int, kernel: str = "lanes") -> float:
    """Samples per second on one core; the best of several runs."""
    engine = Engine(study.override({"draws": draws}), draws, devices=1, kernel=kernel)
    values, indices = lanes_of(engine.study, (slice(0, draws),), values_of_draws(engine.study, slice(0, draws)))
    engine(values, indices)()
    seconds = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        engine(values, indices)()
        seconds.append(time.perf_counter() - began)
    return draws * study.loop.steps / min(seconds)


def motor(folder: Path) -> tuple[dj.Study, dj.Study]:
    """The motor's loop with its PID as an FMU that this package has written, and without."""
    own = dj.Study.load("motor").without_sweep()
    unit = FlightFolder(own).fmu()
    library, reason = build_fmu_library(unit)
    if library is None:
        raise SystemExit(f"no FMU can be built here: {reason}")
    file = folder / "motor.fmu"
    file.write_bytes(unit.archive(library))
    table = {"kind": "fmu", "file": str(file), "sha256": dj.allow_native(file).sha256, "inputs": INPUTS}
    content = {name: value for name, value in own.table.items() if name not in ("compare", "tune")}
    return dj.Study.from_table({**content, "controller": {**table, "command": "command.u_p"}}), own


def mass(folder: Path) -> tuple[dj.Study, dj.Study]:
    """A mass with drag as an FMU, sampled exactly, and the same mass without."""
    file = fmus.built(folder, fmus.MASS)
    table = {"kind": "fmu", "file": str(file), "sha256": dj.allow_native(file).sha256}
    inside = {**table, "command": "u", "y": "x", "y_dot": "v", "parameters": {"drag": {"uniform": [0.5, 1.5]}}}
    own = {"kind": "normal_form", "a_p": {"uniform": [0.5, 1.5]}}
    rest = {"name": "mass", "draws": 16, "loop": {"duration": 5.0, "sample_time": 0.01}, "controller": OUTER}
    rest |= {"reference": {"kind": "sine", "amplitude": 1.0, "period": 4.0}}
    return dj.Study.from_table({**rest, "plant": inside}), dj.Study.from_table({**rest, "plant": own})


def main() -> None:
    """Measure and write the table."""
    rows = [
        "| loop | with the FMU, thousand samples a second and core | by plain XLA | without FMU | times slower |",
        "|---|---|---|---|---|",
    ]
    with TemporaryDirectory() as folder:
        pairs = {
            "`motor`, its PID as an FMU": motor(Path(folder)),
            "a mass with drag as an FMU, PID": mass(Path(folder)),
        }
        for name, (study, own) in pairs.items():
            found = rate(study, FMU_DRAWS)
            plain = rate(study, FMU_DRAWS, "scan")
            without = rate(own, OWN_DRAWS)
            ratio = float(np.round(without / found, -2))
            rows.append(f"| {name} | {found / 1e3:.0f} | {plain / 1e3:.0f} | {without / 1e3:,.0f} | {ratio:,.0f} |")
            print(rows[-1], flush=True)
    put("measured", "\n".join(rows), PAGE)


if __name__ == "__main__":
    main()
