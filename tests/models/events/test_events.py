"""Events one by one: what each changes, against closed forms and NumPy; refusals by name."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.cli.warnings import warn_of_times
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.events import Condition, share_of
from dssc_jax.core.signals import Outcome
from dssc_jax.core.vectors import Quaternion, Vec3
from dssc_jax.design.certification import NotCovered
from dssc_jax.models.events import EVENTS
from dssc_jax.models.events.growing_delay import GROWING_DELAY, GrowingParams
from dssc_jax.models.events.payload import PAYLOAD, PayloadParams
from dssc_jax.models.events.rotor import ROTOR, RotorParams
from dssc_jax.models.uav.ground import Ground, contact, lift_factor, prepared_ground
from dssc_jax.models.uav.rigid_body import BodyState, body_derivative, loaded_derivative
from dssc_jax.proofs.coverage import problem_of

BASE = {
    "name": "events",
    "draws": 1,
    "loop": {"duration": 8.0, "sample_time": 0.01},
    "plant": {"kind": "uav", "vehicle": "m600"},
    "controller": {"kind": "pi", "l0": 1.0, "k_p": 1.0, "k_i": 1.0},
    "reference": {"kind": "hover"},
}


def test_the_share_is_the_mean_over_the_sample():
    """A step within the sample, an end, and a ramp, against fine sums."""
    for until, at, t in (
        (None, 1.003, 1.0),
        (2.006, 1.0, 2.0),
        (None, 0.0, 0.0),
        (None, 5.0, 1.0),
        (1.007, 1.002, 1.0),
    ):
        params = RotorParams(at, 1.0, 0.0, until)
        fine = t + 0.01 * (np.arange(10_000) + 0.5) / 10_000
        expected = ((fine >= at) & (fine < (until or np.inf))).mean()
        assert float(share_of(params, t, 0.01)) == pytest.approx(expected, abs=1e-4)
    ramp = EVENTS["voltage_sag"].members[None].params(at=1.0, voltage=0.5, rise=0.5)
    assert float(share_of(ramp, 1.2, 0.1)) == pytest.approx(0.5)


def test_a_rotor_drawn_by_a_law_and_one_given_agree():
    for rotor in (1.0, jnp.asarray(3.0)):
        found = ROTOR.change(RotorParams(0.0, rotor, 0.3), Condition(), 1.0, 4).effectiveness
        expected = [0.3 if i == int(rotor) else 1.0 for i in (1, 2, 3, 4)]
        np.testing.assert_allclose([float(value) for value in found], expected)
    both = ROTOR.change(RotorParams(0.0, 2.0, 0.5), Condition((1.0, 0.5, 1.0, 1.0)), 0.5, 4)
    assert float(both.effectiveness[1]) == 0.375


@pytest.mark.parametrize("masses", [(1.5,), (-1.0,), (1.5, -0.7)])
def test_a_load_moves_as_newton_and_euler_say(masses):
    """Against the 6 x 6 mass matrix about the point of the state, for masses at places of their own."""
    rng = np.random.default_rng(7)
    for _ in range(5):
        inertia, om, v = np.array([0.5, 0.6, 0.8]), rng.normal(size=3), rng.normal(size=3)
        force, torque, q = rng.normal(size=3) * 20, rng.normal(size=3), rng.normal(size=4)
        attitude = Quaternion(*(q / np.linalg.norm(q)))
        rotation = attitude.matrix()
        condition, total, first, about = Condition(), 10.0, np.zeros(3), np.diag(inertia)
        for mass in masses:
            r = rng.uniform(-0.3, 0.3, 3)
            condition = PAYLOAD.change(PayloadParams(0.0, mass, tuple(r)), condition, 1.0, 4)
            total, first = total + mass, first + mass * r
            about = about + mass * (r @ r * np.eye(3) - np.outer(r, r))

        def skew(a):
            return np.cross(np.eye(3), a)

        weight = np.array([list(row) for row in rotation]).T @ np.array([0.0, 0.0, -9.81])
        matrix = np.block([[total * np.eye(3), -skew(first)], [skew(first), about]])
        right = [force + total * weight - np.cross(om, np.cross(om, first)), torque + np.cross(first, weight)]
        right[1] = right[1] - np.cross(om, about @ om)
        a, alpha = np.split(np.linalg.solve(matrix, np.concatenate(right)), 2)
        state = BodyState(Vec3(0.0, 0.0, 0.0), Vec3(*v), attitude, Vec3(*om))
        numbers = (10.0, Vec3(*inertia), condition.load, Vec3(*force), Vec3(*torque), rotation)
        found = loaded_derivative(state, *numbers)
        np.testing.assert_allclose(found.rate, alpha, rtol=1e-11)
        np.testing.assert_allclose(found.velocity, np.array([list(row) for row in rotation]) @ a, rtol=1e-11)
    none = PAYLOAD.change(PayloadParams(0.0, 2.0, (0.1, 0.0, 0.0)), Condition(), 0.0, 4).load
    plain = body_derivative(state, 10.0, Vec3(*inertia), 0.0, rotation @ Vec3(*force), Vec3(*torque), rotation)
    same = loaded_derivative(state, 10.0, Vec3(*inertia), none, *numbers[3:])
    for x, y in zip(jax.tree.leaves(plain), jax.tree.leaves(same), strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-12)


def test_a_growing_delay_shows_the_command_of_an_earlier_time():
    params = GrowingParams(0.5, 0.1, 20.0)
    state = GROWING_DELAY.model.init(params)
    for k in range(200):
        state = GROWING_DELAY.model.sample(params, state, 0.01 * k, jax.random.key(0), 0.01)
        expected = max(0.0, 0.01 * k - max(0.0, 0.1 * (0.01 * k - 0.5)))
        assert float(GROWING_DELAY.model.output(params, state, 0.0)) == pytest.approx(expected, abs=1e-6)


def test_sag_shear_and_outage_in_flight():
    """Commanded thrust rises by 1/voltage^2; wind is gradient times height; the frozen sensor shows one reading."""
    events = [
        {"kind": "voltage_sag", "at": 1.0, "voltage": 0.9, "rise": 0.5},
        {"kind": "wind_shear", "at": 0.5, "gradient": [0.2, 0.0, 0.0], "height": -10.0},
        {"kind": "sensor_outage", "at": 5.0, "duration": 0.3, "channel": "y"},
        {"kind": "rotor", "rotor": 1, "at": 3.0, "until": 3.1, "effectiveness": 0.9},
    ]
    run = dj.simulate(dj.Study.from_table(BASE | {"event": events, "loop": {"duration": 10.0, "sample_time": 0.01}}))
    last = [float(run[f"rotor_{i}"].values[-1]) for i in range(1, 7)]
    assert sum(last) * 0.81 == pytest.approx(10.0 * 9.81, rel=0.01)
    np.testing.assert_allclose(run["wind_x"].values[60:], 0.2 * (run["z_y"].values[60:] + 10.0), atol=1e-12)
    frozen = run["y_y_measured"].values[500:530]
    assert np.all(frozen == run["y_y_measured"].values[499])
    assert run["y_y_measured"].values[530] == run["y_y"].values[530]
    assert list(run.attrs["event_times"]) == [1.0, 0.5, 5.0, 3.0]
    figure = dj.plot.trajectory(run)
    marks = [text.get_text() for ax in figure.axes for text in ax.texts]
    assert "sensor outage" in marks


def refused(**changes):
    with pytest.raises(ConfigError) as refusal:
        dj.Study.from_table(BASE | changes)
    return str(refusal.value)


def test_what_cannot_happen_is_refused():
    assert "rotor: must be <= 6" in refused(event=[{"rotor": 7, "at": 1.0}])
    assert "whole number" in refused(event=[{"rotor": 1.5, "at": 1.0}])
    assert "must leave some" in refused(event=[{"kind": "payload", "mass": -10.0, "at": 1.0}])
    twice = [{"kind": "payload", "mass": -6.0, "at": at} for at in (1.0, 2.0)]
    assert "event.1.mass: must leave some of the vehicle's mass, got -6 kg and -2 kg of all" in refused(event=twice)
    assert "unknown kind 'meteor'" in refused(event=[{"kind": "meteor", "at": 1.0}])
    assert "channel" in refused(event=[{"kind": "sensor_outage", "at": 1.0, "duration": 1.0, "channel": "w"}])
    plant = {"kind": "normal_form", "k_p": 1.0, "a_p": 1.0}
    one = {"plant": plant, "reference": {"kind": "zero"}}
    assert "happens to a vehicle" in refused(event=[{"rotor": 1, "at": 1.0}], **one)


def test_analyses_that_do_not_cover_events_refuse_them():
    study = dj.Study.from_table(BASE | {"event": [{"rotor": 1, "at": 1.0}]})
    with pytest.raises(NotCovered, match="event"):
        problem_of(study)
    with pytest.raises(ConfigError, match="linearisation does not cover"):
        dj.loop_margins(study)
    ground = dj.Study.from_table(BASE | {"plant": BASE["plant"] | {"ground": {}}})
    with pytest.raises(NotCovered):
        problem_of(ground)


def test_feet_carry_the_weight_and_the_ground_lifts():
    """Four feet sunk in by 1 cm carry M g; thrust near the ground is Cheeseman's and Bennett's."""
    ground = prepared_ground(Ground(rotor_radius=0.25), 10.0)
    upright = Quaternion(1.0, 0.0, 0.0, 0.0).matrix()
    still = Vec3(0.0, 0.0, 0.0)
    found = contact(ground, Vec3(0.0, 0.0, 0.19), still, upright, still)
    assert float(found.force.z) == pytest.approx(98.1)
    assert max(abs(float(value)) for value in found.torque) < 1e-12
    sliding = contact(ground, Vec3(0.0, 0.0, 0.19), Vec3(5.0, 0.0, 0.0), upright, still)
    assert float(sliding.force.x) == pytest.approx(-0.6 * 98.1, rel=1e-3)
    assert float(contact(ground, Vec3(0.0, 0.0, 0.21), still, upright, still).force.z) == 0.0
    for height in (0.25, 0.5, 2.0):
        assert float(lift_factor(ground, height)) == pytest.approx(1.0 / (1.0 - (0.25 / (4.0 * height)) ** 2))
    assert float(lift_factor(ground, 0.0)) == pytest.approx(1.0 / (1.0 - 0.25))


def test_take_off_landing_and_a_flight_into_the_ground():
    """The voltage of some draws fails in flight: they hit the ground, which is an outcome; the others land."""
    flight = {"kind": "record", "time": [0.0, 1.0, 5.0, 8.0, 14.0], "value": [0.2, 0.2, 4.0, 4.0, 0.0]}
    table = BASE | {
        "draws": 8,
        "loop": {"duration": 17.0, "sample_time": 0.01},
        "plant": BASE["plant"] | {"ground": {"rotor_radius": 0.27}, "position": [0.0, 0.0, 0.2]},
        "reference": {"kind": "hover", "z": flight},
        "event": [{"kind": "voltage_sag", "at": {"choice": [7.0, 100.0]}, "voltage": 0.2}],
        "requirement": [{"metric": "tilt_max", "max": 1.0}],
    }
    study = dj.Study.from_table(table)
    result = dj.run(study).dataset
    falls = result["event.0.at"].values < 50.0
    assert 0 < falls.sum() < 8
    assert set(result["outcome"].values[falls]) == {Outcome.INTO_GROUND}
    assert set(result["outcome"].values[~falls]) == {Outcome.OK}
    drop = 7.0 + np.sqrt(2.0 * 3.8 / (9.81 * (1.0 - 0.04)))
    assert np.all(np.abs(result["failed_at"].values[falls] - drop) < 0.1)
    run = dj.simulate(study, draw=int(np.flatnonzero(~falls)[0]))
    z = run["z_y"].values
    assert z[:90].min() > 0.19
    assert z[:90].max() < 0.4  # the effect of the ground lifts it a little
    assert z[750] == pytest.approx(4.0, abs=0.4)  # the integral overshoots
    assert 0.17 < z[-1] < 0.2  # on its feet
    assert abs(run["z_y_dot"].values[-1]) < 0.02


def test_the_rate_at_the_touch_decides_and_not_that_at_a_sample():
    """The feet brake the vehicle within a sample; a free fall from z_0 touches with (2 g (z_0 - 0.2))^(1/2)."""
    table = BASE | {
        "draws": 64,
        "loop": {"duration": 1.0, "sample_time": 0.01, "substeps": 8},
        "plant": BASE["plant"]
        | {
            "ground": {"gear_height": 0.2, "fastest_landing": 3.0},
            "vehicle": {"kind": "m600", "motor_lag": 0.005},
            "position": [0.0, 0.0, {"uniform": [0.4, 1.4]}],
        },
        "event": [{"kind": "voltage_sag", "at": 0.0, "voltage": 1e-6}],
        "requirement": [{"metric": "tilt_max", "max": 1.0}],
    }
    result = dj.run(dj.Study.from_table(table), check=False).dataset
    height = result["plant.position.2"].values
    touch = np.sqrt(2.0 * 9.81 * (height - 0.2))
    clear = np.abs(touch - 3.0) > 0.05  # the rotors take 5 ms to stop
    assert 0 < np.count_nonzero(touch > 3.0) < 64
    assert np.count_nonzero(clear) > 56
    crashed = result["outcome"].values == Outcome.INTO_GROUND
    np.testing.assert_array_equal(crashed[clear], (touch > 3.0)[clear])


def test_a_simulated_draw_names_its_events(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    settings = ["--set", "loop.duration=8.0", "--set", "draws=4"]
    assert guarded(["simulate", "rotor_loss", "--draw", "1", "--csv", "draw.csv", *settings]) == 0
    assert "event: rotor" in capsys.readouterr().out


def test_a_growing_delay_acts_before_the_actuators():
    """At its longest it is a delay of as many samples, which commutes with the lag and the limit of the rate."""
    slow = [{"kind": "lag", "mu": 0.05}, {"kind": "rate_limit", "rate": 2.0}]
    windy = BASE | {"wind": {"kind": "constant", "x": 5.0, "y": 2.0, "z": 0.0}}
    growing = [{"kind": "growing_delay", "at": 0.0, "rate": 100.0, "memory": 3.0}]
    study = dj.Study.from_table(windy | {"actuator": slow, "event": growing})
    found = dj.simulate(study)
    expected = dj.simulate(dj.Study.from_table(windy | {"actuator": [{"kind": "delay", "samples": 3.0}, *slow]}))
    assert np.abs(expected["x_y"].values).max() > 0.04
    np.testing.assert_allclose(found["x_y"].values, expected["x_y"].values, atol=1e-12)
    paths = {name: study.numbers[name].paths[0] for name in ("event.0.rate", "actuator.0.mu", "actuator.1.rate")}
    assert paths == {
        "event.0.rate": "unmodelled.0.0.rate",
        "actuator.0.mu": "unmodelled.0.1.mu",
        "actuator.1.rate": "unmodelled.0.2.rate",
    }


def test_an_event_ends_after_it_begins(capsys):
    """One that ended before it began never happened, without a word."""
    event = {"kind": "rotor", "rotor": 1, "effectiveness": 0.5}
    refusal = r"event.0.until: must be > event.0.at = 1.0, or the event never happens; got 0.5"
    with pytest.raises(ConfigError, match=refusal):
        dj.Study.from_table(BASE | {"event": [event | {"at": 1.0, "until": 0.5}]})
    times = {"at": {"uniform": [0.2, 1.5]}, "until": {"uniform": [1.0, 2.0]}}
    warn_of_times(dj.Study.from_table(BASE | {"event": [event | times]}))
    assert "event.0.until may be before event.0.at" in capsys.readouterr().err
    times = {"at": {"uniform": [0.2, 0.9]}, "until": {"uniform": [1.0, 2.0]}}
    warn_of_times(dj.Study.from_table(BASE | {"event": [event | times]}))
    assert not capsys.readouterr().err
