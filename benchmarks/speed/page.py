"""docs/performance.md and its figures, from what was measured."""

from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.page import put, stored_part
from benchmarks.speed import native, rivals
from benchmarks.speed.contest import (
    NUMBA,
    NUMPY,
    ONE_DEVICE,
    OURS,
    PLAIN,
    ROOT,
    SIZES,
    UNFUSED,
    C,
    Measured,
    quartiles,
    ratios,
)  # fmt: skip
from benchmarks.speed.scaling import Run
from benchmarks.speed.workloads import ALLOWED, Case
from dssc_jax import plotting
from dssc_jax.console.environment import machine
from dssc_jax.lanes.llvm.machine import vector_bits

DOCS = ROOT / "docs"
PURPLE = "#CC79A7"  # of the same palette as the others, for readers who confuse colours
WITH_C = {bits: f"two programs, {bits} bits" for bits in (512, 256)}
RATES, SCALING = "performance_rates.png", "performance_scaling.png"
SHOWN = (C, OURS, PLAIN, UNFUSED, NUMBA, NUMPY)
COLOURS = dict(
    zip(
        [c.name for c in SHOWN],
        (plotting.GREY, plotting.BLUE, plotting.ORANGE, PURPLE, plotting.GREEN, plotting.RED),
        strict=True,
    )
)


class Everything(NamedTuple):
    """What the page is made of."""

    contests: dict[Case, dict[str, Measured]]
    curves: dict[str, list[Run]]
    mission: Run


def millions(rate: float) -> str:
    """A rate in millions, with three figures at most."""
    return f"{rate / 1e6:.3g}"


def spread(values: Iterable[float | None], scale: float = 1.0) -> str:
    """Median, and the quartiles in brackets."""
    low, middle, high = (scale * value for value in quartiles(list(values)))
    return f"{middle:.3g} [{low:.3g}, {high:.3g}]"


def table(header: list[str], rows: Iterable[list[str]]) -> str:
    """A Markdown table."""
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header), *("| " + " | ".join(r) + " |" for r in rows)]
    return "\n".join(lines)


def rates_table(contests: dict[Case, dict[str, Measured]]) -> str:
    """Millions of lane-steps a second."""
    names = [contender.name for contender in (*SHOWN, ONE_DEVICE)]
    rows = []
    for case, measured in contests.items():
        cells = [spread(measured[name].rates, 1e-6) if name in measured else "" for name in names]
        rows.append([case.text, *cells])
    return table(["", *names], rows)


def ratios_table(contests: dict[Case, dict[str, Measured]]) -> str:
    """Our rate over each other's, round by round."""
    names = [contender.name for contender in (*SHOWN, ONE_DEVICE) if contender is not OURS]
    rows = []
    for case, measured in contests.items():
        ours = measured[OURS.name]
        rows.append([case.text, *(spread(ratios(ours, measured[name])) if name in measured else "" for name in names)])
    return table(["ours over", *names], rows)


def plain_shares(contests: dict[Case, dict[str, Measured]]) -> str:
    """How near the plain forms of the UAV come to C."""
    cases = [contests[Case("uav", method)] for method in ("rk4", "euler")]
    if any(C.name not in measured for measured in cases):
        return ""
    (many, more), (one, two) = (
        [np.median(ratios(measured[form.name], measured[C.name])) for form in (PLAIN, UNFUSED)] for measured in cases
    )
    return (
        f" (for the UAV in float64, {many:.2g} and {more:.2g} of C's rate with RK4,\n"
        f"{one:.2g} and {two:.2g} with Euler)"
    )


def costs_table(measured: dict[str, Measured]) -> str:
    """What a process costs."""
    rows = [
        [name, f"{m.compile_seconds:.1f}", f"{m.ready:.1f}", f"{m.peak:.2f}", f"{m.difference:.0e}"]
        for name, m in measured.items()
    ]
    header = ["", "compile [s]", "from start to first result [s]", "peak memory [GB]", "largest difference from ours"]
    return table(header, rows)


def draw_rates(contests: dict[Case, dict[str, Measured]]) -> None:
    """Bars of every case and contender."""
    with rc_context(plotting.STYLE):
        figure = Figure(figsize=plotting.SLIDE, layout="constrained")
        ax = figure.subplots()
        width = 0.8 / len(SHOWN)
        for i, contender in enumerate(SHOWN):
            for at, measured in enumerate(contests.values()):
                if contender.name in measured:
                    low, middle, high = (1e-6 * q for q in quartiles(measured[contender.name].rates))
                    place, label = at + (i - (len(SHOWN) - 1) / 2) * width, contender.name if at == 0 else None
                    bars = [[middle - low], [high - middle]]
                    ax.bar(place, middle, width, color=COLOURS[contender.name], label=label, yerr=bars, capsize=2)
        ax.set_xticks(range(len(contests)), [case.text.replace(", ", "\n") for case in contests])
        ax.set(yscale="log", ylabel="million lane-steps a second")
        ax.grid(visible=False, axis="x")
        ax.legend(frameon=False, ncols=len(SHOWN), loc="lower center", bbox_to_anchor=(0.5, 1.0))
        plotting.write(figure, DOCS / "figures" / RATES)


def panel(ax: Axes, runs: dict[str, list[Run]], xlabel: str) -> None:
    """Seconds over whatever is varied, with a straight line of slope one, and peak memory on the right."""
    right = ax.twinx()
    right.grid(visible=False)
    for (name, curve), colour in zip(runs.items(), (plotting.BLUE, plotting.GREEN), strict=False):
        x = np.array([run.x for run in curve])
        ax.loglog(x, [run.seconds for run in curve], marker="o", color=colour, label=name)
        right.semilogx(x, [run.peak for run in curve], marker="s", color=plotting.ORANGE, linestyle=":", markersize=4)
    last = curve[-1]
    ax.loglog(x, last.seconds * x / last.x, color=plotting.GREY, linewidth=1.0, linestyle="--", label="linear")
    right.set(ylabel="peak memory [GB]", ylim=(0.0, 1.25 * max(r.peak for c in runs.values() for r in c)))
    right.yaxis.label.set_color(plotting.ORANGE)
    ax.set(xlabel=xlabel, ylabel="time [s]")
    ax.legend(frameon=False, loc="upper left")


def draw_scaling(curves: dict[str, list[Run]]) -> None:
    """Time and memory over draws, duration and sweep points."""
    with rc_context(plotting.STYLE):
        figure = Figure(figsize=(15.0, 4.8), layout="constrained")
        first, second, third = figure.subplots(1, 3)
        by_devices = {name.partition(", ")[2]: runs for name, runs in curves.items() if name.startswith("draws")}
        panel(first, by_devices, "draws of 1 s")
        panel(second, {"16384 draws": curves["duration"]}, "duration [s]")
        panel(third, {"1024 draws of 10 s": curves["points"]}, "sweep points")
        plotting.write(figure, DOCS / "figures" / SCALING)


def slope(runs: list[Run]) -> float:
    """Exponent of the growth of time, over the half of the curve with the larger runs."""
    part = runs[len(runs) // 2 :]
    return float(np.polyfit(np.log([r.x for r in part]), np.log([r.seconds for r in part]), 1)[0])


def growth_table(curves: dict[str, list[Run]]) -> str:
    """What the figure says in numbers."""
    rows = []
    for name, runs in curves.items():
        first, last = runs[0], runs[-1]
        ends = f"{first.x:g} to {last.x:,.0f}"
        rows.append([name, ends, f"{last.seconds:.2f}", f"{slope(runs):.2f}", f"{first.peak:.2f} to {last.peak:.2f}"])
    return table(
        ["over", "from, to", "time of the last [s]", "exponent of growth", "peak memory, first to last [GB]"], rows
    )


def size(loop: str) -> str:
    """Draws and duration of a contest."""
    draws, duration = SIZES[loop]
    return f"{draws:,} draws of {duration:g} s"


def page(found: Everything) -> str:
    """The whole page."""
    traces = ", ".join(str(count) for count in sorted({run.traces for run in found.curves["points"]}))
    return f"""# Speed, measured

Regenerated by `make bench`. Machine: {machine()}, {versions()}.

A lane-step advances one draw by one sample of 5 ms. All programs run the same loop on the same draws, each in its own
process. Within a case they take turns, and ratios are computed round by round. The tables give
median and quartiles. All programs use every core, except in the column "one device".

* **UAV**: `benchmarks/speed/uav.toml`, {size("uav")}. Four DSSC channels, inner loops, drag, limited allocation,
  wind; mass, inertia and thrust coefficient are uncertain. 12 metrics. One step of Runge-Kutta (RK4) or of
  semi-implicit Euler a sample.
* **1-DOF**: `benchmarks/speed/axis.toml`, {size("axis")}. DSSC behind a lag of order 2, a step of the
  disturbance; gain, damping, lag and step are uncertain. 3 metrics. Plant and lag are linear, and command and
  disturbance are held over a sample, so all programs use the exact solution. They compute it once for a draw, within
  the measured time. The loop has no rows for RK4 and Euler, which would be the same program.
* **C**: `benchmarks/speed/c`, the same arithmetic written by hand and used as the baseline: vectors of draws in
  registers, one thread per core, the study's fixed numbers as compile-time constants, and the faster of two sets of
  compiler options.
* **jit(vmap(scan))**: the straightforward form of this package's own loop. **No fusion**: the same without
  XLA's pass `fusion`, as in the plain form that checks results.
* **Numba**: `prange` over draws, scalar code, fast mathematics. **NumPy**: all draws in one array. Both run
  `benchmarks/speed/by_hand.py`.

The trigonometric functions that replace the compiler's own, `atan` and `atan2` of
`lanes/functions/approximations.py`, are within 3 units in the last place in both precisions
(`tests/core/test_numerics.py`).

Millions of lane-steps per second:

{rates_table(found.contests)}

![rates](figures/{RATES})

Medians of the ratios of the rounds. They differ from the quotients of the medians above where the machine's speed
changed between rounds:

{ratios_table(found.contests)}

In `jit(vmap(scan))`, each fused kernel of a step recomputes values that several kernels share. With and without
fusion, the state of all draws is in memory{plain_shares(found.contests)}. In the column "one device",
one device simulates all the draws.

`python -m benchmarks.speed --with-c` lets dssc_jax and C alone take turns, on another kind of processor too; with
`--narrow`, both leave AVX-512 alone. `--processor` counts processor time. Vectors of 512 bits:

{stored_part(WITH_C[512], DOCS / "performance.md")}

Vectors of 256 bits:

{stored_part(WITH_C[256], DOCS / "performance.md")}

This processor has no wider vectors (Zen 3, 16 registers). Single cores are measured by processor time, and at times a
neighbour on the same core halves their speed. In the faster quarter of the rounds of another measurement of that day,
ours over C was 1.01, 0.99, 0.97 and 1.04 for the vehicle and 1.13 and 1.08 for the axis
([what was tried](lanes.md)).

The next table shows the cost of a process for the UAV with RK4 in float64. Before its first result, each process
imports this package to draw the same numbers. The metrics of all programs agree with ours to {ALLOWED[64]:g} relative
in float64 and {ALLOWED[32]:g} in float32, or the run fails.

{costs_table(found.contests[Case("uav")])}

## The limit of the processor

{stored_part("limits", DOCS / "performance.md")}

## Growth

![time and memory](figures/{SCALING})

The 1-DOF loop through `dj.run`, without compilation:

{growth_table(found.curves)}

A sweep is compiled once, whatever its number of points. Number of times the loop was traced in each run: {traces}.

## A full mission

{mission_table(found.mission)}

## What people wait for

{stored_part("waiting", DOCS / "performance.md")}

## Kernels of a GPU

{stored_part("kernels", DOCS / "performance.md")}

## Other simulators

{stored_part("simulators", DOCS / "performance.md")}
"""


def mission_table(mission: Run) -> str:
    """A full mission of many vehicles."""
    what = "10,000 draws of the UAV's mission of 80 s, RK4, float64, with metrics and storage, already compiled"
    rows = [
        [what, f"{mission.seconds:.1f} s"],
        ["its compilation", f"{mission.compile_seconds:.1f} s"],
        ["its peak memory", f"{mission.peak:.2f} GB"],
    ]
    return table(["what", "measured"], rows)


def versions() -> str:
    """What the contenders are made of."""
    gcc = native.version() if native.compiler() else "no C compiler"
    numba = f"Numba {version('numba')}" if rivals.has_numba() else "no Numba"
    return f"{gcc}, NumPy {version('numpy')}, {numba}"


def write(found: Everything, to: Path = DOCS / "performance.md") -> None:
    """The page and its figures."""
    draw_rates(found.contests)
    draw_scaling(found.curves)
    to.write_text(page(found), encoding="utf-8")


def write_with_c(
    contests: dict[Case, dict[str, Measured]],
    narrow: bool = False,
    of_a_core: bool = False,
    to: Path = DOCS / "performance.md",
) -> None:
    """The part of the page that compares two programs, for this machine's processor, perhaps without AVX-512.

    Args:
        contests: What was measured.
        narrow: Without AVX-512 on a processor that has it.
        of_a_core: Whether rates are those of one core, by processor time.
        to: The page.
    """
    bits = 256 if narrow else vector_bits()
    could = ", on a processor that could do 512 bits" if narrow and vector_bits() == 512 else ""
    core = " of processor time, while other programs ran" if of_a_core else ""
    lines = [
        f"Millions of lane-steps per second{core}{could}:",
        "",
        "| | C | dssc_jax | ours over C |",
        "|---|---|---|---|",
    ]
    for case, measured in contests.items():
        c, ours = measured[C.name], measured[OURS.name]
        cells = spread(c.rates, 1e-6), spread(ours.rates, 1e-6), spread(ratios(ours, c))
        lines.append(f"| {case.text} | {' | '.join(cells)} |")
    put(WITH_C[bits], "\n".join(lines), to)


def brief(case: Case, measured: dict[str, Measured]) -> str:
    """What the terminal shows of a contest."""
    lines = [case.text]
    for name, m in measured.items():
        share = "" if name == OURS.name else f", ours over it {spread(ratios(measured[OURS.name], m))}"
        lines.append(f"  {name:22s} {spread(m.rates, 1e-6)} million lane-steps a second{share}")
    return "\n".join(lines)
