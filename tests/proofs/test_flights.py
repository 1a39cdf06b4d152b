"""Flights of what proofs cover stay within what is proved."""

import copy
import json

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.proofs.prove import prove
from dssc_jax.proofs.verifier.verdict import verify_certificate
from tests.proofs.cases import HIGHER, LOOP, NOMINAL, SINE, TRANSFER


@pytest.mark.parametrize(
    "changes",
    [
        {"unmodelled": {**TRANSFER, "mu": 0.004}},
        {"unmodelled": {"kind": "delay", "samples": 1.6, "memory": 3.0}},
        {"sensor": {"kind": "lag", "mu": 0.003}, "unmodelled.mu": 0.004},
        {"reference": SINE, **NOMINAL, "plant.initial": [0.1, 0.2]},
        {"unmodelled": {"kind": "none"}, **HIGHER, "plant.initial": [0.1, 0.0, 0.05, -0.05]},
    ],
    ids=lambda changes: " ".join(changes),
)
def test_flights_stay_within_what_is_proved(changes):
    """With transfer functions, delays, lagging sensors, moving references and zero dynamics."""
    study = LOOP.override({"loop.sample_time": 0.004, "plant.k_p": {"uniform": [0.98, 1.02]}, **changes})
    outcome = prove(study)
    assert outcome.complete, outcome.failures
    waves = {"draws": 64, "disturbance.phase": {"uniform": [0.0, 6.28]}, "disturbance.period": 6.0}
    early = {"metrics": {"after": 0.0, "names": ["error_max", "outside_sliding"]}}
    flown = dj.run(study.override({**waves, **early, "loop.duration": 20.0})).dataset
    settled = dj.run(study.override({**waves, "metrics": {"after": 25.0, "names": ["error_max"]}})).dataset
    print(f"\n{outcome.error:.3g} m, flown {float(settled['error_max'].max()):.3g} m")
    assert float(flown["error_max"].max()) <= outcome.largest_error
    assert np.all(flown["outside_sliding"].values == 0.0)
    assert float(settled["error_max"].max()) <= outcome.error


@pytest.mark.parametrize(
    ("form", "mu"), [("implicit", 0.1), ("implicit", 1.2), ("conservative", 0.1), ("conservative", 1.7)]
)
def test_case_2_is_proved_from_40_m(form, mu):
    """Its own gains, whose slope changes by a factor of five on the way."""
    study = dj.Study.load("studies/paper_case2.toml").override(
        {
            "controller.discretisation": form,
            "controller.predictor_start": "matched",
            "disturbance": {"kind": "none"},
            "reference": {"kind": "zero"},
            "unmodelled": {"kind": "lag", "order": 2, "mu": mu},
            "requirement": [],
            "metrics": {"after": 0.0, "names": ["error_max", "outside_sliding"]},
        }
    )
    outcome = prove(study, boxes=1)
    assert outcome.complete, outcome.failures
    assert outcome.error < 1e-12
    flown = dj.run(study).dataset
    assert 40.0 <= float(flown["error_max"].max()) <= outcome.largest_error < 200.0
    assert float(flown["outside_sliding"].max()) == 0.0
    if (form, mu) != ("implicit", 0.1):  # bounds of signals reach that far, since functions deviate less than gains
        stage = outcome.proofs[0].stages[0]
        assert (stage.method, stage.coordinate) == ("small gain", "phi_1")
        for name, value, premise in (("change", 0.9 * stage.bounds[0], "P4"), ("change", 20.0 * stage.change, "P7")):
            content = json.loads(json.dumps(outcome.certificate()))
            content["proofs"][0]["stages"][0][name] = value
            verdict = verify_certificate(content)
            assert verdict.reason.startswith(premise) or (form == "conservative" and verdict.proved)
        return
    first = json.loads(json.dumps(outcome.certificate()))
    assert first["proofs"][0]["stages"][0]["pieces"] > 1
    for pieces, premise in ((1, "P6"), (0, "P0"), (2.0, "P0")):
        content = copy.deepcopy(first)
        content["proofs"][0]["stages"][0]["pieces"] = pieces
        assert verify_certificate(content).reason.startswith(premise)


def test_a_channel_near_hover_is_that_of_the_vehicle():
    """x of the vehicle and of its model, from 0.1 m on, with the same controller."""
    conservative = {"controller.discretisation": "conservative", "controller.predictor_start": "matched"}
    calm = {"requirement": [], "loop.duration": 12.0, "metrics": {}}
    channel = dj.Study.load("studies/channel_x.toml").override(
        {**calm, "plant.k_p": 1.0, "plant.initial": [0.1, 0.0], "disturbance": {"kind": "none"}}
    )
    start = {"plant.position": [0.1, 0.0, 0.0], "plant.yaw": 0.0}
    hover = {"reference": {"kind": "hover"}, "wind": {"kind": "none"}, **start}
    vehicle = dj.Study.load("studies/paper_case1.toml").override({**calm, **conservative, **hover})
    x, model = dj.simulate(vehicle)["x_e"].values, dj.simulate(channel)["e"].values
    assert np.abs(x - model).max() < 0.01 * np.abs(model).max()
