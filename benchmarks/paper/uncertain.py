"""What an uncertain vehicle and noise do to Case 1's and Case 2's loops."""

from typing import Any

import dssc_jax as dj
from benchmarks.paper.loops import case_2, load
from dssc_jax.statistics import clopper_pearson


def robustness() -> tuple[dj.Result, str]:
    """The sweep over the rotors' lag, and the answer at the study's own laws."""
    study = load("uav_robustness")
    variants: list[dict[str, Any]] = [{}, {"controller.discretisation": "implicit"}, {"sensor": {"kind": "ideal"}}]
    failed = [dj.run(study.without_sweep().override(changes)).failed.values for changes in variants]
    ours, implicit, quiet = (int(each.sum()) for each in failed)
    low, high = clopper_pearson(ours, failed[0].size)
    answer = (
        f"{ours} of {failed[0].size} draws fail, probability {low:.3f} to {high:.3f} (95 %, Clopper-Pearson); "
        f"{implicit} with the implicit form, and {quiet} without sensor noise"
    )
    return dj.run(study), answer


def noise_offset() -> list[tuple[str, str, str, str]]:
    """The offset that velocity noise causes, over functions, form and sample time."""
    study = case_2("x").override({"draws": 64, "disturbance": {"kind": "none"}})
    required = {"requirement": [{"metric": "error_max", "after": 40.0, "max": 5.0}]}
    noisy = {"sensor": {"kind": "noisy", "velocity_std": 0.06}, **required}
    constant = {"kind": "constant", "k_o": 110.651, "tau_av": 0.03, "tau_m": 4.0166}
    conservative = {**noisy, "controller.discretisation": "conservative"}
    periods = (0.001, 0.005, 0.02)
    cases: list[tuple[str, str, float, dict[str, Any]]] = [
        ("square-root, no noise", "implicit", 0.005, required),
        *(("square-root", "implicit", period, noisy) for period in periods),
        *(("square-root", "conservative", period, conservative) for period in periods),
        ("constant, their values at sigma = 0", "implicit", 0.005, {**noisy, "controller.functions": constant}),
    ]
    rows = []
    for name, form, period, changes in cases:
        result = dj.run(study.override({**changes, "loop.sample_time": period})).dataset["error_max_after_40"]
        rows.append((name, form, f"{1e3 * period:g} ms", f"{float(result.median()):.2g} m"))
    return rows
