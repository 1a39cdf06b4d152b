"""Regenerate docs/conservatism.md: how much the theorem leaves on the table. ``make conservatism``.

Random designs and plants: the certified residual against the worst one simulated, and the certified reach in
disturbance and in k_p against the simulated reach. Every lane is a design of its own.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import dssc_jax as dj
from benchmarks.page import stored_part
from dssc_jax import plotting
from dssc_jax.console.environment import machine
from dssc_jax.design import Bounds, Free, Guarantee, Parameters, certified, design, guarantee
from dssc_jax.design.feasibility import scaled_bounds
from dssc_jax.design.practice import practice
from dssc_jax.engine.batching import Engine

DOCS = Path(__file__).parents[1] / "docs"
DESIGNS, PLANTS, REACHES = 1000, 8, 200
DURATION, AFTER, SAMPLE_TIME = 40.0, 25.0, 1e-3  # s
HALVINGS, FINE = 10, 40  # of a reach that is simulated, and of a certified one
FAR = 1000.0  # factor up to which plants are simulated
FURTHEST = 1e6  # up to which certificates are looked for
ANY = {"uniform": [0.0, 1.0]}  # makes a number a lane's own; the values come from here
POSITIVE = {"uniform": [1e-9, 1.0]}
FUNCTIONS = ("phi_a", "phi_b", "kappa_a", "kappa_b", "kappa_c", "kappa_d", "epsilon", "gamma", "delta")
PARTITION = ("k_d1", "k_d2", "k_d3", "k_d4", "k_d5", "alpha_d2", "alpha_d3")
STUDY = {
    "name": "conservatism",
    "draws": 1,
    "loop": {"duration": DURATION, "sample_time": SAMPLE_TIME},
    "plant": {"kind": "normal_form", "k_p": POSITIVE, "a_p": ANY, "initial": [ANY, ANY]},
    "reference": {"kind": "sine", "amplitude": ANY, "period": POSITIVE},
    "controller": {
        "kind": "dssc",
        "l0": POSITIVE,
        "rho": 1e6,
        "predictor_start": "matched",
        "functions": {"kind": "vgsta", "k_o": 1.0, **dict.fromkeys(FUNCTIONS, POSITIVE)},
    },
    "disturbance": {"kind": "partition", **dict.fromkeys(PARTITION, ANY), "value": ANY, "period": POSITIVE},
    "metrics": {"after": AFTER, "names": ["error_max", "sigma_max"]},
    "requirement": [{"metric": "sampling_ratio", "after": 0.0, "max": 1.0}],
}


PROVED_HEADING = ("## Theorem 1, proved, simulated", "", "`make proofs` regenerates this part ([proofs](proofs.md)).")
INTRODUCTION = f"""\
Theorem 1 of the article ([model](model.md)) guarantees bounds of e and sigma for all plants within given bounds. This
page compares them with simulated errors.

{DESIGNS} random designs of order two satisfy Table 1 and the small-gain condition strictly. Each is simulated with
{PLANTS} plants for {DURATION:g} s at T_s = {1e3 * SAMPLE_TIME:g} ms, and the worst values after {AFTER:g} s count:

* The plants take both ends of k_p and a_p, a sine reference, and disturbances that attain the bounds (A1)-(A3) at
  several periods.
* The sample contains only designs whose proposed sampling period (that of `design`) is longer than T_s, and whose
  guaranteed decay leaves less than e^-10 of the initial deviation by then.
* The metric `sampling_ratio` stayed below 1, its stability limit, in {{ratio}} of {DESIGNS} designs. In {{exceeded}} of
  these a simulated residual exceeded the certified one.
"""
REACHED = f"""\
The next table shows how far each quantity can grow, for {REACHES} of the designs, before the certificate is lost, and
before a simulated plant leaves the residual set certified at factor 1 or exceeds the sampling limit. A certificate at a
larger factor guarantees a larger set only. Simulated factors are cut at {FAR:g} and 1/{FAR:g}; if the median depends on
cut values, it is given as a bound. k_d1 ... k_d5, alpha_d2 and alpha_d3 are the constants of the disturbance's bounds
(A1)-(A3).
"""
AFTERWARDS = """
The simulated factor on k_max ends at the sampling limit, which the theorem does not know. It can therefore be smaller
than the certified one.

![certified against simulated](figures/conservatism.png)

`make conservatism` regenerates this part in {seconds:.0f} s. Machine: {machine}.
"""


class Case(NamedTuple):
    """Designs with what they were made for; arrays over designs."""

    parameters: Parameters
    bounds: Bounds
    period: np.ndarray


def random_cases(rng: np.random.Generator, count: int) -> Case:
    """Designs whose sampling period is long enough to be simulated at T_s, and that forget their start in time."""
    cases: list[Case] = []
    found = 0
    while found < count:
        candidates = candidate_cases(rng, 4 * count)
        kept = runnable(candidates)
        cases.append(taken(candidates, kept))
        found += int(kept.sum())
    return taken(joined(cases), np.arange(found) < count)


def candidate_cases(rng: np.random.Generator, count: int) -> Case:
    """Bounds and strict designs at random."""

    def between(low: float, high: float) -> np.ndarray:
        return np.exp(rng.uniform(np.log(low), np.log(high), count))

    amplitude, period = between(0.05, 2.0), between(4.0, 40.0)
    rate = 2.0 * np.pi / period
    k_min = between(0.5, 1.5)
    swings = {name: amplitude * rate**n for n, name in enumerate(("y_m", "y_m_dot", "y_m_ddot", "y_m_dddot"))}
    small = {name: between(1e-3, 0.1) for name in ("k_d1", "k_d2", "k_d3", "k_d4", "k_d5", "alpha_d2", "alpha_d3")}
    bounds = Bounds(
        k_min=k_min, k_max=k_min * between(1.01, 1.5), a_max=rng.uniform(0.0, 1.0, count), **small, **swings
    )
    free = Free(
        l0=between(0.3, 2.0),
        phi_a=np.full(count, 0.1),
        eps=between(0.1, 1.0),
        delta=np.full(count, 0.5),
        eps_1=between(0.5, 20.0),
        eps_2=np.full(count, 0.1),
        eps_3=between(1.0, 100.0),
    )
    return Case(design(bounds, free), bounds, between(2.0, 40.0))


def runnable(case: Case) -> np.ndarray:
    """Which designs can be shown at T_s within the simulated time."""
    promised = guarantee(case.parameters, case.bounds)
    return (practice(case.parameters, case.bounds).sample_time > SAMPLE_TIME) & (promised.decay_rate * AFTER > 10.0)


def joined(cases: list[Case]) -> Case:
    """Cases end to end; what is no array is the same for all."""
    return jax.tree.map(lambda *parts: np.concatenate(parts) if np.ndim(parts[0]) else parts[0], *cases)


def taken(case: Case, kept: np.ndarray) -> Case:
    """The cases that a mask or index picks."""
    return jax.tree.map(lambda part: part[kept] if np.ndim(part) else part, case)


class Plants(NamedTuple):
    """The plants that fly each design: shapes (designs, plants)."""

    k_p: np.ndarray
    a_p: np.ndarray
    period: np.ndarray
    sign: np.ndarray


def plants_of(rng: np.random.Generator, bounds: Bounds, period: np.ndarray) -> Plants:
    """Both ends of k_p and a_p, and disturbances of several periods and signs."""
    shape = (len(period), PLANTS)
    column = np.arange(PLANTS)
    ends = [column % 2, (column // 2) % 2]
    k_p = np.where(ends[0], bounds.k_max[:, None], bounds.k_min[:, None])
    a_p = np.where(ends[1], bounds.a_max[:, None], -bounds.a_max[:, None])
    sign = np.broadcast_to(np.where(column // 4 % 2, 1.0, -1.0), shape)
    return Plants(k_p, a_p, period[:, None] * np.exp(rng.uniform(-1.5, 1.5, shape)), sign)


class Loops:
    """The loop of all lanes, compiled once."""

    def __init__(self, lanes: int) -> None:
        self.study = dj.Study.from_table(STUDY)
        self.engine = Engine(self.study, lanes)

    def worst(self, case: Case, plants: Plants) -> dict[str, np.ndarray]:
        """Largest late |e| and |sigma|, and sampling ratio, over each design's plants; infinite if one diverges."""
        p, b = case.parameters, case.bounds
        count = len(case.period)
        rate = b.y_m_dot / b.y_m
        shared = {
            "plant.initial.0": np.zeros(count),
            "plant.initial.1": b.y_m_dot,
            "reference.amplitude": b.y_m,
            "reference.period": 2.0 * np.pi / rate,
            "controller.l0": p.l0,
            **{f"controller.functions.{name}": getattr(p, "eps" if name == "epsilon" else name) for name in FUNCTIONS},
            **{f"disturbance.{name}": getattr(b, name) for name in PARTITION},
        }
        values = {name: np.repeat(array, PLANTS) for name, array in shared.items()}
        values |= {
            "plant.k_p": plants.k_p.ravel(),
            "plant.a_p": plants.a_p.ravel(),
            "disturbance.period": plants.period.ravel(),
            "disturbance.value": 0.2 * plants.sign.ravel(),
        }
        found = self.engine(values, np.zeros(count * PLANTS, dtype=int))()
        names = {"e": "error_max", "sigma": "sigma_max", "ratio": "sampling_ratio_after_0"}
        return {
            short: np.where(np.isnan(found[name]), np.inf, found[name]).reshape(count, PLANTS).max(-1)
            for short, name in names.items()
        }


def reach(survives: Callable[[np.ndarray], np.ndarray], count: int, far: float, halvings: int = HALVINGS) -> np.ndarray:
    """The factor between 1 and ``far`` up to which each design survives, by bisection of its logarithm, all at once."""
    inside, outside = np.zeros(count), np.full(count, np.log(far))
    inside = np.where(survives(np.exp(outside)), outside, inside)
    for _ in range(halvings):
        middle = 0.5 * (inside + outside)
        good = survives(np.exp(middle))
        inside, outside = np.where(good, middle, inside), np.where(good, outside, middle)
    return np.exp(inside)


class Reach(NamedTuple):
    """Factors up to which the certificate and the simulated loop go; arrays over designs."""

    certified: np.ndarray
    simulated: np.ndarray


def reaches(case: Case, plants: Plants) -> dict[str, Reach]:
    """How far disturbance and k_p can go: until no certificate exists, and until a plant leaves the residual set."""
    p, bounds, count = case.parameters, case.bounds, len(case.period)
    allowed = guarantee(p, bounds).e
    loops = Loops(count * PLANTS)

    def within(changed: Bounds, k_p: np.ndarray) -> np.ndarray:
        found = loops.worst(case._replace(bounds=changed), plants._replace(k_p=k_p))
        return (found["e"] <= allowed) & (found["ratio"] < 1.0)

    def gain(factor: np.ndarray) -> np.ndarray:
        return within(bounds, plants.k_p * factor[:, None])

    return {
        "disturbance": Reach(
            reach(lambda x: certified(p, scaled_bounds(bounds, x)), count, FURTHEST, FINE),
            reach(lambda x: within(scaled_bounds(bounds, x), plants.k_p), count, FAR),
        ),
        "k_p down": Reach(
            reach(lambda x: certified(p, bounds._replace(k_min=bounds.k_min * x)), count, 1.0 / FURTHEST, FINE),
            reach(gain, count, 1.0 / FAR),
        ),
        "k_p up": Reach(
            reach(lambda x: certified(p, bounds._replace(k_max=bounds.k_max * x)), count, FURTHEST, FINE),
            reach(gain, count, FAR),
        ),
    }


MEANINGS = {
    "disturbance": "common factor on k_d1 ... k_d5, alpha_d2, alpha_d3",
    "k_p down": "factor on k_min",
    "k_p up": "factor on k_max",
}


def quantiles(values: np.ndarray) -> str:
    """Smallest, median and largest."""
    return ", ".join(f"{value:.3g}" for value in np.quantile(values, (0.0, 0.5, 1.0)))


def median_ratio(pair: Reach) -> str:
    """Median of simulated over certified; a bound of it where it hangs on reaches that were cut."""
    ratio = pair.simulated / pair.certified
    cut_above, cut_below = pair.simulated >= 0.999 * FAR, pair.simulated <= 1.001 / FAR
    unknown = np.where(cut_above, np.inf, np.where(cut_below, 0.0, ratio))
    middle = np.median(ratio)
    if np.median(unknown) == middle:
        return f"{middle:.3g}"
    return f"at {'least' if np.median(unknown) > middle else 'most'} {middle:.3g}"


def draw(promised: Guarantee, found: dict[str, np.ndarray], reached: dict[str, Reach]) -> None:
    """Certified against simulated residuals, and reaches."""
    with rc_context(plotting.STYLE):
        figure = Figure(figsize=plotting.SLIDE, layout="constrained")
        left, right = figure.subplots(1, 2)
        left.loglog(promised.e, found["e"], ".", color=plotting.BLUE, markersize=4, label="a design, its worst plant")
        ends = np.array([promised.e.min(), promised.e.max()])
        left.loglog(ends, ends, color=plotting.RED, label="certified = simulated")
        left.loglog(ends, ends / 1000.0, color=plotting.GREY, linestyle="--", label="a thousandth")
        left.set(xlabel="certified bound of $|e|$ [m]", ylabel="largest simulated $|e|$ [m]")
        for (name, pair), colour in zip(reached.items(), (plotting.ORANGE, plotting.GREEN, plotting.RED), strict=True):
            right.loglog(*pair, ".", color=colour, markersize=5, label=name)
        right.loglog([1 / FAR, FAR], [1 / FAR, FAR], color=plotting.GREY, linewidth=1.0, label="certified = simulated")
        right.set(xlabel="certified up to this factor", ylabel="simulated up to this factor")
        for ax in (left, right):
            ax.legend(frameon=False)
        figure.suptitle(f"What Theorem 1 certifies, and what {PLANTS} plants of each design do")
        plotting.write(figure, DOCS / "figures" / "conservatism.png")


def main() -> None:
    began = time.perf_counter()
    rng = np.random.default_rng(1)
    case = random_cases(rng, DESIGNS)
    plants = plants_of(rng, case.bounds, case.period)
    promised = guarantee(case.parameters, case.bounds)
    found = Loops(DESIGNS * PLANTS).worst(case, plants)
    some = np.arange(REACHES)
    reached = reaches(taken(case, some), jax.tree.map(lambda part: part[some], plants))
    draw(promised, found, reached)
    sampled = found["ratio"] < 1.0
    exceeded = int(np.sum(sampled & ((found["e"] > promised.e) | (found["sigma"] > promised.sigma))))
    lines = [
        "# How conservative the theorem is",
        "",
        INTRODUCTION.format(ratio=int(sampled.sum()), exceeded=exceeded),
        "| number | smallest, median, largest over designs |",
        "|---|---|",
        f"| certified bound of abs(e) [m] | {quantiles(promised.e)} |",
        f"| largest simulated abs(e) [m] | {quantiles(found['e'])} |",
        f"| certified over simulated, abs(e) | {quantiles(promised.e / found['e'])} |",
        f"| certified over simulated, abs(sigma) | {quantiles(promised.sigma / found['sigma'])} |",
        "",
        REACHED,
        "| what grows | certified up to | simulated up to | simulated over certified, median |",
        "|---|---|---|---|",
    ]
    for name, pair in reached.items():
        row = (MEANINGS[name], quantiles(pair.certified), quantiles(pair.simulated), median_ratio(pair))
        lines.append(f"| {' | '.join(row)} |")
    lines += [AFTERWARDS.format(seconds=time.perf_counter() - began, machine=machine())]
    lines += ["", *PROVED_HEADING, "", stored_part("proved", DOCS / "conservatism.md"), ""]
    (DOCS / "conservatism.md").write_text("\n".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
