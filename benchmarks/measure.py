"""Regenerate docs/measurements.md and the figures of the documentation: ``make measure``.

Every number in the documentation comes from here, with the machine and the date.
"""

import json
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from statistics import median

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import dssc_jax as dj
from dssc_jax import plotting
from dssc_jax.console.environment import machine
from dssc_jax.engine.batching import Engine, Layout, execute
from dssc_jax.study.library import find_study

DOCS = Path(__file__).parents[1] / "docs"
FIGURES = DOCS / "figures"
SAMPLE_TIMES = (1e-5, 1e-4, 2.5e-4, 1e-3, 2e-3, 5e-3, 1e-2)
MEMORY = """
import sys
import dssc_jax as dj
from dssc_jax.study.library import find_study
study = dj.Study.load(find_study("mu_robustness")).without_sweep().override({"draws": int(sys.argv[1])})
result = dj.run(study)
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))  # ru_maxrss is inherited on exec
print(int(peak.split()[1]) / 1e6, result.manifest["times"]["seconds"])
"""


def case_2() -> dj.Study:
    """Section V-B, Case 2, x axis: the main study without its uncertainty and lag."""
    return (
        dj.Study.load(find_study("mu_robustness"))
        .without_sweep()
        .override(
            {
                "draws": 1,
                "loop.duration": 80.0,
                "plant.k_p": 1.0,
                "plant.a_p": 1.0,
                "controller.predictor_start": "zero",
                "unmodelled": {"kind": "none"},
                "disturbance.value": -0.8,
                "requirement": [{"metric": "error_rms", "after": 40.0, "max": 5.0}],
            }
        )
    )


def discretisation() -> dict[tuple[float, str], tuple[float, float]]:
    """rms error over 40 to 80 s and total variation of u over 80 s, by sample time and form."""
    found = {}
    for sample_time in SAMPLE_TIMES:
        for form in ("implicit", "explicit"):
            if (sample_time, form) == (1e-5, "explicit"):
                continue
            study = case_2().override({"loop.sample_time": sample_time, "controller.discretisation": form})
            data = dj.run(study, devices=1).dataset
            found[sample_time, form] = (data["error_rms_after_40"].item(), data["command_tv"].item())
    return found


def draw_discretisation(found: dict[tuple[float, str], tuple[float, float]]) -> None:
    """The README's figure."""
    with rc_context(plotting.STYLE):
        figure = Figure(figsize=plotting.SLIDE, layout="constrained")
        left, right = figure.subplots(1, 2)
        for form, colour, marker in (("explicit", plotting.RED, "s"), ("implicit", plotting.BLUE, "o")):
            cells = sorted((dt, values) for (dt, other), values in found.items() if other == form)
            times = 1e3 * np.array([dt for dt, _ in cells])
            text = f"{form} Euler"
            left.semilogx(times, [rms for _, (rms, _) in cells], marker=marker, color=colour, label=text)
            right.loglog(times, [tv for _, (_, tv) in cells], marker=marker, color=colour, label=text)
        limit = found[1e-5, "implicit"][0]
        left.axhline(limit, color=plotting.GREY, linestyle=":", label=f"limit {limit:.3f} m")
        left.set(xlabel="sample time $T_s$ [ms]", ylabel="rms error, 40 s to 80 s [m]", ylim=(0, 20))
        right.set(xlabel="sample time $T_s$ [ms]", ylabel="total variation of the command [m/s]", ylim=(0.5, 2e4))
        for ax in (left, right):
            ax.legend(frameon=False)
        figure.suptitle("Case 2, x axis: the same controller, sampled in two ways")
        plotting.write(figure, FIGURES / "discretisation.png")


def studies() -> dict[str, dj.Result]:
    """The shipped sweeps, with their figures."""
    results = {}
    for name in ("mu_robustness", "residual_scaling"):
        results[name] = dj.run(dj.Study.load(find_study(name)))
        plotting.write(plotting.sweep(results[name]), FIGURES / f"{name}.png")
    return results


def first_study() -> None:
    """The figure of the README's first study."""
    text = (DOCS.parent / "README.md").read_text()
    table = tomllib.loads(text.split("```toml\n# servo.toml\n")[1].split("```")[0])
    study = dj.Study.from_table(table | {"sweep": {"unmodelled.mu": {"linspace": [0.2, 0.8, 31]}}})
    plotting.write(plotting.sweep(dj.run(study)), FIGURES / "servo.png")


def rates(repeats: int = 5) -> dict[int, float]:
    """Draw samples a second of the main study by precision, medians of interleaved runs without compilation."""
    engines = {}
    for precision in (64, 32):
        study = dj.Study.load(find_study("mu_robustness")).without_sweep()
        engines[precision] = Engine(study.override({"draws": 16384, "loop.precision": precision}), 16384)
    blocks = {precision: Layout.of(engine.study).blocks() for precision, engine in engines.items()}
    seconds: dict[int, list[float]] = {precision: [] for precision in engines}
    for turn in range(repeats + 1):
        for precision, engine in engines.items():
            before = engine.clock.run_seconds
            list(execute(engine, blocks[precision]))
            if turn:
                seconds[precision].append(engine.clock.run_seconds - before)
    samples = 16384 * engines[64].study.loop.steps
    return {precision: samples / median(times) for precision, times in seconds.items()}


def process(*arguments: str, repeats: int = 5) -> float:
    """Median wall time of a command of the command line, start included."""
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        subprocess.run([sys.executable, "-m", "dssc_jax.cli", *arguments], check=True, capture_output=True)
        times.append(time.perf_counter() - began)
    return median(times)


def memory(draws: int) -> tuple[float, float]:
    """Peak resident memory [GB] and seconds of so many 60 s draws, in a process of their own."""
    out = subprocess.run([sys.executable, "-c", MEMORY, str(draws)], check=True, capture_output=True, text=True)
    gigabytes, seconds = map(float, out.stdout.split())
    return gigabytes, seconds


def write(lines: list[str]) -> None:
    """The page."""
    (DOCS / "measurements.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


def main() -> None:
    FIGURES.mkdir(parents=True, exist_ok=True)
    table = discretisation()
    draw_discretisation(table)
    results = studies()
    first_study()
    residual = results["residual_scaling"].dataset
    slope, _ = plotting.fitted_slope(residual["controller.functions.phi_b"].values, residual["sigma_max"].values[:, 0])
    speed = rates()
    gigabytes, seconds = memory(100_000)
    simulate = process("simulate", "mu_robustness", "--set", "loop.duration=80.0", "--json")
    lines = [
        "# Measurements",
        "",
        f"Regenerated by `make measure`. Machine: {machine()}.",
        "",
        "## Case 2, x axis: implicit and explicit sampling",
        "",
        "rms error over 40 to 80 s [m], total variation of u over 80 s [m/s]; predictor started at zero.",
        "",
        "| T_s | explicit: rms, TV | implicit: rms, TV |",
        "|---|---|---|",
    ]
    for sample_time in SAMPLE_TIMES:
        cells = [table.get((sample_time, form)) for form in ("explicit", "implicit")]
        shown = [f"{cell[0]:.4f}, {cell[1]:.2f}" if cell else "" for cell in cells]
        lines.append(f"| {1e3 * sample_time:g} ms | {shown[0]} | {shown[1]} |")
    lines += [
        "",
        "![implicit and explicit sampling](figures/discretisation.png)",
        "",
        "## Residual against phi_b (Theorem 1)",
        "",
        f"Fitted slope of the largest |sigma| after the transient, phi_b from 2.5 to 40: **{slope:.3f}**.",
        "",
        "![residual against phi_b](figures/residual_scaling.png)",
        "",
        "## Speed and memory",
        "",
        "The main study's loop: 1-DOF DSSC, RK4, lag of order 2, 13 metrics.",
        "",
        "| what | measured |",
        "|---|---|",
        f"| draw samples per second, float64, all cores, without compilation | {speed[64] / 1e6:.0f} million |",
        f"| the same, float32 | {speed[32] / 1e6:.0f} million |",
        f"| 100,000 draws of 60 s at 5 ms: time, compilation included | {seconds:.1f} s |",
        f"| the same: peak memory of the process | {gigabytes:.2f} GB |",
        f"| `dssc-jax simulate`, one draw of 80 s, process start and compilation included | {simulate:.2f} s |",
        f"| `dssc-jax --help` | {process('--help'):.2f} s |",
    ]
    write(lines)
    print(json.dumps({"slope": slope, "rates": speed, "memory_gb": gigabytes, "simulate_s": simulate}))


if __name__ == "__main__":
    main()
