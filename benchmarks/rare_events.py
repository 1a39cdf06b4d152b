"""How much cheaper is `rare` than plain draws? Regenerates its lines in docs/statistics.md.

A DSSC loop with an uncertain plant, a lag of order 2 and a step disturbance fails with a probability of about 1e-4;
plain draws and splitting answer for the same study.
"""

import sys
import time

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
    plain_seconds = time.perf_counter() - began
    (point,) = plain.summary()["points"]
    began = time.perf_counter()
    found = dj.rare(study)
    seconds = time.perf_counter() - began
    low, high = found.estimate.interval()
    spent = found.estimate.simulations + found.estimate.plain.draws
    cheaper = found.estimate.plain_draws / spent
    same_precision = plain_seconds / DRAWS * found.estimate.plain_draws
    rows = [
        "| | plain draws | `rare` |",
        "|---|---|---|",
        f"| simulations, with the plain draws of `rare` | {DRAWS:,} | {spent:,} |",
        f"| failure probability | {point['probability']:.3g} | {found.estimate.probability:.3g} |",
        f"| 95 % interval | [{point['interval'][0]:.3g}, {point['interval'][1]:.3g}] | [{low:.3g}, {high:.3g}] |",
        f"| coefficient of variation | {point['failures'] ** -0.5:.3f} | {found.estimate.variation:.3f} |",
        f"| simulations for the precision of `rare` | {found.estimate.plain_draws:,.0f} | {spent:,} |",
        f"| seconds for it, compilation included | {same_precision:.1f} | {seconds:.1f} |",
        "",
        f"`rare` takes **{cheaper:.0f} times fewer** simulations for the same coefficient of variation.",
    ]
    print("\n".join(rows))
    put("rare", "\n".join(rows))
    agree = max(low, point["interval"][0]) <= min(high, point["interval"][1])
    return 0 if agree and cheaper >= 10.0 else 1


if __name__ == "__main__":
    sys.exit(main())
