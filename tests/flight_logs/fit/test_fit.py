"""Laws from a logged flight: independent estimates, coverage, and flights that identify nothing."""

import tomllib

import numpy as np
import pytest
from scipy import linalg, optimize, signal, stats

import dssc_jax as dj
from benchmarks.flight_fit import CASES, LEVEL, covered, flight_study, inside
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_logs.fit.estimates import correlation_doubts
from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.minima import unseen_minima
from dssc_jax.flight_logs.fit.refusals import NotIdentifiable, Unexplained, noise_between_neighbours
from dssc_jax.flight_logs.fit.search_limits import SearchLimits
from dssc_jax.flight_logs.reading.reader import Column, FlightLog
from dssc_jax.flight_logs.replay import curves_of_draws
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
    assert fitted.noise[""].share == 0.0
    assert (np.abs(fitted.estimates - found.x) < 1e-3 * fitted.deviations).all()
    noise = np.sum(found.fun**2) / (len(y) - 2)
    white = np.sqrt(noise * np.diag(np.linalg.inv(found.jac.T @ found.jac)))
    ratio = fitted.deviations / white
    assert (ratio > 0.99).all()  # noise that may be correlated leaves no less open than white noise
    assert (ratio < 2.0).all()


def test_coloured_noise_widens_the_intervals(noisy):
    u = noisy[0]
    random = np.random.default_rng(2)
    coloured = signal.lfilter([1.0], [1.0, -0.95], random.normal(size=400)) * 0.01 * np.sqrt(1 - 0.95**2)
    white = fit_log(linear(), log_of(output(1.1, 0.8, u) + 0.01 * random.normal(size=400), u))
    fitted = fit_log(linear(), log_of(output(1.1, 0.8, u) + coloured, u))
    assert fitted.noise[""].white < 1e-6
    assert fitted.noise[""].share > 0.5
    assert 0.1 < fitted.noise[""].time < 1.5  # 0.39 s
    assert (fitted.deviations != white.deviations).all()
    assert (np.abs(fitted.estimates - [1.1, 0.8]) < 4.0 * fitted.deviations).all()
    assert [doubt.code for doubt in (*white.doubts, *fitted.doubts)] == ["large-residual"]
    small = fit_log(linear(), log_of(output(1.1, 0.8, u) + 0.01 * random.normal(size=400) + 0.7 * coloured, u))
    assert [doubt.code for doubt in small.doubts] == ["correlated-residual"]
    gusts = linear(disturbance={"kind": "filtered_noise", "std": 0.2, "correlation_time": 0.5})
    assert correlation_doubts(gusts, small.noise) == ()


def test_intervals_cover_the_truth():
    """12 dense flights, at a level at which too few hits have a probability below 1e-4."""
    scores, fits = covered(flight_study(), 12, CASES[0])
    assert fits == 12
    assert set(scores) == {"plant.k_p", "plant.a_p", "unmodelled.mu", "disturbance.value"}
    for errors in scores.values():
        assert stats.binom.cdf(inside(errors).sum(), len(errors), LEVEL) > 1e-4
    pooled = np.concatenate(list(scores.values()))
    assert stats.binom.cdf(inside(pooled).sum(), len(pooled), LEVEL) > 1e-4


@pytest.mark.parametrize("case", [4, 5])
def test_intervals_of_sparse_logs_cover_the_truth(case):
    """Outputs at a tenth of the samples, or at irregular times, with noise that is correlated over 1 s.

    The mean square of n independent errors of unit variance has a standard deviation of sqrt(2/n). The four errors of a
    flight are dependent, so that n is the number of flights.
    """
    scores, fits = covered(flight_study(), 12, CASES[case])
    assert fits >= 10
    pooled = np.concatenate(list(scores.values()))
    assert np.mean(np.square(pooled)) < 1.0 + 4.0 * np.sqrt(2.0 / fits)
    assert inside(pooled).mean() > 0.85


def oscillator(**changes):
    """y'' + 0.2 y' + k y = u + 1 with an unknown k: there is a least-squares minimum for each cycle skipped."""
    return linear(
        plant={
            "kind": "transfer_function",
            "numerator": [1.0],
            "denominator": [1.0, 0.2, {"loguniform": [1.0, 900.0]}],
        },
        reference={"kind": "zero"},
        disturbance={"kind": "step", "value": 1.0, "at": 0.0},
        **changes,
    )


def ringing(k, noise=0.003):
    """The oscillator's output in closed form, with white noise, and no command."""
    time = DT * np.arange(400)
    w = np.sqrt(k - 0.01)
    y = (1.0 - np.exp(-0.1 * time) * (np.cos(w * time) + 0.1 / w * np.sin(w * time))) / k
    return log_of(y + noise * np.random.default_rng(0).normal(size=400), np.zeros(400))


def test_the_best_of_many_minima_is_found():
    """From the median of the law, a search ends at 153."""
    k = 200.0
    fitted = fit_log(oscillator(), ringing(k))
    assert fitted.estimates[0] == pytest.approx(k, rel=5e-3)
    assert len(fitted.rivals) >= 3
    assert all(rival.ratio > 1.0 for rival in fitted.rivals)
    assert fitted.starts_here + sum(rival.starts for rival in fitted.rivals) <= fitted.starts
    assert fitted.summary()["other_minima"][0]["values"].keys() == {"plant.denominator.2"}


def test_number_of_unseen_minima():
    """Boender and Rinnooy Kan: w (n - 1)/(n - w - 2) minima are expected after n starts found w."""
    assert unseen_minima(8, 1) == pytest.approx(7.0 / 5.0 - 1.0)
    assert unseen_minima(8, 6) == np.inf


@pytest.mark.parametrize(("wrong", "stride"), [("unit", 1), ("sign", 8), ("start", 8)])
def test_a_residual_that_is_no_noise_is_refused(noisy, wrong, stride):
    u, y = noisy
    logged = {"unit": 100.0 * y, "sign": -y, "start": np.roll(y, 50)}[wrong]
    time = DT * np.arange(400)
    log = FlightLog("flight", {"y": Column(time[::stride], logged[::stride]), "u_total": Column(time, u)}, 0.0)
    with pytest.raises(
        Unexplained,
        match=r"residual of y is .* m rms, largest at .* s of the study.*, noise explains .* Compare the log's columns",
    ):
        fit_log(linear(), log)


def test_what_the_study_calls_noise_is_no_contradiction(noisy):
    """A residual as large as the study's own sensor noise, which its readings hold for 20 samples, is accepted."""
    u, y = noisy
    held = np.repeat(0.15 * np.random.default_rng(9).normal(size=20), 20)
    sensor = {"kind": "noisy", "position_std": 0.15, "velocity_std": 0.0}
    log = log_of(y + held, u)
    with pytest.raises(Unexplained):
        fit_log(linear(), log, ["plant.k_p"])
    fitted = fit_log(linear(sensor=sensor), log, ["plant.k_p"])
    assert fitted.noise[""].explained.noise == pytest.approx(0.15, rel=0.1)
    assert fitted.noise[""].explained.unexplained < 0.1


def test_noise_between_neighbours():
    random = np.random.default_rng(10)
    times = np.cumsum(random.uniform(0.1, 1.0, 4000))
    found = noise_between_neighbours(times, 3.0 * times + 0.5 * random.normal(size=4000))
    assert found == pytest.approx(0.5, rel=0.05)
    assert noise_between_neighbours(times, 3.0 * times) < 1e-9


def test_readings_between_samples_are_compared_at_their_times():
    """Stamps 0.4 samples late: the noise-free output of SciPy at those times leaves no residual."""
    u = np.repeat(np.random.default_rng(8).normal(size=40), 10)
    late = 0.4 * DT
    system = np.array([[0.0, 1.0, 0.0], [0.0, -0.8, 1.1], [0.0, 0.0, 0.0]])
    full_step, partial_step = linalg.expm(system * DT), linalg.expm(system * late)
    state, y = np.array([0.5, 0.0, 0.0]), []
    for command in u:
        state[2] = command
        y.append((partial_step @ state)[0])
        state = full_step @ state
    time = DT * np.arange(400)
    log = FlightLog("flight", {"y": Column(time + late, np.array(y)), "u_total": Column(time, u)}, 0.0)
    fitted = fit_log(linear(), log)
    np.testing.assert_allclose(fitted.estimates, [1.1, 0.8], atol=2e-3)
    assert fitted.noise[""].explained.residual < 2e-4


def test_an_estimate_outside_its_law_is_told(noisy):
    u, _ = noisy
    y = output(1.1, 0.8, u) + 0.01 * np.random.default_rng(11).normal(size=400)
    study = linear(plant={**linear().table["plant"], "k_p": {"uniform": [0.5, 0.9]}})
    fitted = fit_log(study, log_of(y, u))
    assert fitted.outside_laws().keys() == {"plant.k_p"}
    assert "the estimate of plant.k_p lies outside its law" in str(fitted.summary()["warnings"])
    assert fit_log(linear(), log_of(y, u)).outside_laws() == {}


def test_an_output_in_another_unit_and_no_reference_is_refused(noisy):
    u, y = noisy
    study = linear(plant={**linear().table["plant"], "initial": [0.0, 0.0]})
    y = 100.0 * (output(1.1, 0.8, u, (0.0, 0.0)) + 0.001 * np.random.default_rng(11).normal(size=400))
    with pytest.raises(Unexplained, match=r"plant.k_p is 110, 110 times the median of the law uniform\(0.5, 1.5\)"):
        fit_log(study, log_of(y, u))


def test_readings_whose_stamps_are_rounded_to_the_same_time(noisy):
    u, y = noisy
    log = log_of(y, u)
    rounded = np.round(log.columns["y"].time / 0.05) * 0.05
    columns = {name: column._replace(time=rounded) for name, column in log.columns.items()}
    fitted = fit_log(linear(), log._replace(columns=columns))
    assert fitted.samples <= len(np.unique(rounded))
    assert np.isfinite(fitted.covariance).all()


def test_at_rest_nothing_is_told():
    random = np.random.default_rng(5)
    study = linear(**{"plant": {**linear().table["plant"], "initial": [0.0, 0.0]}})
    with pytest.raises(NotIdentifiable, match=r"identifies none of plant.k_p, plant.a_p"):
        fit_log(study, log_of(0.01 * random.normal(size=400), np.zeros(400)))


def test_proportional_regressors_are_named():
    """u = x'/2 makes x'' = (k_p/2 - a_p) x': only this combination shows."""
    random = np.random.default_rng(6)
    study = linear(**{"plant": {**linear().table["plant"], "initial": [0.0, 1.0]}})
    u = 0.5 * np.exp(-0.5 * DT * np.arange(400))  # x' = exp(-(a_p - k_p/2) t), at the samples nearly
    y = output(1.0, 1.0, u, (0.0, 1.0)) + 0.01 * random.normal(size=400)
    with pytest.raises(NotIdentifiable, match=r"does not identify \+0\.8\d plant.k_p \+0\.5\d plant.a_p"):
        fit_log(study, log_of(y, u), ["plant.k_p", "plant.a_p"])


def test_a_lag_that_nothing_excites():
    study = linear(unmodelled={"kind": "lag", "mu": {"loguniform": [0.02, 0.2]}})
    u = np.zeros(400)
    y = output(1.0, 1.0, u, (0.5, 0.0)) + 0.01 * np.random.default_rng(7).normal(size=400)
    with pytest.raises(
        NotIdentifiable, match=r"does not identify unmodelled.mu: the predicted output does not depend on it"
    ):
        fit_log(study, log_of(y, u), ["unmodelled.mu"])


def test_without_commands_the_controller_is_replayed():
    study = linear(draws=4, sensor={"kind": "noisy", "position_std": 0.01, "velocity_std": 0.01})
    ((_,), (curve,)) = list(curves_of_draws(study.override({"draws": 2}), 400))
    log = log_of(curve.y, curve.u_total)
    rate = log.columns | {"y_dot": Column(DT * np.arange(400), np.asarray(curve.y_dot))}
    fitted = fit_log(study, FlightLog("flight", {name: rate[name] for name in ("y", "y_dot")}, 0.0))
    assert fitted.replayed == ("",)
    np.testing.assert_allclose(fitted.estimates, fit_log(study, log).estimates, rtol=1e-9)
    with pytest.raises(ConfigError, match="has no command u_total, and the controller needs y_dot"):
        fit_log(study, log_of(curve.y))


def test_wrong_numbers():
    u = np.ones(400)
    with pytest.raises(ConfigError, match=r"'plant.kp' has no law in this study; did you mean 'plant.k_p'"):
        fit_log(linear(), log_of(u, u), ["plant.kp"])
    with pytest.raises(ConfigError, match="fewer than 20 values"):
        fit_log(linear(), log_of(u[:5], u[:5]))


def test_command(tmp_path, capsys, noisy):
    """The proposal is part of a study file; unidentified numbers are a negative result."""
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
    assert " m rms of an output" in printed
    assert "8 of 8 starts of the search end in this minimum" in printed
    centimetres = "\n".join(
        ["t,y,u_total", *(f"{DT * k},{100 * a},{b}" for k, (a, b) in enumerate(zip(y, u, strict=True)))]
    )
    (tmp_path / "log.csv").write_text(centimetres)
    assert guarded([*arguments, "--json"]) == 1
    refused = last_json(capsys)
    assert refused["explained"] is False
    assert "Compare the log's columns, units, signs and start" in refused["reason"]
    quiet = "\n".join(["t,y,u_total", *(f"{DT * k},0.5,0.0" for k in range(400))])
    (tmp_path / "log.csv").write_text(quiet)
    assert guarded([*arguments, "--number", "plant.k_p"]) == 1
    assert "does not identify plant.k_p" in capsys.readouterr().out
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


def test_parameters_are_fitted_as_numbers_are(noisy):
    u, y = noisy
    parameters = {
        "m": {"uniform": [0.7, 2.0], "unit": "kg", "meaning": "mass"},
        "b": {"normal": [0.9, 0.2]},
        "unseen": {"uniform": [0.0, 1.0]},
    }
    plant = {"kind": "normal_form", "k_p": "=1/m", "a_p": "=b/m", "initial": [0.5, 0.0]}
    reference = {"kind": "sine", "amplitude": "=0.5 + 0*unseen", "period": 2.0}
    study = linear(plant=plant, parameters=parameters, reference=reference)
    fitted = fit_log(study, log_of(y, u))
    assert fitted.names == ("parameters.m", "parameters.b")
    found = optimize.least_squares(lambda at: y - output(1.0 / at[0], at[1] / at[0], u), [1.0, 1.0], xtol=1e-14)
    assert (np.abs(fitted.estimates - found.x) < 1e-3 * fitted.deviations).all()
    proposal = tomllib.loads(fitted.toml())
    assert proposal["parameters"]["m"]["unit"] == "kg"
    assert proposal["parameters"]["m"].keys() == {"truncated_normal", "unit", "meaning"}
    assert study.override({f"parameters.{name}": law for name, law in proposal["parameters"].items()}).laws


def test_the_search_ends_at_its_limit_with_the_best_so_far(motor):
    """Three simulations allow no screening; the medians of the laws still lead to the truth."""
    study, log = motor
    counted = []
    fitted = fit_log(
        study,
        log,
        ["unmodelled.mu"],
        limits=SearchLimits(3),
        progress=lambda done, total: counted.append((done, total)),
    )
    assert fitted.cut == "after 3 simulations"
    assert fitted.summary()["starts"] == 1
    assert counted[:4] == [(1, 3), (2, 3), (3, 3), (3, 3)]
    assert fitted.law("unmodelled.mu").kind == "lognormal"


def test_a_damaged_log_is_refused_unless_it_is_allowed(motor):
    study, log = motor
    damaged = log._replace(damaged=True)
    with pytest.raises(ConfigError, match=r"is damaged: messages are lost.*`allow_damaged`"):
        fit_log(study, damaged, ["unmodelled.mu"])
    assert fit_log(study, damaged, ["unmodelled.mu"], allow_damaged=True, limits=SearchLimits(3)).starts == 1


@pytest.fixture(scope="module")
def motor():
    """The packaged motor, and a flight of its third draw."""
    study = dj.Study.load("motor")
    run = dj.simulate(study, 3)
    columns = {name: Column(run["t"].values, run[name].values) for name in ("y", "u_total")}
    return study, FlightLog("run", columns, 0.0)
