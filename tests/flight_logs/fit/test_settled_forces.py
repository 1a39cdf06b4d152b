"""Friction that holds a vehicle at rest is told as that, and is not withdrawn for what sticking leaves."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.flown_course import Flight
from dssc_jax.flight_logs.fit.missing_parts import FRICTION
from dssc_jax.flight_logs.fit.part_doubts import PartCauses, doubt_of
from dssc_jax.flight_logs.fit.part_fits import PartFit
from dssc_jax.flight_logs.fit.prediction import driving_forces
from dssc_jax.flight_logs.fit.refusals import Explained, Unexplained
from dssc_jax.flight_logs.fit.settled_forces import sticking, sticking_forces
from dssc_jax.statistics.correlated_noise import WHITE
from tests.flight_logs.closed_loop import Axis, Pid, fly, study_of

SLOW = Pid(k_p=2.1, k_i=0.7, k_d=1.6, filter=0.06)
SIZE = r"perhaps with sticking, .* or (\S+) ± (\S+) m/s\^2 as an acceleration"
STICKING = sticking(np.zeros(1))
RESULT = Explained(residual=0.4, noise=0.003, output=1.0, independent=10.0, limit=0.003, reading_noise=0.003)


def test_friction_that_holds_at_rest_is_the_opposite_of_smaller_forces():
    drive = np.array([0.1, -0.5, 0.3, 0.3])
    flight = Flight(np.zeros(4), np.array([0.0, 0.0, 1.0, -1.0]), 0.02)
    np.testing.assert_allclose(drive + sticking_forces(drive, flight, 0.2), [0.0, -0.3, 0.1, 0.5], atol=1e-12)


def test_a_flight_that_sticks_is_refused_with_its_friction():
    with pytest.raises(Unexplained, match="perhaps with sticking") as refusal:
        fit_log(study_of(SLOW), fly(axis=Axis(friction=0.26), gains=SLOW))
    found = re.search(SIZE, str(refusal.value))
    assert found is not None
    size, deviation = map(float, found.groups())
    assert abs(size - 0.26) < 3.0 * deviation
    assert "sticking leaves a residual of its own" in str(refusal.value)
    assert "another part may resemble" not in str(refusal.value)


@pytest.mark.parametrize(
    ("part", "residual", "is_withdrawn"),
    [
        (STICKING, 0.1, False),
        (STICKING, 0.3, True),
        (FRICTION, 0.1, False),
        (FRICTION, 0.3, True),
        (FRICTION._replace(leaves=""), 0.1, True),
    ],
)
def test_friction_with_sticking_keeps_its_estimate(part, residual, is_withdrawn):
    """It leaves more than noise, but far less than without it; a part that should leave noise is probably another."""
    best = PartFit(part, 0.1, 0.002, np.array([1.0]), 200.0, 1e-30, residual, WHITE)
    units = SimpleNamespace(output="m", command="m/s", of=lambda quantity: "m/s^2")
    loop = SimpleNamespace(channels=("",))
    study = SimpleNamespace(units=[units], loop=loop, numbers={}, table={"plant": {"kind": "motor"}})
    problem = SimpleNamespace(
        study=study,
        fitted=np.array([0]),
        names=["plant.a_p"],
        values=lambda x: x,
        named_values=lambda x: {"plant.a_p": float(x[0])},
        readings=[SimpleNamespace(channel=0)],
    )
    doubt = doubt_of(problem, SimpleNamespace(x=np.array([2.0])), np.array([0.1]), RESULT, PartCauses(best, [], True))
    assert doubt.code == "missing-force"
    assert ("the cause is probably another part" in doubt.text) == (not part.leaves)
    assert ("plant.a_p is about 1 in place of 2" in doubt.text) != is_withdrawn


def test_what_holds_a_vehicle_at_rest_is_command_and_wind_together():
    """Friction of 0.26 m/s^2, and a wind of nearly as much, that the study has with a law."""
    wind = {"kind": "constant", "value": {"normal": [0.0, 0.3]}}
    log = fly(axis=Axis(friction=0.26, wind=0.2), gains=SLOW)
    try:
        told = " ".join(doubt.text for doubt in fit_log(study_of(SLOW, disturbance=wind), log).doubts)
    except Unexplained as refusal:
        told = str(refusal)
    found = re.search(SIZE, told)
    assert found is not None, told
    size, deviation = map(float, found.groups())
    assert abs(size - 0.26) < 3.0 * deviation


def test_the_driving_force_is_that_of_actuator_and_disturbance():
    """A lag of 0.1 s at rest before a step of the command, by its exact solution, and a constant."""
    study = study_of(
        disturbance={"kind": "constant", "value": 0.3}, unmodelled={"kind": "lag", "mu": {"uniform": [0.05, 0.15]}}
    )
    commands = np.full((1, 50), 2.0)
    found = driving_forces(study, {"unmodelled.mu": 0.1}, commands)
    times = 0.02 * np.arange(1, 51)
    np.testing.assert_allclose(found, 2.0 * -np.expm1(-times / 0.1) + 0.3, rtol=1e-9)
