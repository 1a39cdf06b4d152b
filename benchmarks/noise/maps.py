"""The study of noise over T_s, the vehicle with and without the drift, and the gain from noise to command."""

from typing import NamedTuple

import numpy as np
import xarray as xr

import dssc_jax as dj
from benchmarks.noise.forms import ROOT
from dssc_jax.analyses.noise_spectrum.spectrum import noise_spectrum
from dssc_jax.statistics import clopper_pearson
from dssc_jax.statistics.paired import FailureDifference, compare_failures

PERIODS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05)
STUDY = dj.Study.load(ROOT / "studies" / "noise_robustness.toml")
VEHICLE = dj.Study.load(ROOT / "studies" / "uav_robustness.toml")
NOISES = {"logspace": [0.003, 0.3, 9]}
POSITION_ONLY = {"sensor.velocity_std": 0.0, "sweep": {"sensor.position_std": {"logspace": [0.0003, 0.03, 9]}}}
PANELS = {
    "velocity noise, implicit form": {
        "controller.discretisation": "implicit",
        "sensor.position_std": 0.0,
        "sweep": {"sensor.velocity_std": NOISES},
    },
    "velocity noise, conservative form": {
        "sensor.position_std": 0.0,
        "sweep": {"sensor.velocity_std": NOISES},
    },
    "only y measured: lead filter, tau_f = 0.1 s": {
        **POSITION_ONLY,
        "differentiator": {"kind": "lead_filter", "tau_f": 0.1},
    },
    "only y measured: Levant, L = 3 m/s^2": {
        **POSITION_ONLY,
        "differentiator": {"kind": "levant", "lipschitz": 3.0},
    },
}
"""Maps over T_s and noise; the last two with the conservative form."""
ATTITUDE = (0.01, 0.03, 0.1)  # rad/s, of the noise on the yaw rate


class Map(NamedTuple):
    """Share of draws that fail, shape (T_s, noise), over the noise's standard deviation."""

    unit: str
    noise: np.ndarray
    failures: np.ndarray


def noise_map(panel: str) -> Map:
    """The failure probability over T_s and noise."""
    shares, result = [], None
    for period in PERIODS:
        result = dj.run(STUDY.override({**PANELS[panel], "loop.sample_time": period}))
        shares.append([point["probability"] for point in result.summary()["points"]])
    assert result is not None
    ((name, values),) = result.study.axes.items()
    return Map(result.study.quantities[name].unit, np.asarray(values), np.asarray(shares))


class Vehicle(NamedTuple):
    """Failures of 512 uncertain vehicles by both forms and without noise, with exact intervals, and the paired test."""

    failures: dict[str, int]
    intervals: dict[str, list[float]]
    draws: int
    paired: FailureDifference


def vehicle() -> Vehicle:
    """The vehicle's study with both forms on the same draws, and without noise."""
    plain = VEHICLE.without_sweep()
    settings = {
        "implicit": {"controller.discretisation": "implicit"},
        "conservative": {"controller.discretisation": "conservative"},
        "without noise, implicit": {"controller.discretisation": "implicit", "sensor": {"kind": "ideal"}},
    }
    failed = {name: dj.run(plain.override(changes)).failed.values.ravel() for name, changes in settings.items()}
    counts = {name: int(each.sum()) for name, each in failed.items()}
    draws = plain.config.draws
    bounds = {name: clopper_pearson(count, draws).tolist() for name, count in counts.items()}
    return Vehicle(counts, bounds, draws, compare_failures(failed["implicit"], failed["conservative"]))


def attitude() -> dict[str, list[float]]:
    """Share of vehicles that fail over the noise of the yaw rate, by form."""
    study = VEHICLE.override({"draws": 256, "sweep": {"sensor.psi.velocity_std": {"values": list(ATTITUDE)}}})
    return {
        form: [
            point["probability"]
            for point in dj.run(study.override({"controller.discretisation": form})).summary()["points"]
        ]
        for form in ("implicit", "conservative")
    }


def spectra() -> dict[str, xr.Dataset]:
    """The gain from noise to command over frequency: constant and state-dependent functions."""
    changes = {"loop.duration": 200.0, "sweep": {}, "plant.k_p": 1.0, "plant.a_p": 1.0, "disturbance.value": 0.3}
    study = STUDY.override(changes)
    constant = {"kind": "constant", "k_o": 110.651, "tau_m": 4.0166, "tau_av": 0.002}
    loops = {"DSSC, conservative": study, "SSC": study.override({"controller.functions": constant})}
    return {name: noise_spectrum(dj.simulate(loop), after=60.0) for name, loop in loops.items()}
