"""Proofs of the whole vehicle: what they cover, what they find, what the verifier refuses, and the command."""

import copy
import json
import math
from collections.abc import Callable

import pytest

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.core.json_types import JsonObject
from dssc_jax.design.certification import NotCovered
from dssc_jax.proofs.prove_vehicle import VehicleProved
from dssc_jax.proofs.vehicle_coverage import vehicle_problem_of
from dssc_jax.proofs.vehicle_words import digits_above, digits_below

pytest.importorskip("flint")

TUNED = "studies/hover_wind_tuned.toml"
EVERYTHING = {
    "wind.speed": 5.0,
    "wind.vertical": 2.5,
    "plant.vehicle.motor_lag": 0.05,
    "unmodelled": {"kind": "delay", "samples": 4.0},
    "plant.vehicle.mass": {"uniform": [10.682, 11.118]},
    "plant.vehicle.body_inertia": [{"uniform": [0.38, 0.42]}, {"uniform": [0.38, 0.42]}, {"uniform": [0.703, 0.757]}],
}
"""A lag of 50 ms, a delay of 20 ms, 2 % of the mass and 5 % of the inertia at once."""


@pytest.fixture(scope="module")
def tuned() -> VehicleProved:
    """The proof of the tuned study."""
    proved = dj.prove(dj.Study.load(TUNED))
    assert isinstance(proved, VehicleProved)
    return proved


def vehicle(changes: dict[str, object]) -> VehicleProved:
    """The proof of the tuned study with other numbers."""
    proved = dj.prove(dj.Study.load(TUNED).override(changes))
    assert isinstance(proved, VehicleProved)
    return proved


def test_tuned_gains_hold_any_wind_of_8_metres_a_second(tuned: VehicleProved) -> None:
    """The bounds in the statement are those of the certificate, and small."""
    assert tuned.complete
    summary = tuned.summary()
    assert summary["bounds"]["x"]["e"] < 0.25
    assert summary["bounds"]["y"] == summary["bounds"]["x"]
    assert summary["settled"]["x"]["e"] <= summary["bounds"]["x"]["e"]
    assert math.degrees(summary["bounds"]["tilt"]) < 3.0
    assert f"{digits_above(summary['bounds']['x']['e'])} m" in tuned.statement()
    assert 0.0 < summary["bounds"]["rotor_min"] < summary["bounds"]["rotor_max"] < tuned.problem.rotor_limit


def test_bounds_are_rounded_away_from_the_signal() -> None:
    """Upwards, or downwards; never to the nearer side."""
    assert digits_above(0.240641) == "0.2407"
    assert digits_above(0.2407) == "0.2407"
    assert digits_below(26.1189) == "26.11"
    assert digits_above(9.99951) == "10"


@pytest.mark.parametrize("kind", ["m600_quadrotor", "m600_hexacopter"])
def test_everything_uncertain_at_once(kind: str) -> None:
    """Lag, delay, mass and inertia at once leave at most 0.2 m."""
    proved = vehicle({"plant.vehicle.kind": kind} | EVERYTHING)
    assert proved.complete, proved.reason
    assert proved.largest_error < 0.2
    assert "a rotor lag of 0.05 s" in proved.statement()
    assert "a delay of 0.02 s" in proved.statement()


def test_a_lag_far_below_a_sample_costs_hardly_anything() -> None:
    """Its kernels are sharp, so that the integrals of a sample need more pieces."""
    without, lagging = (vehicle({"wind.speed": 5.0, "plant.vehicle.motor_lag": lag}) for lag in (None, 0.002))
    assert lagging.complete, lagging.reason
    assert lagging.largest_error < 1.02 * without.largest_error


def test_case_1_within_its_published_gains() -> None:
    """Case 1's gains hold 3 m/s, more wind costs more, and too much is refused for a reason."""
    study = dj.Study.load("studies/hover_wind.toml")
    errors = [dj.prove(study.override({"wind.speed": w, "wind.vertical": w / 2})).largest_error for w in (3.0, 5.0)]
    assert errors[0] < errors[1] < 1.6
    beyond = dj.prove(study.override({"wind.speed": 14.0, "wind.vertical": 7.0}))
    assert not beyond.complete
    assert math.isinf(beyond.error)
    assert beyond.statement().startswith("Nothing is proved: ")
    assert beyond.certificate()["proof"] is None


def test_starts_away_from_the_hovering_point() -> None:
    """A start raises the bounds from the start on, and not those of the settled vehicle."""
    changes = {"wind.speed": 3.0, "wind.vertical": 1.5}
    proved = vehicle({"plant.position": [0.3, 0.0, 0.1], **changes})
    rests = vehicle(changes)
    assert proved.complete, proved.reason
    assert 0.36 > proved.largest_error > 0.3 > proved.error
    assert proved.error == pytest.approx(rests.error, rel=0.01)
    summary = proved.summary()
    envelope = summary["envelope"]["x"]["e"]
    assert max(envelope) == proved.largest_error
    assert envelope[0] > 2.0 * envelope[-1] > rests.error
    assert summary["cell"] == pytest.approx(0.2)


def test_a_yaw_beyond_half_a_turn_starts_the_shorter_way_round() -> None:
    """3.1 rad is 0.083 rad from -3.1 rad; a sum of winds keeps the sum of their bounds."""
    winds = [{"kind": "bounded", "speed": 2.0}, {"kind": "constant", "x": 1.0, "y": 0.0, "z": 0.0}]
    study = dj.Study.load(TUNED).override({"wind": winds, "plant.yaw": 3.1, "reference.yaw": -3.1})
    problem = vehicle_problem_of(study)
    assert problem.wind == (3.0, 1.0)
    assert problem.channels["psi"].initial == (pytest.approx(2.0 * math.pi - 6.2), 0.0)


REFUSALS: list[tuple[dict[str, object], str]] = [
    ({"reference.kind": "steps"}, "takes reference.kind = 'hover' or 'mission'"),
    ({"reference.kind": "mission", "plant.vehicle.motor_lag": 0.02}, "the rotors have a lag, and the reference moves"),
    ({"wind": {"kind": "dryden", "speed": 5.0, "altitude": 10.0, "airspeed": 5.0}}, "the wind has no known bound"),
    ({"plant.inner_loop.thrust": "norm"}, "thrust is not 'projection'"),
    ({"plant.inner_loop.attitude": "rate_feed_forward"}, "attitude is not 'plain'"),
    ({"plant.inner_loop.kp_velocity": 0.1}, "kp_velocity is not 0"),
    ({"plant.vehicle.arm": {"uniform": [0.5, 0.6]}}, "plant.vehicle.arm is uncertain"),
    ({"plant.position": [{"normal": [0.0, 0.1]}, 0.0, 0.0]}, "has no bounds"),
    ({"plant.vehicle.structure_drag": [0.03, 0.02, 0.015]}, "differs between body x and y"),
    ({"plant.vehicle.spins": [1.0, 1.0, -1.0, -1.0], "plant.vehicle.rotor_angles": [0.0, 3.2, 1.6, 4.7]}, "spins"),
    ({"controller.discretisation": "implicit"}, "conservative form"),
    ({"controller.y.l0": 0.7}, "the controllers of x and y differ"),
    ({"unmodelled": {"kind": "lag", "mu": 0.01}}, "no single delay"),
    ({"unmodelled": {"kind": "delay", "samples": {"uniform": [1.0, 2.0]}}}, "unmodelled.samples is uncertain"),
    ({"sensor": {"kind": "lag", "mu": 0.01}}, "a sensor is not ideal"),
    ({"plant.pitch": 0.1}, "starts level"),
    ({"plant.body_rate": [0.0, 0.0, 0.1]}, "starts level"),
    ({"plant.roll": {"uniform": [0.0, 0.1]}}, "plant.roll is uncertain"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "reason"), REFUSALS)
def test_what_a_proof_does_not_cover_is_named(changes: dict[str, object], reason: str) -> None:
    """A part outside of the theorem is refused by name."""
    with pytest.raises(NotCovered, match=reason):
        vehicle_problem_of(dj.Study.load(TUNED).override(changes))


def larger(*path: str, by: float = 1.02) -> Callable[[JsonObject], None]:
    """Multiply one number of a certificate."""

    def change(content: JsonObject) -> None:
        *parents, last = path
        for name in parents:
            content = content[name]
        value = content[last]
        content[last] = [by * number for number in value] if isinstance(value, list) else by * value

    return change


def exchanged(content: JsonObject) -> None:
    """Exchange two bounds."""
    bounds = content["proof"]["channels"]["x"]["bounds"]
    bounds["e"], bounds["e_dot"] = bounds["e_dot"], bounds["e"]


FALSE: list[tuple[Callable[[JsonObject], None], str]] = [
    (larger("problem", "wind"), "V4"),
    (larger("problem", "structure_drag"), "V4"),
    (larger("problem", "mass", by=0.98), "V4"),
    (larger("problem", "rotor_lag", by=1.0) , ""),
    (larger("problem", "rotor_limit", by=0.4), "V3"),
    (larger("problem", "channels", "x", "rho", by=0.05), "V5"),
    (larger("problem", "channels", "x", "l0", by=-1.0), "V0"),
    (larger("proof", "channels", "x", "bounds", "e", by=0.99), "V4"),
    (larger("proof", "channels", "psi", "bounds", "sigma", by=0.9), "V4"),
    (larger("proof", "channels", "x", "rate", by=100.0), "V1"),
    (larger("proof", "channels", "z", "slopes", by=-1.0), "V"),
    (exchanged, "V4"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "premise"), FALSE)
def test_a_falsified_certificate_is_rejected(
    tuned: VehicleProved, change: Callable[[JsonObject], None], premise: str
) -> None:
    """The first premise that fails is named; an unchanged certificate is accepted."""
    content = copy.deepcopy(json.loads(json.dumps(tuned.certificate())))
    change(content)
    verdict = dj.check_certificate(content)
    assert verdict.proved == (not premise)
    assert verdict.reason.startswith(premise)


def test_the_command_proves_and_verifies(tmp_path, capsys: pytest.CaptureFixture[str]) -> None:
    """`prove STUDY` writes a certificate that `prove FILE` accepts, with the same bounds; a changed one is refused."""
    file = tmp_path / "proof.json"
    assert guarded(["prove", TUNED, "--out", str(file), "--json"]) == 0
    proved = json.loads(capsys.readouterr().out)
    assert proved["integration"]["change"] < 1e-6
    assert guarded(["prove", str(file), "--json"]) == 0
    verified = json.loads(capsys.readouterr().out)
    assert verified["bounds"] == proved["bounds"]
    assert verified["settled"] == proved["settled"]
    assert set(proved["bounds"]) == {"x", "y", "z", "psi", "tilt", "rotor_min", "rotor_max"}
    assert guarded(["prove", str(file)]) == 0
    words = capsys.readouterr().out
    assert "valid: never exceeded are |e_x| and |e_y|" in words
    assert "any with |w_h| <= 8.0 m/s" in words
    content = json.loads(file.read_text())
    content["problem"]["wind"][0] = 9.0
    file.write_text(json.dumps(content))
    assert guarded(["prove", str(file)]) == 1
    assert "not valid: V4" in capsys.readouterr().out


def test_the_fastest_wind_that_is_proved() -> None:
    """A walk over the wind ends between a proved and a refused value."""
    study = dj.Study.load(TUNED).override({"wind.vertical": 0.0})
    reach = dj.proved_up_to(study, "wind.speed", (8.0, 24.0))
    assert reach.proved is not None
    assert reach.refused is not None
    assert 10.0 < reach.proved < reach.refused < 24.0
    assert reach.summary()["error"] == reach.last.error
