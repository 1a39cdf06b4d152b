"""Run every experiment of the page; write its figures and the page."""

import time
from collections.abc import Mapping, Sequence
from itertools import product

from benchmarks.noise import figures
from benchmarks.noise.contests import CONTROLLERS, NAMES, controller_costs, differentiator_costs
from benchmarks.noise.contests import PERIODS as CONTEST_PERIODS
from benchmarks.noise.costs import Costs
from benchmarks.noise.forms import (
    FAST,
    FORMS,
    ROOT,
    ROWS,
    Rest,
    deviations,
    largest_sample_time,
    rests,
)
from benchmarks.noise.maps import ATTITUDE, PANELS, Vehicle, attitude, noise_map, spectra, vehicle
from benchmarks.noise.starts import Start, starts
from dssc_jax import plotting
from dssc_jax.console.environment import machine

DRAWS, SLOW, FINEST = 16, (0.02, 0.01, 0.005), 0.000625
PAGE = (ROOT / "benchmarks" / "noise" / "page.md").read_text()


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def ms(sample_time: float) -> str:
    """A sampling period in milliseconds."""
    return f"{1e3 * sample_time:g} ms"


def change(noisy: Rest, quiet: Rest) -> str:
    """By how much noise changes the error."""
    return f"{100 * (noisy.error / quiet.error - 1):+.0f} %"


def rest_table() -> str:
    """Where both forms rest under noise."""
    rows = []
    for row, sample_time in product(ROWS, FAST):
        found = rests(row, sample_time, DRAWS)
        numbers = found.quiet.error, found.floor, found.predicted, found.implicit.error, found.conservative.error
        changes = (
            change(found.conservative, found.quiet),
            change(found.disturbed, found.quiet_disturbed),
            f"{found.tight.error:.3g}",
        )
        variation = f"{found.implicit.variation:.3g} / {found.conservative.variation:.3g}"
        rows.append((f"`{row}`", ms(sample_time), *(f"{number:.3g}" for number in numbers), *changes, variation))
    head = ("functions", "T_s", "no noise", "floor", "predicted rest", "implicit", "conservative", "change")
    return table((*head, "change with d", "rho = 1.5 with d", "variation of u"), rows)


def accuracy_table() -> str:
    """Distance to the limit without noise, and its order."""
    rows = []
    for row in ROWS:
        for (form, start), errors in deviations(row, SLOW, FINEST).items():
            order = f"{errors[0] / errors[1]:.2f}, {errors[1] / errors[2]:.2f}"
            rows.append((f"`{row}`", form, start, *(f"{error:.3g}" for error in errors), order))
    return table(("functions", "form", "start", *(ms(each) for each in SLOW), "ratios"), rows)


def limit_table() -> str:
    """The sampling limit, and where a limit cycle has grown to 0.05 m/s."""
    rows = []
    for row in ROWS:
        found = [largest_sample_time(row, form, start) for start in (1e-9, 0.05) for form in FORMS]
        rows.append((f"`{row}`", *(f"{each:.4f}" for each in found)))
    columns = [f"{what}, {form}" for what in ("limit", "cycle of 0.05 m/s") for form in FORMS]
    return table(("functions", *columns), rows)


def cost_table(
    found: Mapping[tuple[str, float], Costs],
    names: Mapping[str, str],
    tuned: Mapping[tuple[str, float], float] | None = None,
) -> str:
    """The five costs at every T_s."""
    rows = []
    for (name, period), costs in found.items():
        extra = [f"{tuned[name, period]:.3g}".replace("nan", "")] if tuned else []
        rows.append((names[name], ms(period), *extra, *(f"{cost:.3g}" for cost in costs)))
    extra = ["parameter"] if tuned else []
    head = ("", "T_s", *extra, "L2", "L2 between samples", "L-infinity", "variation per second", "distortion")
    return table(head, rows)


def vehicle_table(found: Vehicle) -> str:
    """Failures of the vehicle."""
    rows = []
    for name, count in found.failures.items():
        low, high = found.intervals[name]
        rows.append((name, f"{count} of {found.draws}", f"{low:.3f} to {high:.3f}"))
    return table(("form", "failures", "95 % interval (Clopper-Pearson)"), rows)


def start_table(found: Sequence[Start]) -> str:
    """The starts of the predictor."""
    rows = []
    for one in found:
        numbers = f"{one.error:.4g}", f"{one.settled:.4g}", f"{one.jump:.3g}", f"{one.outside:.1%}"
        rows.append((one.form, f"{one.rho:g}", one.start, *numbers))
    head = ("form", "rho [m/s]", "start", "rms of e [m]", "after 40 s", "u_av after 1 s [m/s]", "outside sliding")
    return table(head, rows)


def main() -> None:
    began = time.perf_counter()
    controllers = {(name, h): controller_costs(name, h) for name in CONTROLLERS for h in CONTEST_PERIODS}
    tried = {(name, h): differentiator_costs(name, h) for name in NAMES for h in CONTEST_PERIODS}
    tuned = {key: parameter for key, (parameter, _) in tried.items()}
    differentiators = {key: costs for key, (_, costs) in tried.items()}
    maps = {panel: noise_map(panel) for panel in PANELS}
    gains, flights, turned = spectra(), vehicle(), attitude()
    pictures = {
        "noise_maps": figures.maps(maps),
        "noise_costs": figures.costs(controllers, differentiators),
        "noise_spectra": figures.spectra(gains),
    }
    for name, figure in pictures.items():
        plotting.write(figure, ROOT / "docs" / "figures" / f"{name}.png")
    paired = flights.paired
    page = PAGE.format(
        machine=machine(),
        rests=rest_table(),
        accuracy=accuracy_table(),
        limits=limit_table(),
        controllers=cost_table(controllers, CONTROLLERS),
        differentiators=cost_table(differentiators, NAMES, tuned),
        vehicle=vehicle_table(flights),
        only_implicit=paired.only_a,
        only_conservative=paired.only_b,
        p_value=f"{paired.p_value:.1g}",
        difference=f"{paired.difference:.3f}",
        interval=" to ".join(f"{each:.3f}" for each in paired.interval),
        attitude=table(
            ("form", *(f"{each:g} rad/s" for each in ATTITUDE)),
            [(form, *(f"{share:.1%}" for share in shares)) for form, shares in turned.items()],
        ),
        amplification=", ".join(f"{name} {one.attrs['amplification']:.2f}" for name, one in gains.items()),
        starts=start_table(starts()),
        draws=DRAWS,
        seconds=f"{time.perf_counter() - began:.0f}",
    )
    (ROOT / "docs" / "noise.md").write_text(page)


if __name__ == "__main__":
    main()
