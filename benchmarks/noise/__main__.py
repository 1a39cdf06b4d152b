"""Run every experiment of the page; write its figures and the page."""

import time
from collections.abc import Mapping, Sequence

from benchmarks.noise import figures
from benchmarks.noise.contests import CONTROLLERS, NAMES, controller_costs, differentiator_costs
from benchmarks.noise.contests import PERIODS as CONTEST_PERIODS
from benchmarks.noise.costs import Costs
from benchmarks.noise.forms import (
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
from dssc_jax.console import machine

DRAWS, SLOW = 16, (0.02, 0.01, 0.005)
PAGE = (ROOT / "benchmarks" / "noise" / "page.md").read_text()


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def ms(sample_time: float) -> str:
    """A sampling period in milliseconds."""
    return f"{1e3 * sample_time:g} ms"


def rest_table() -> str:
    """Where both forms rest under noise."""
    rows = []
    for (row, sample_time), found in rests(DRAWS).items():
        quiet, implicit, conservative, tight = (found[name] for name in ("quiet", *FORMS, "tight"))
        assert isinstance(quiet, Rest)
        assert isinstance(implicit, Rest)
        assert isinstance(conservative, Rest)
        assert isinstance(tight, Rest)
        numbers = quiet.error, found["predicted"], implicit.error, conservative.error
        variation = f"{implicit.variation:.3g} / {conservative.variation:.3g}"
        change = f"{100 * (conservative.error / quiet.error - 1):+.0f} %"
        shown = (*(f"{number:.3g}" for number in numbers), change, f"{tight.error:.3g}", variation)
        rows.append((f"`{row}`", ms(sample_time), *shown))
    head = ("functions", "T_s", "no noise", "predicted rest", "implicit", "conservative", "change", "rho = 1.5")
    head = (*head, "variation of u")
    return table(head, rows)


def accuracy_table() -> str:
    """Distance to the limit without noise, order, and sampling limits."""
    rows = []
    found = deviations(SLOW, 0.000625)
    for row in ROWS:
        limits = [largest_sample_time(row, form) for form in FORMS]
        for form, limit in zip(FORMS, limits, strict=True):
            errors = found[row, form]
            order = f"{errors[0] / errors[1]:.2f}, {errors[1] / errors[2]:.2f}"
            rows.append((f"`{row}`", form, *(f"{error:.3g}" for error in errors), order, f"{limit:.4g}"))
    head = ("functions", "form", *(ms(each) for each in SLOW), "ratios", "largest T_s [s]")
    return table(head, rows)


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
