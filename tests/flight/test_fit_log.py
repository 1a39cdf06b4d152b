"""Laws from a logged flight: independent estimates, coverage, and flights that do not tell."""

import tomllib

import numpy as np
import pytest
from scipy import optimize, signal, stats

import dssc_jax as dj
from benchmarks.flight_fit import covered, flight_study
from dssc_jax.analyses.flight_fit import NotIdentifiable, fit_log
from dssc_jax.cli import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.flight.replay import curves_of_draws
from dssc_jax.statistics.autoregression import ar_coefficients, whitened
from dssc_jax.study.flight_logs import Column, FlightLog
from tests.cli.conftest import last_json

DT = 0.02


def linear(**changes):
    """A study of x'' = -a_p x' + k_p (u + d) with two laws."""
    table = {
        "name": "fitted",
        "seed": 3,
        "loop": {"duration": 8.0, "sample_time": DT},
        "plant": {
            "kind": "normal_form",
            "k_p": {"uniform": [0.5, 1.5]},
            "a_p": {"normal": [1.0, 0.2]},
            "initial": [0.5, 0.0],
        },
        "reference": {"kind": "sine", "amplitude": 0.5, "period": 2.0},
        "controller": {"kind": "pi", "k_p": 2.0, "k_i": 0.5, "l0": 1.0},
    }
    return dj.Study.from_table({**table, **changes})


def log_of(y, u=None):
    """A log of outputs, and of commands if they are given."""
    time = DT * np.arange(len(y))
    columns = {"y": Column(time, np.asarray(y, float))} | (
        {} if u is None else {"u_total": Column(time, np.asarray(u, float))}
    )
    return FlightLog("flight", columns, 0.0)


def output(k_p, a_p, u, begin=(0.5, 0.0)):
    """The plant's output by SciPy: exact for a command that is held between samples."""
    system = signal.StateSpace([[0.0, 1.0], [0.0, -a_p]], [[0.0], [k_p]], [[1.0, 0.0]], [[0.0]])
    a, b, *_ = signal.cont2discrete((system.A, system.B, system.C, system.D), DT)
    states = [np.array(begin)]
    for value in u[:-1]:
        states.append(a @ states[-1] + b[:, 0] * value)
    return np.array(states)[:, 0]


@pytest.fixture(scope="module")
def noisy():
    """A command, and an output with white noise, of known numbers."""
    random = np.random.default_rng(8)
    u = np.repeat(random.normal(size=40), 10)
    return u, output(1.1, 0.8, u) + 0.01 * random.normal(size=400)


def test_the_same_estimates_as_scipy(noisy):
    u, y = noisy
    fitted = fit_log(linear(), log_of(y, u))
    found = optimize.least_squares(lambda at: y - output(*at, u), [1.0, 1.0], xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert fitted.orders == {"": 0}
    assert (np.abs(fitted.estimates - found.x) < 1e-3 * fitted.deviations).all()
    noise = np.sum(found.fun**2) / (len(y) - 2)
    np.testing.assert_allclose(fitted.covariance, noise * np.linalg.inv(found.jac.T @ found.jac), rtol=1e-3)


def test_coloured_noise_widens_the_intervals(noisy):
    u, _ = noisy
    random = np.random.default_rng(2)
    coloured = signal.lfilter([1.0], [1.0, -0.95], random.normal(size=400)) * 0.01 * np.sqrt(1 - 0.95**2)
    white = fit_log(linear(), log_of(output(1.1, 0.8, u) + 0.01 * random.normal(size=400), u))
    fitted = fit_log(linear(), log_of(output(1.1, 0.8, u) + coloured, u))
    assert fitted.orders[""] >= 1
    assert (fitted.deviations != white.deviations).all()
    assert (np.abs(fitted.estimates - [1.1, 0.8]) < 4.0 * fitted.deviations).all()


def test_autoregression():
    random = np.random.default_rng(4)
    series = signal.lfilter([1.0], [1.0, -1.2, 0.5], random.normal(size=5000))
    found = ar_coefficients(series)
    assert len(found) >= 2
    np.testing.assert_allclose(found[:2], [1.2, -0.5], atol=0.06)
    assert abs(np.std(whitened(series, found)) - 1.0) < 0.05
    assert len(ar_coefficients(random.normal(size=5000))) == 0


def test_intervals_cover_the_truth():
    """24 flights of each number; fewer hits than 14 have a probability below 1e-4 at 90 %."""
    hits, told = covered(flight_study(), 24)
    assert told == 24
    assert set(hits) == {"plant.k_p", "plant.a_p", "unmodelled.mu", "disturbance.value"}
    for own in hits.values():
        assert stats.binom.cdf(sum(own), len(own), 0.9) > 1e-4
    together = np.concatenate(list(hits.values()))
    assert stats.binom.cdf(together.sum(), len(together), 0.9) > 1e-4


def test_at_rest_nothing_is_told():
    random = np.random.default_rng(5)
    study = linear(**{"plant": {**linear().table["plant"], "initial": [0.0, 0.0]}})
    with pytest.raises(NotIdentifiable, match=r"tells none of plant.k_p, plant.a_p"):
        fit_log(study, log_of(0.01 * random.normal(size=400), np.zeros(400)))


def test_proportional_regressors_are_named():
    """u = x'/2 makes x'' = (k_p/2 - a_p) x': only this combination shows."""
    random = np.random.default_rng(6)
    study = linear(**{"plant": {**linear().table["plant"], "initial": [0.0, 1.0]}})
    u = 0.5 * np.exp(-0.5 * DT * np.arange(400))  # x' = exp(-(a_p - k_p/2) t), at the samples nearly
    y = output(1.0, 1.0, u, (0.0, 1.0)) + 0.01 * random.normal(size=400)
    with pytest.raises(NotIdentifiable, match=r"does not tell \+0\.8\d plant.k_p \+0\.5\d plant.a_p"):
        fit_log(study, log_of(y, u), ["plant.k_p", "plant.a_p"])


def test_a_lag_that_nothing_excites():
    study = linear(unmodelled={"kind": "lag", "mu": {"loguniform": [0.02, 0.2]}})
    u = np.zeros(400)
    y = output(1.0, 1.0, u, (0.5, 0.0)) + 0.01 * np.random.default_rng(7).normal(size=400)
    with pytest.raises(
        NotIdentifiable, match=r"does not tell unmodelled.mu: the predicted output does not depend on it"
    ):
        fit_log(study, log_of(y, u), ["unmodelled.mu"])


def test_without_commands_the_controller_is_replayed():
    study = linear(draws=4, sensor={"kind": "noisy", "position_std": 0.01, "velocity_std": 0.01})
    ((_,), (curve,)) = list(curves_of_draws(study.override({"draws": 2}), 400))
    whole = log_of(curve.y, curve.u_total)
    rate = whole.columns | {"y_dot": Column(DT * np.arange(400), np.asarray(curve.y_dot))}
    fitted = fit_log(study, FlightLog("flight", {name: rate[name] for name in ("y", "y_dot")}, 0.0))
    assert fitted.replayed == ("",)
    np.testing.assert_allclose(fitted.estimates, fit_log(study, whole).estimates, rtol=1e-9)
    with pytest.raises(ConfigError, match="has no command u_total, and the controller needs y_dot"):
        fit_log(study, log_of(curve.y))


def test_wrong_numbers():
    u = np.ones(400)
    with pytest.raises(ConfigError, match=r"'plant.kp' has no law in this study; did you mean 'plant.k_p'"):
        fit_log(linear(), log_of(u, u), ["plant.kp"])
    with pytest.raises(ConfigError, match="fewer than 20 values"):
        fit_log(linear(), log_of(u[:5], u[:5]))


def test_command(tmp_path, capsys, noisy):
    """The proposal is part of a study file; what is not told is a negative result."""
    u, y = noisy
    rows = [f"{DT * k},{a},{b}" for k, (a, b) in enumerate(zip(y, u, strict=True))]
    (tmp_path / "log.csv").write_text("\n".join(["t,y,u_total", *rows]))
    import tomli_w

    (tmp_path / "s.toml").write_text(tomli_w.dumps(linear().table))
    arguments = ["compare-log", str(tmp_path / "s.toml"), str(tmp_path / "log.csv"), "--fit"]
    out = tmp_path / "laws.toml"
    assert guarded([*arguments, "--out", str(out), "--json"]) == 0
    found = last_json(capsys)
    proposed = tomllib.loads(out.read_text())
    assert found["toml"] == out.read_text()
    changed = {f"plant.{name}": law for name, law in proposed["plant"].items()}
    narrower = linear().override({**changed, "correlation": proposed["correlation"]})
    assert abs(narrower.laws["plant.k_p"].median - 1.1) < 0.02
    assert guarded(arguments) == 0
    printed = capsys.readouterr().out
    assert "90 % interval" in printed
    assert " m rms, " in printed
    quiet = "\n".join(["t,y,u_total", *(f"{DT * k},0.5,0.0" for k in range(400))])
    (tmp_path / "log.csv").write_text(quiet)
    assert guarded([*arguments, "--number", "plant.k_p"]) == 1
    assert "does not tell plant.k_p" in capsys.readouterr().out
    assert guarded([*arguments[:3], "--number", "plant.k_p"]) == 2


def test_a_number_in_a_list_is_proposed_with_the_list(noisy):
    """The proposed lines replace those of the study, whose other entries of the list are kept."""
    u, y = noisy
    plant = {
        "kind": "transfer_function",
        "numerator": [{"uniform": [0.5, 1.5]}],
        "denominator": [1.0, {"normal": [1.0, 0.2]}, 0.0],
    }
    study = linear(plant=plant, units={"output": "m"})
    fitted = fit_log(study, log_of(y - 0.5, u), ["plant.numerator.0", "plant.denominator.1"])
    header, *lines = fitted.toml().splitlines()
    assert header == "[plant]"
    assert [line.split(" = ")[0] for line in lines[:2]] == ["numerator", "denominator"]
    proposed = tomllib.loads(fitted.toml())
    assert [proposed["plant"]["denominator"][k] for k in (0, 2)] == [1.0, 0.0]
    narrower = dj.Study.from_table({**study.table, **proposed, "plant": {**plant, **proposed["plant"]}})
    assert narrower.laws["plant.numerator.0"] == fitted.law("plant.numerator.0")
    assert fitted.summary()["noise_unit"] == {"": "m"}
