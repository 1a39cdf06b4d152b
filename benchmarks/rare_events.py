"""How much cheaper is `rare` than plain draws? Regenerates its lines in docs/statistics.md.

A DSSC loop with an uncertain plant, a lag of order 2 and a step disturbance fails with a probability of about 1e-4;
plain draws, importance sampling and splitting answer for the same study.
"""

import sys
import time
from collections.abc import Sequence

from page import put

import dssc_jax as dj

DRAWS = 2_000_000
STUDY = {
    "name": "rare-failure",
    "seed": 7,
    "draws": DRAWS,
    "loop": {"duration": 20.0, "sample_time": 0.01},
    "plant": {
        "kind": "normal_form",
        "k_p": {"uniform": [0.8, 1.2]},
        "a_p": {"truncated_normal": [1.0, 0.1, 0.7, 1.3]},
    },
    "reference": {"kind": "sine", "amplitude": 1.0, "period": 10.0},
    "controller": {
        "kind": "dssc",
        "l0": 1.0,
        "rho": 2.0,
        "functions": {"kind": "approx_sta_2", "kappa1": 2.0, "kappa2": 2.0, "delta": 0.5, "tau_av": 0.05},
        "nominal": {"a": 1.0, "k": 1.0},
    },
    "unmodelled": {"kind": "lag", "order": 2, "mu": {"loguniform": [0.01, 0.1]}},
    "disturbance": {"kind": "step", "value": {"normal": [0.0, 0.3]}, "at": 5.0},
    "requirement": [{"metric": "error_rms", "after": 10.0, "max": 0.072}],
}


def main() -> int:
    study = dj.Study.from_table(STUDY)
    began = time.perf_counter()
    plain = dj.run(study)
    seconds = {"plain draws": time.perf_counter() - began}
    (point,) = plain.summary()["points"]
    found = {}
    for name, settings in (("importance sampling", {"splitting": None}), ("splitting", {"importance": None})):
        began = time.perf_counter()
        found[name] = dj.rare(study, **settings).answer
        seconds[name] = time.perf_counter() - began
    rows = [
        "| | simulations | failure probability | 95 % interval | coefficient of variation | seconds |",
        "|---|---|---|---|---|---|",
        row("plain draws", DRAWS, point["probability"], point["interval"], point["failures"] ** -0.5, seconds),
    ]
    cheaper = {}
    for name, answer in found.items():
        spent = answer.simulations + answer.plain.draws
        cheaper[name] = answer.plain_draws / spent
        rows.append(row(name, spent, answer.probability, answer.interval, answer.variation, seconds))
    design_points = found["importance sampling"].design_points
    first_order = sum(design_point.first_order for design_point in design_points)
    second_order = sum(design_point.second_order for design_point in design_points)
    rows += [
        "",
        f"FORM says {first_order:.3g}, SORM {second_order:.3g}. Plain draws with the same coefficients of variation "
        f"would be {cheaper['importance sampling']:,.0f} and {cheaper['splitting']:,.0f} times as many.",
    ]
    print("\n".join(rows))
    put("rare", "\n".join(rows))
    low, high = point["interval"]
    agree = all(max(low, answer.interval[0]) <= min(high, answer.interval[1]) for answer in found.values())
    return 0 if agree and min(cheaper.values()) >= 10.0 else 1


def row(
    name: str,
    simulations: int,
    probability: float,
    interval: Sequence[float],
    variation: float,
    seconds: dict[str, float],
) -> str:
    """A row of the table; simulations include the plain draws beside a method."""
    ends = f"[{interval[0]:.3g}, {interval[1]:.3g}]"
    return f"| {name} | {simulations:,} | {probability:.3g} | {ends} | {variation:.3f} | {seconds[name]:.1f} |"


if __name__ == "__main__":
    sys.exit(main())
