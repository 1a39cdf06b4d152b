"""Step metrics and envelopes against closed forms of a second-order loop, and an independent simulation by SciPy."""

import math

import numpy as np
import pytest
import tomli_w
from scipy import signal

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError

NATURAL, DAMPING, T_S, SIZE = 2.0, 0.4, 1e-3, 3.0
STEP = ["rise_time", "overshoot_percent", "settling_time_percent", "steady_state_error"]


def loop(damping=DAMPING, sample_time=T_S, duration=12.0, **changes):
    """With u = -k (e' + l_0 e) and y'' = -a y' + u, the loop from y_m to y is w^2/(s^2 + 2 d w s + w^2), k = d w."""
    gain = damping * NATURAL
    return dj.Study.from_table(
        {
            "name": "second-order",
            "loop": {"duration": duration, "sample_time": sample_time},
            "plant": {"kind": "normal_form", "k_p": 1.0, "a_p": gain, "initial": [-1.0, 0.0]},
            "controller": {"kind": "pi", "l0": NATURAL**2 / gain, "k_p": gain, "k_i": 0.0},
            "reference": {"kind": "step", "size": SIZE, "at": 1.0, "offset": -1.0},
            "metrics": {"after": 1.0, "names": STEP},
            **changes,
        }
    )


def independent(study):
    """Times and outputs of the sampled loop by SciPy's exact discretisation."""
    gain, l0 = study.template.controller[0].k_p, study.template.controller[0].l0
    a, b, *_ = signal.cont2discrete(tuple(map(np.array, ([[0, 1], [0, -gain]], [[0], [1]], [[1, 0]], [[0]]))), T_S)
    x, outputs = np.array([-1.0, 0.0]), []
    for k in range(study.loop.steps):
        outputs.append(x[0])
        r = -1.0 + (SIZE if k * T_S >= 1.0 - 1e-9 else 0.0)
        x = a @ x + b[:, 0] * -gain * (x[1] + l0 * (x[0] - r))
    return np.arange(study.loop.steps) * T_S, np.array(outputs)


def test_against_closed_forms():
    """The sampled loop differs from the continuous one by about T_s."""
    found = dj.simulate(loop()).attrs
    root = math.sqrt(1.0 - DAMPING**2)
    assert found["overshoot_percent"] == pytest.approx(100.0 * math.exp(-math.pi * DAMPING / root), rel=2e-3)
    times, unit = signal.step(([NATURAL**2], [1.0, 2.0 * DAMPING * NATURAL, NATURAL**2]), T=np.linspace(0, 10, 200_001))
    rise = times[np.argmax(unit >= 0.9)] - times[np.argmax(unit >= 0.1)]
    assert found["rise_time"] == pytest.approx(rise, rel=2e-3)
    settled = times[np.flatnonzero(np.abs(unit - 1.0) > 0.02)[-1] + 1]
    assert found["settling_time_percent"] == pytest.approx(settled, abs=3 * T_S)
    assert found["steady_state_error"] == pytest.approx(SIZE * 2.0 * DAMPING / NATURAL / 11.0, rel=2e-3)


def test_against_an_independent_simulation():
    study = loop()
    times, y = independent(study)
    p = (y[1000:] + 1.0) / SIZE
    found = dj.simulate(study).attrs
    assert found["overshoot_percent"] == pytest.approx(100.0 * (p.max() - 1.0), rel=1e-9)
    low, high = (np.interp(level, p[: p.argmax()], times[1000:][: p.argmax()]) for level in (0.1, 0.9))
    assert found["rise_time"] == pytest.approx(high - low, rel=1e-9)
    assert found["settling_time_percent"] == pytest.approx((np.flatnonzero(np.abs(p - 1) > 0.02)[-1] + 1) * T_S)


def test_a_narrower_band_settles_later():
    study = loop(requirement=[{"metric": "settling_time_percent", "settling_percent": 0.5, "max": 9.0}])
    found = dj.simulate(study).attrs
    assert found["settling_time_percent_after_1_within_0.5_percent"] > found["settling_time_percent"] > 0.0


def test_what_never_arrives_is_infinite():
    found = dj.simulate(loop(damping=8.0, duration=2.0)).attrs
    assert found["rise_time"] == found["settling_time_percent"] == math.inf
    assert found["overshoot_percent"] == 0.0


def test_without_a_step_there_is_no_step_response():
    study = loop(reference={"kind": "step", "size": 0.0, "offset": -1.0}, duration=2.0)
    found = dj.simulate(study).attrs
    assert all(math.isnan(found[name]) for name in STEP[:3])


def test_gradients_are_finite():
    """A step response's metrics as functions of the size of the step, through the whole loop."""
    import jax

    from dssc_jax.closed_loop.draw import simulate_draw
    from dssc_jax.engine.sampling import draw_key

    study = loop(sample_time=0.02, duration=6.0)

    def metrics(size):
        run = simulate_draw(study.loop, study.params({"reference.size": size}), draw_key(0, 0), study.measures)
        return run.metrics["rise_time"] + run.metrics["overshoot_percent"] + run.metrics["steady_state_error"]

    with jax.enable_x64(True):
        assert np.isfinite(jax.grad(metrics)(3.0))
        assert np.isfinite(
            jax.grad(
                lambda size: simulate_draw(
                    study.loop, study.params({"reference.size": size}), draw_key(0, 0), study.measures
                ).metrics["steady_state_error"]
            )(0.0)
        )


@pytest.mark.parametrize("period", [1.0, 4.0])
def test_following_a_sine(period):
    """Gain and lag of (d w s + w^2)/(s^2 + 2 d w s + w^2): the controller also takes y_m'."""
    study = loop(
        duration=40.0 + 10 * period,
        reference={"kind": "sine", "amplitude": 2.0, "period": period, "offset": 1.0},
        metrics={"after": 40.0, "names": ["following_gain", "following_lag"]},
    )
    gain = DAMPING * NATURAL
    _, response = signal.freqs([gain, NATURAL**2], [1.0, 2.0 * gain, NATURAL**2], [2.0 * np.pi / period])
    found = dj.simulate(study).attrs
    assert found["following_gain"] == pytest.approx(abs(response[0]), rel=5e-3)
    assert found["following_lag"] == pytest.approx(-np.angle(response[0]), abs=5e-3)


UPPER = [[0.0, -0.9], [1.0, -0.9], [1.0, 2.9], [4.0, 2.3], [12.0, 2.05]]
LOWER = [[3.0, 1.0], [12.0, 1.9]]


def test_an_envelope_is_a_requirement():
    study = loop(envelope=[{"upper": UPPER, "lower": LOWER}])
    times, y = independent(study)
    upper = np.where(times < 1.0 - 1e-9, -0.9, np.interp(times, *zip(*UPPER[2:], strict=True)))
    lower = np.where(times < 3.0 - 1e-9, -np.inf, np.interp(times, *zip(*LOWER, strict=True)))
    distance = min((upper - y).min(), (y - lower).min())
    found = dj.simulate(study).attrs
    assert found["envelope_y"] == pytest.approx(distance, rel=1e-9)
    assert found["slack_envelope_y_min"] == found["envelope_y"]
    tight = study.override({"envelope.0.upper": [[0.0, 2.0], [12.0, 2.0]]})
    result = dj.run(tight)
    assert result.summary()["points"][0]["failures"] == 1
    assert result.dataset["envelope_y"].attrs == {
        "units": "m",
        "long_name": "smallest distance of the output y from its envelope",
    }


def test_envelopes_of_a_vehicles_channel():
    study = (
        dj.Study.load("studies/uav_robustness.toml")
        .without_sweep()
        .override(
            {
                "envelope": [
                    {"signal": "e", "channel": "psi", "upper": [[0, 9], [9, 9]]},
                    {"signal": "u", "channel": "z", "lower": [[0, -9], [9, -9]]},
                ]
            }
        )
    )
    names = [requirement.text for requirement in study.requirements[-2:]]
    assert names == ["envelope_e_psi >= 0 rad", "envelope_u_z >= 0 m/s"]


@pytest.mark.parametrize(
    ("envelope", "complaint"),
    [
        ({}, "envelope.0: needs upper or lower"),
        ({"upper": [[0, 1]]}, r"upper: must be two or more points"),
        ({"upper": [[1, 1], [0, 1]]}, r"must have rising times, got 0 s after 1 s"),
        ({"upper": [[0, 1], [2, 1]], "lower": [[1, 1.5], [3, 1.5]]}, "which it does at 1 s"),
        ({"signal": "v", "upper": [[0, 1], [2, 1]]}, "'v' is none of y"),
        ({"channel": "x", "upper": [[0, 1], [2, 1]]}, "envelope.0.channel: must be one of the channels, none"),
    ],
)
def test_bad_envelopes_are_refused(envelope, complaint):
    with pytest.raises(ConfigError, match=complaint):
        loop(envelope=[envelope])


def test_a_step_after_the_start_of_the_window_is_no_value_and_told(capsys, tmp_path):
    """A value from the output at the window's start to a goal that moves later would be a wrong number."""
    table = {
        "name": "late",
        "draws": 4,
        "loop": {"duration": 4.0, "sample_time": 0.01},
        "plant": {"kind": "normal_form", "initial": [1e-3, 0.0]},
        "controller": {"kind": "pi", "l0": 2.0, "k_p": {"uniform": [3.0, 4.0]}, "k_i": 0.0},
        "reference": {"kind": "step", "size": 1.0, "at": 0.1},
        "requirement": [{"metric": "overshoot_percent", "max": 5.0}],
    }
    path = tmp_path / "late.toml"
    path.write_text(tomli_w.dumps(table))
    assert guarded(["run", str(path), "--out", str(tmp_path / "out")]) == 0
    told = "4 draws have no value, and violate overshoot_percent <= 5 %: the window must begin with a step"
    assert told in " ".join(capsys.readouterr().out.split())
    right = dj.Study.from_table(table | {"metrics": {"after": 0.1}})
    assert np.isfinite(dj.run(right, check=False).dataset["overshoot_percent"].values).all()
