"""What an uncertain vehicle and noise do to Case 1's and Case 2's loops."""

from typing import Any

import dssc_jax as dj
from benchmarks.paper.loops import case_2, load
from dssc_jax.statistics import clopper_pearson


def robustness() -> tuple[dj.Result, str]:
    """The sweep over the rotors' lag, and the answer at the study's own laws."""
    study = load("uav_robustness")
    plain = dj.run(study.without_sweep())
    failed = plain.failed.values
    low, high = clopper_pearson(int(failed.sum()), failed.size)
    quiet = dj.run(study.without_sweep().override({"sensor": {"kind": "ideal"}})).failed.values
    answer = (
        f"{failed.sum()} of {failed.size} draws fail, probability {low:.3f} to {high:.3f} (95 %, Clopper-Pearson); "
        f"without sensor noise {quiet.sum()}"
    )
    return dj.run(study), answer


def noise_offset() -> list[tuple[str, str, str]]:
    """The offset that velocity noise causes, over functions and sample time."""
    study = case_2("x").override({"draws": 64, "disturbance": {"kind": "none"}})
    required = {"requirement": [{"metric": "error_max", "after": 40.0, "max": 5.0}]}
    noisy = {"sensor": {"kind": "noisy", "velocity_std": 0.06}, **required}
    constant = {"kind": "constant", "k_o": 110.651, "tau_av": 0.03, "tau_m": 4.0166}
    cases: list[tuple[str, float, dict[str, Any]]] = [
        ("square-root, no noise", 0.005, required),
        *(("square-root", sample_time, noisy) for sample_time in (0.001, 0.005, 0.02)),
        ("constant, their values at sigma = 0", 0.005, {**noisy, "controller.functions": constant}),
    ]
    rows = []
    for name, sample_time, changes in cases:
        found = dj.run(study.override({**changes, "loop.sample_time": sample_time})).dataset["error_max_after_40"]
        rows.append((name, f"{1e3 * sample_time:g} ms", f"{float(found.median()):.2g} m"))
    return rows
