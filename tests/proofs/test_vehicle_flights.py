"""Adversarial flights of proved vehicles stay within their bounds, and falsified certificates are rejected.

benchmarks/vehicle_proofs does the same in large numbers.
"""

import numpy as np
import pytest

import dssc_jax as dj
from benchmarks.vehicle_proofs.designs import Design, bounds_of
from benchmarks.vehicle_proofs.falsified import falsify, plain, verified
from benchmarks.vehicle_proofs.flights import Policy, fly
from benchmarks.vehicle_proofs.problems import study_of
from dssc_jax.models.uav.vehicle import alternating, ring
from dssc_jax.proofs.prove_vehicle import prove_vehicle
from dssc_jax.proofs.vehicle_coverage import vehicle_problem_of

FLIGHTS, SECONDS = 256, 10.0
pytest.importorskip("flint")

POINTS = ("mass", "thrust", "turn", "inertia")
CHANGES = {
    "plain": {"wind.speed": 8.0, "wind.vertical": 4.0},
    "all at once": {
        "wind.speed": 5.0,
        "wind.vertical": 2.5,
        "plant.vehicle.motor_lag": 0.03,
        "unmodelled": {"kind": "delay", "samples": 1.5},
        "plant.vehicle.mass": {"uniform": [10.8, 11.0]},
        "plant.vehicle.body_inertia": [{"uniform": [0.39, 0.41]}, {"uniform": [0.39, 0.41]}, 0.74],
        "plant.vehicle.rotor_angles": list(ring(6)),
        "plant.vehicle.spins": list(alternating(6)),
    },
}
REJECTED = {"channels exchanged": "V0", "a bound turned down": "V4"}
"""Changes that no slack covers, and the premise that fails."""


@pytest.fixture(scope="module", params=CHANGES)
def design(request) -> Design:
    """A proved loop."""
    proved = prove_vehicle(vehicle_problem_of(dj.Study.load("hover_wind_tuned").override(CHANGES[request.param])))
    assert proved.complete, proved.reason
    assert proved.verdict is not None
    return Design(plain(proved.certificate()), bounds_of(proved.verdict))


def test_the_study_that_flies_is_that_of_the_certificate(design):
    problem = design.certificate["problem"]
    again = plain(vehicle_problem_of(study_of(problem, SECONDS)).to_dict())
    for name, value in problem.items():
        if name in POINTS:
            assert np.all(np.array(again[name]) >= np.min(value) * (1.0 - 1e-12)), name
            assert np.all(np.array(again[name]) <= np.max(value) * (1.0 + 1e-12)), name
        else:
            assert again[name] == value, name


def test_no_flight_leaves_a_bound(design):
    flown = fly(design.certificate["problem"], design.bounds, FLIGHTS, SECONDS, 1)
    assert not flown.left().any()
    assert set(flown.columns["gust.policy"]) == {float(policy) for policy in Policy}
    # adversarial: a third of the way is more than winds at random reach, and a bound of half the size is left
    nearest = {name: share.max() for name, share in flown.shares.items()}
    assert min(nearest[name] for name in ("e_x", "e_y", "e_z", "sigma_x", "tilt", "speed", "alpha")) > 0.33
    lower = {**design.bounds, "tilt": 0.33 * design.bounds["tilt"]}
    assert fly(design.certificate["problem"], lower, FLIGHTS, SECONDS, 1).left().any()


@pytest.mark.parametrize("kind", REJECTED)
def test_a_falsified_certificate_is_rejected(design, kind):
    rng = np.random.default_rng(3)
    content = falsify(design.certificate, kind, rng)
    answer = verified((kind, content, design.certificate["problem"]))
    assert answer.bounds is None
    assert answer.reason.startswith(("V0", "V1", "V4", "V5") if kind == "channels exchanged" else REJECTED[kind])


def test_an_easier_problem_is_accepted_and_flies_within_its_bounds(design):
    content = plain(design.certificate)
    content["problem"]["wind"] = [0.9 * bound for bound in content["problem"]["wind"]]
    answer = verified(("wind", content, design.certificate["problem"]))
    assert answer.bounds is not None
    assert not fly(content["problem"], answer.bounds, FLIGHTS, SECONDS, 2).left().any()
