"""Regenerate docs/margins.md and its figure, theory beside simulation: ``python benchmarks/theory.py``.

Every number of the page comes from here, with the machine and the date.
"""

import time
from pathlib import Path

import numpy as np
from gain_sets import CONSTANT, SQUARE_ROOT, random_gains

import dssc_jax as dj
from dssc_jax import plotting
from dssc_jax.analyses.comparison import controller_table, with_controller
from dssc_jax.analyses.margins import Margins
from dssc_jax.analyses.theory import Assessment
from dssc_jax.console.environment import machine

ROOT = Path(__file__).parents[1]
STUDY, CERTIFIED, DOCS = ROOT / "studies" / "compare_mu.toml", ROOT / "studies" / "certified_margin.toml", ROOT / "docs"
MU = "unmodelled.mu"
DURATION = 200.0
WALK = {"over": MU, "bounds": (0.01, 10.0), "log": True, "points": 10, "bisections": 14}
RIVALS = ("dssc", "ssc", "pi", "sta", "vgsta")
PERFORMANCE = {"over": MU, "bounds": (0.01, 5.0), "log": True}
WALKS = {
    MU: {"bounds": (0.002, 0.5), "log": True},
    "plant.k_p": {"bounds": (1.0, 0.01), "log": True},
    "spread": {"bounds": (0.1, 9.0)},
}
SWITCHING = {
    "STA": {"kind": "sta", "l0": 1.0, "kappa1": 1.5, "kappa2": 2.2},
    "SMC": {"kind": "smc", "l0": 1.0, "gain": 1.0},
}
FORMS = {
    "lag of order 1": (MU, (0.01, 5.0), {"kind": "lag", "order": 1, "mu": 0.01}),
    "lag of order 2": (MU, (0.01, 5.0), {"kind": "lag", "order": 2, "mu": 0.01}),
    "all-pass (1 - mu s/2)/(1 + mu s/2)": (
        MU,
        (0.01, 5.0),
        {"kind": "transfer_function", "mu": 0.01, "numerator": [1.0, -0.5], "denominator": [1.0, 0.5]},
    ),
    "resonance 1/(mu^2 s^2 + 0.4 mu s + 1)": (
        MU,
        (0.01, 5.0),
        {"kind": "transfer_function", "mu": 0.01, "numerator": [1.0], "denominator": [1.0, 0.4, 1.0]},
    ),
    "delay": ("unmodelled.samples", (1.0, 64.0), {"kind": "delay", "samples": 1.0, "memory": 64.0}),
    "rate limit": ("unmodelled.rate", (100.0, 0.05), {"kind": "rate_limit", "rate": 100.0}),
    "saturation": ("unmodelled.limit", (20.0, 0.05), {"kind": "saturation", "limit": 20.0}),
    "lag of the sensor": ("sensor.mu", (0.01, 5.0), {"kind": "lag", "mu": 0.01}),
}
FORMED = {"draws": 200, "loop.sample_time": 0.025, "requirement.0.max": 2.0, "unmodelled": {"kind": "none"}}
PAGE = """# Margins: theory and simulation

A margin says how far one number of a loop can go before something fails: the lag of an actuator, a gain, a limit.

## Two kinds of margin

A **performance margin** (`dssc-jax margin`, `dj.margin`) is the value of a number at which a draw stops meeting its
requirements. A **local margin** (`dj.theory.local_margin`) is the value at which small deviations from the origin
begin to grow, regardless of the requirements. With state-dependent functions, DSSC's gains decrease as the size of
sigma = e' + l0 e grows. Beyond the local margin, small deviations then grow and large ones do not, so the loop settles
into a bounded oscillation. It may still meet the requirements. Conversely, the requirements may fail long before, for
other reasons. The two margins are kept apart: every result states its criterion.

`margin` moves the number from LO, which must be the safe end and may be the larger value, to HI. This path is the
*walk*. The draws are simulated at a grid of its values, and bisection refines between two of them. A draw's critical
value is the last value at which it passed before it first failed. A draw that fails at the start counts as a critical
value before the start (*below*). One that passes the whole walk counts as one past the end (*beyond*).

The *lower tolerance limit* is the critical value up to which 95 % of all draws pass, with 95 % confidence (Wilks), as
far as the grid shows. It is absent (`null`) if it lies before the start or if there are too few draws, and the walk's
end if it lies beyond. The degradation curve is the failure probability along the walk; its confidence band is valid at
all values of the grid together (Bonferroni over Clopper-Pearson). A draw that passes again beyond a failure is reported
as not monotone; behaviour between two values of the grid is not detected. For `loop.sample_time` there is no bisection:
every sample time is compiled separately.

`--over spread=LO:HI` varies the uncertainty as a whole instead of a single number. A spread of c multiplies the
distance of every drawn number from the median of its law by c (in the logarithm, for logarithmic laws). All
spreads use the same random numbers. The critical value says by which factor the whole uncertainty of the draw may grow.

`--controllers A,B,...` computes the margins of several controllers on the same draws, with gains as in
[comparison](comparison.md). For each pair it reports which controller goes further, with the exact paired test.

`dj.load` loads the results of `margin` and `theory` from their folders and verifies their digests.

## Theory and simulation

`dssc-jax theory STUDY --over NAME=LO:HI` applies four methods to one number. If a method does not apply, the output
gives the reason. Theorem 1, Table 1, the conditions (A0)-(A4) and the law (22) are those of the article
([model](model.md)); STA is super-twisting, SMC first-order sliding mode.

| | applies to | does not cover |
|---|---|---|
| Theorem 1 | all draws and all states together | lag, sampling, sensors; gain functions other than those of Table 1 |
| eigenvalues | small deviations from the origin, draw by draw | requirements; controllers that switch at the \
origin; parts that do not [declare where they are smooth](frequency.md#where-there-is-no-derivative) |
| describing function | the sustained oscillation of STA or SMC under a lag | smooth laws |
| simulation | the requirements, draw by draw | cases that were not drawn |

Theorem 1 assumes that there are no unmodelled dynamics. A lag adds a term to the command: mu s W(mu s) u, with a
stable transfer function W. This term depends on u' and is therefore not a disturbance of the class (A0)-(A3), however
small mu is. On a walk over mu the certificate is therefore valid at mu = 0 only. For numbers that (A0)-(A4) bound, such
as k_p, it gives the value up to which the loop *without lag and sampling* is certified for all draws at once.

`studies/certified_margin.toml`, gains of Table 1, T_s = {certified_sampling:g} ms, {certified_draws} draws. "95 % of
draws" is the lower tolerance limit:

| walk | Theorem 1 | eigenvalues: median, 95 % of draws | simulated: median, 95 % of draws | passes the whole walk |
|---|---|---|---|---|
{beside}

![theory and simulation](figures/theory.png)

*Left: share of draws with a critical mu at or below the abscissa. Right: the residual oscillation after an initial
deviation of 1 mm. DSSC is quiet up to its local margin of {own:.4f} s and oscillates beyond it; STA and SMC, with the
corresponding gains, chatter at every mu, as their describing functions predict.*

![the same over the input gain](figures/theory_gain.png)

DSSC's amplitude of sigma beyond its local margin [m/s]: {left}.

## Every form of unmodelled dynamics

`studies/compare_mu.toml` with T_s = 25 ms, 200 draws and error_max <= 2 m, with each form in turn. For a limit, the
walk goes down from the large, safe value. Theorem 1 covers none of the forms.

| form | number | median | 95 % of draws |
|---|---|---|---|
{forms}

## Local margin: simulation, eigenvalues, continuous time

The table gives the critical mu [s] of the lag for 200 random plants and gain sets per row, T_s = 10 ms, and a rho so
large that DSSC's command never saturates. Simulated: a loop passes if, after a deviation of 1e-200 m, |sigma| neither
grows over 50 to 200 s nor exceeds 1e-4 delta^2. Sampled: spectral radius of the loop's own step, linearised at the
origin, where state-dependent functions have their values at sigma = 0. Continuous: eigenvalues of plant and lag under
the law (22). The last column is the gap to continuous time at T_s divided by that at T_s/2; it is 2 for an error of
first order.

| functions | order | critical mu | simulated against sampled, largest | sampled against continuous | gap ratio |
|---|---|---|---|---|---|
{agreement}

## Chattering: describing function against simulation

Lag of order 2, mu from 2 to 20 ms, mu max(a_p, l_0) <= 0.02, T_s = 0.1 ms <= mu/20.

| law | n in simulated amplitude ~ mu^n | amplitude, simulated/predicted | frequency at 20 ms, simulated/predicted |
|---|---|---|---|
{chattering}

## The margin study

    dssc-jax margin compare_mu --over unmodelled.mu=0.01:5 --log --controllers dssc,ssc,pi,sta,vgsta

{draws} draws, {count} controllers with corresponding gains (Table 2), 17 values of the grid, 14 bisections:
**{seconds:.1f} s in all**, {processor:.1f} s of processor time, compilation included. Required: {criterion}.

| controller | median critical mu [s] | 95 % pass up to [s] | fail at start | pass to end | not monotone | time [s] |
|---|---|---|---|---|---|---|
{table}

Here DSSC has a smaller margin than PI and SSC, which use DSSC's gains at sigma = 0. {why}. The STA
chatters under any lag, so it violates the requirement on command_tv. DSSC's local margin on the same draws: median
{median:.3f} s, 95 % of all draws up to {lower:.3f} s. The two margins differ: where small deviations still decay, the
error may already be too large.

`python benchmarks/theory.py` regenerates this page. Machine: {machine}.
"""


def critical(found: Margins) -> np.ndarray:
    """Critical values, every draw having one."""
    values = found.dataset["critical"].values
    assert not np.isnan(values).any()
    return values


def agreement() -> list[str]:
    """Simulated growth against eigenvalues, and those of the sampled loop against continuous time."""
    rows = []
    for functions, label in ((CONSTANT, "constant"), (SQUARE_ROOT, "square root")):
        for order in (1, 2):
            study, finer = (
                random_gains(order, functions, sample_time=step, duration=DURATION) for step in (0.01, 0.005)
            )
            local = critical(dj.theory.local_margin(study, **WALK))
            gap = np.abs(critical(dj.margin(study, **WALK)) / local - 1.0)
            exact = critical(dj.theory.local_margin(study, kind="continuous", **WALK))
            halved = critical(dj.theory.local_margin(finer, **WALK))
            ratio = (local / exact - 1.0) / (halved / exact - 1.0)
            cells = (
                label,
                f"{order}",
                f"{local.min():.3f} to {local.max():.3f}",
                f"{100 * gap.max():.4f} %",
                f"{100 * np.abs(local / exact - 1).max():.2f} %",
                f"{ratio.min():.3f} to {ratio.max():.3f}",
            )
            rows.append(f"| {' | '.join(cells)} |")
    return rows


def rest_loop(controller: dict, **loop: float) -> dj.Study:
    """k_p = a_p = l_0 = 1 under a lag of order 2."""
    return dj.Study.from_table(
        {
            "name": "oscillations",
            "loop": {"duration": 12.0, "sample_time": 1e-4, **loop},
            "plant": {"kind": "normal_form"},
            "controller": controller,
            "unmodelled": {"kind": "lag", "order": 2, "mu": 0.01},
        }
    )


def frequency(study: dj.Study, mu: float) -> float:
    """Simulated frequency [rad/s] of sigma, from its rising zeros over the last third."""
    pushed = study.override({"plant.initial": [1e-3, 0.0], "unmodelled.mu": mu})
    run = dj.simulate(pushed)
    late = run["t"].values > 2.0 / 3.0 * float(run["t"][-1])
    t, sigma = run["t"].values[late], run["sigma"].values[late]
    rising = t[:-1][(sigma[:-1] < 0.0) & (sigma[1:] >= 0.0)]
    return 2.0 * np.pi * (len(rising) - 1) / (rising[-1] - rising[0])


def chattering() -> list[str]:
    """Slopes in the limit mu max(a_p, l_0) <= 0.02, T_s <= mu/20, and prediction against simulation."""
    rows, values = [], np.geomspace(0.002, 0.02, 8)
    for name, controller in SWITCHING.items():
        study = rest_loop(controller, duration=4.0)
        found = dj.theory.chattering(study, values, push=1e-3, after=3.0)
        slope, _ = plotting.fitted_slope(values, found["amplitude"].values)
        ratio = (found["amplitude"] / found["predicted"]).values
        turns = frequency(study, 0.02) / float(found["frequency"][-1])
        rows.append(f"| {name} | {slope:.3f} | {ratio.min():.3f} to {ratio.max():.3f} | {turns:.3f} |")
    return rows


def certified() -> tuple[dict[str, Assessment], list[str]]:
    """The certified loop over three numbers: the theorem, eigenvalues and simulation; over mu oscillations too."""
    study, found, rows = dj.Study.load(CERTIFIED), {}, []
    rivals = {name: with_controller(study, name, controller_table(study, name)) for name in ("sta", "smc")}
    for name, walk in WALKS.items():
        one = found[name] = dj.theory.assess(study, over=name, **walk, rivals=rivals if name == MU else {})
        summary = one.summary()
        start, end = walk["bounds"]
        cells = [f"`{name}` {start:g} to {end:g}", f"{summary['certificate']['certified']:.4g}"]
        for answer in (summary["local"]["sampled"], summary["performance"]):
            shown = (answer["median"], answer["lower_tolerance"])
            cells.append(", ".join("beyond" if value == end else f"{value:.4g}" for value in shown))
        cells.append(f"{100 * summary['performance']['pass_to_end']:.3g} %")
        rows.append(f"| {' | '.join(cells)} |")
    return found, rows


def forms() -> list[str]:
    """One loop behind every form of unmodelled dynamics, and with a slow sensor."""
    study, rows = dj.Study.load(STUDY).override(FORMED), []
    for label, (name, bounds, table) in FORMS.items():
        formed = study.override({name.partition(".")[0]: table})
        found = dj.margin(formed, over=name, bounds=bounds, log=True)
        unit = found.summary()["unit"].replace("1", "samples")
        shown = (found.summary()[key] for key in ("median", "lower_tolerance"))
        cells = [label, f"`{name}`", *("below" if value is None else f"{value:.3g} {unit}" for value in shown)]
        rows.append(f"| {' | '.join(cells)} |")
    return rows


def performance() -> tuple[dict[str, Margins], list[str], float, float]:
    """The margin study, every controller on the same draws: seconds on the clock and of the processor."""
    study, rows = dj.Study.load(STUDY), []
    worked = time.process_time()
    contest = dj.compare_margins(study, RIVALS, **PERFORMANCE)
    processor = time.process_time() - worked
    for name, margins in contest.margins.items():
        summary = margins.summary()
        shares = [f"{100 * summary[key]:.3g} %" for key in ("fail_at_start", "pass_to_end", "non_monotone")]
        middle, lower = (f"{summary[key]:.3f}" if summary[key] else "below" for key in ("median", "lower_tolerance"))
        rows.append(f"| {name} | {middle} | {lower} | {' | '.join(shares)} | {margins.times['seconds']:.1f} |")
    return contest.margins, rows, contest.seconds, processor


def ended_by(found: Margins) -> str:
    """Which requirement fails just beyond the critical values, and by which draws."""
    critical = found.dataset["critical"].values
    beyond = float(np.nanquantile(critical, 0.9))
    result = dj.run(found.study.override({MU: beyond, "sweep": {}}))
    shares = {
        requirement.text: float((result.dataset[requirement.name] < 0.0).mean())
        for requirement in found.study.requirements
    }
    told = ", and ".join(f"{100 * share:.0f} % violate {text}" for text, share in shares.items())
    return f"At mu = {beyond:.2f} s, {told.replace('%', '% of the draws', 1)}"


def main() -> None:
    rows = agreement()
    slopes = chattering()
    assessments, reaches = certified()
    formed = forms()
    found, table, seconds, processor = performance()
    study, loop = dj.Study.load(STUDY), dj.Study.load(CERTIFIED)
    local = dj.theory.local_margin(study, **PERFORMANCE)
    over_mu, over_gain = assessments[MU], assessments["plant.k_p"]
    own = over_mu.edge
    assert own is not None
    plotting.write(plotting.theory(over_mu.margins, over_mu.oscillations, own), DOCS / "figures" / "theory.png")
    plotting.write(plotting.theory(over_gain.margins), DOCS / "figures" / "theory_gain.png")
    left = ", ".join(f"{value:.2e} ({mu:.3g} s)" for mu, value in beyond(over_mu.oscillations["dssc"], own))
    low = local.summary()
    page = PAGE.format(
        machine=machine(),
        agreement="\n".join(rows),
        chattering="\n".join(slopes),
        beside="\n".join(reaches),
        forms="\n".join(formed),
        certified_sampling=1e3 * loop.config.loop.sample_time,
        certified_draws=loop.config.draws,
        seconds=seconds,
        processor=processor,
        draws=f"{study.config.draws:,}",
        count=len(RIVALS),
        criterion=" and ".join(found["dssc"].criterion),
        table="\n".join(table),
        why=ended_by(found["dssc"]),
        median=low["median"],
        lower=low["lower_tolerance"],
        own=own,
        left=left,
    )
    (DOCS / "margins.md").write_text(page, encoding="utf-8")
    print(page)


def beyond(found, own: float) -> list[tuple[float, float]]:
    """mu and amplitude above a local margin."""
    pairs = zip(found[MU].values.tolist(), found["amplitude"].values.tolist(), strict=True)
    return [(mu, value) for mu, value in pairs if mu > own]


if __name__ == "__main__":
    main()
