"""Classical margins of the simulated loop: against python-control, delays that destabilise it, and what is refused."""

import warnings

import control
import numpy as np
import pytest
from scipy.linalg import expm

import dssc_jax as dj

SAMPLE_TIME = 0.01
TABLE = {
    "name": "loop",
    "seed": 5,
    "draws": 100,
    "loop": {"duration": 2.0, "sample_time": SAMPLE_TIME, "substeps": 4},
    "plant": {"kind": "normal_form", "k_p": {"loguniform": [0.5, 2.0]}, "a_p": {"uniform": [-0.5, 3.0]}},
    "controller": {
        "kind": "pi",
        "l0": {"loguniform": [0.3, 3.0]},
        "k_p": {"loguniform": [1.0, 5.0]},
        "k_i": {"loguniform": [0.1, 3.0]},
    },
    "unmodelled": {"kind": "lag", "order": 1, "mu": {"loguniform": [0.01, 0.1]}},
}


@pytest.fixture(scope="module")
def study():
    return dj.Study.from_table(TABLE)


@pytest.fixture(scope="module")
def found(study):
    return dj.loop_margins(study)


def by_hand(values):
    """The loop of PI on sigma = y' + l0 y behind a lag: plant held exactly, controller in z."""
    k_p, a_p, mu = values["plant.k_p"], values["plant.a_p"], values["unmodelled.mu"]
    l0 = values["controller.l0"]
    a = np.array([[0.0, 1.0, 0.0], [0.0, -a_p, k_p], [0.0, 0.0, -1.0 / mu]])
    b = np.array([0.0, 0.0, 1.0 / mu])
    held = expm(np.block([[a, b[:, None]], [np.zeros((1, 4))]]) * SAMPLE_TIME)
    plant = control.ss(held[:3, :3], held[:3, 3:], [[l0, 1.0, 0.0]], 0.0, SAMPLE_TIME)
    return plant


def controller_by_hand(study, values):
    """The response of the sampled controller to sigma: a simulated pulse, so that its form is not assumed."""
    import jax

    with jax.enable_x64(True):
        params, model = study.params(values).controller[0], study.loop.controller[0]
        from dssc_jax.core.signals import Measurement, ReferencePoint

        zero, pulse = ReferencePoint(0.0, 0.0, 0.0), []
        state = model.init(params, Measurement(0.0, 0.0), zero)
        for k in range(3):
            seen = Measurement(0.0, 1.0 if k == 0 else 0.0)
            state, command, _ = model.step(params, state, seen, zero, SAMPLE_TIME)
            pulse.append(-float(command.total))
    direct, jump, stays = pulse
    assert stays == pytest.approx(jump, rel=1e-12)
    return control.tf([direct, jump - direct], [1.0, -1.0], SAMPLE_TIME)


def test_a_hundred_random_loops_agree_with_python_control(study, found):
    assert found.loops == ["input", "output", "rate"]
    own = found.dataset.sel(operating_point="equilibrium", loop="input")
    stable = 0
    for draw in range(100):
        values = {name: float(column[draw]) for name, column in drawn(study).items()}
        loop = control.series(controller_by_hand(study, values), by_hand(values))
        closed = control.feedback(loop, 1)
        is_stable = np.max(np.abs(closed.poles())) < 1.0
        assert (int(own["status"][draw]) == 0) == is_stable
        if not is_stable:
            continue
        stable += 1
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it tells that it replaces roots of polynomials by interpolation
            gain, phase, _, _, crossover, _ = control.stability_margins(loop)
        gains = [float(own[name][draw]) for name in ("gain_lower", "gain_upper")]
        nearest = min((one for one in gains if one > 0.0), key=lambda one: abs(np.log(one)))
        assert nearest == pytest.approx(gain, rel=1e-3)
        assert np.degrees(float(own["phase"][draw])) == pytest.approx(phase, rel=1e-3)
        assert float(own["crossover"][draw]) == pytest.approx(crossover, rel=1e-3)
        assert float(own["disk"][draw]) == pytest.approx(disk_margin(loop), rel=1e-3)
    assert stable > 80


def disk_margin(loop, points=80):
    """The least of python-control's disk margins: over all frequencies, then between the neighbours of the least."""
    omega = np.geomspace(1e-2, np.pi / SAMPLE_TIME, points)
    nearest = int(np.argmin(control.disk_margins(loop, omega, returnall=True)[0]))
    around = omega[max(nearest - 1, 0)], omega[min(nearest + 1, points - 1)]
    return float(control.disk_margins(loop, np.geomspace(*around, points))[0])


def drawn(study):
    from dssc_jax.engine.batching import values_of_draws as values

    return values(study, slice(0, study.config.draws))


def test_dssc_in_sliding_is_the_pi_loop_that_it_synthesises():
    """SSC with constant functions: K_P = 1/(k_o tau_av), K_I = K_P/tau_m, in backward Euler like PI."""
    functions = {"kind": "constant", "k_o": 10.0, "tau_av": 0.05, "tau_m": 2.0}
    dssc = {"controller": {"kind": "dssc", "l0": 1.0, "rho": 3.0, "functions": functions}, "draws": 59}
    fixed = {"controller": {"kind": "pi", "l0": 1.0, "k_p": 2.0, "k_i": 1.0}, "draws": 59}
    one, other = (dj.loop_margins(dj.Study.from_table(TABLE | change)).dataset for change in (dssc, fixed))
    names = ["phase", "delay", "gain_upper", "disk", "sensitivity_peak"]
    for name in names:
        np.testing.assert_allclose(one[name], other[name], rtol=2e-2)


def test_a_delay_beyond_the_margin_makes_the_loop_unstable(study):
    """A whole number of samples below and above the delay margin, at the plant input."""
    fast = {"controller.k_p": 5.0, "controller.l0": 3.0}
    certain = study.override({"draws": 1} | {name: law.median for name, law in study.laws.items()} | fast)
    room = margin_in_samples(certain, 0.0)
    for samples, status in ((np.floor(room), 0), (np.ceil(room), 1)):
        delayed = dj.loop_margins(certain.override({"unmodelled": delay(samples)})).dataset["status"]
        assert int(delayed.sel(loop="input").squeeze()) == status


def delay(samples):
    return {"kind": "delay", "samples": float(samples), "memory": 30.0}


def margin_in_samples(study, samples):
    margins = dj.loop_margins(study.override({"unmodelled": delay(samples)}))
    return float(margins.dataset["delay"].sel(loop="input").squeeze()) / SAMPLE_TIME


def test_along_the_flight_a_linear_loop_has_the_margins_of_its_equilibrium(study, found):
    moving = study.override({"reference": {"kind": "sine", "amplitude": 1.0, "period": 5.0}, "draws": 20})
    flown = dj.loop_margins(moving, times=(0.5, 1.5))
    assert flown.points == ["t = 0.5 s", "t = 1.5 s"]
    for point in flown.points:
        np.testing.assert_allclose(
            flown.dataset["phase"].sel(operating_point=point, loop="input"),
            found.dataset["phase"].sel(operating_point="equilibrium", loop="input")[:20],
            rtol=1e-6,
        )


def test_statistics_are_order_statistics(found):
    own = found.summary()["loops"]["input"]
    phase = found.values("phase", "equilibrium", "input")
    assert own["phase"]["worst"] == (phase.min() if np.isfinite(phase.min()) else None)
    peaks = np.sort(found.values("sensitivity_peak", "equilibrium", "input"))
    limit = own["sensitivity_peak"]["tolerance_limit"]
    assert limit == (peaks[98] if np.isfinite(peaks[98]) else None)  # 100 draws: the second largest (Wilks)


def test_the_figure_counts_unstable_loops_below_every_margin(study):
    """Each share is that of the draws whose margin is at most the value; an unstable loop has the worst margin."""
    margins = dj.loop_margins(study.override({"draws": 40, "unmodelled": delay(30)}))
    unstable = np.count_nonzero(margins.dataset["status"].sel(loop="input").values)
    assert 0 < unstable < 40
    axes = margins.figure().axes
    for ax, name, scale in ((axes[2], "phase", 180.0 / np.pi), (axes[5], "delay", 1.0)):
        drawn, shares = ax.lines[0].get_data()
        values = scale * margins.values(name, "equilibrium", "input")
        assert (drawn[0], shares[0]) == (0.0, unstable / 40)
        assert shares == pytest.approx([np.mean(values <= value * (1.0 + 1e-12)) for value in drawn])
        assert f"{unstable} without a stable loop" in ax.get_legend().get_texts()[0].get_text()


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"controller": {"kind": "smc", "l0": 1.0, "gain": 1.0}}, "switches at the origin"),
        ({"sampling": "sobol", "draws": 64}, "needs independent draws"),
        ({"sensor": {"kind": "noisy", "period_samples": 2.0}}, "must be 1 for a frequency response"),
        (
            {
                "controller": {
                    "kind": "dssc",
                    "l0": 1.0,
                    "rho": 3.0,
                    "functions": {"kind": "sta", "kappa1": 1.0, "kappa2": 1.0, "k_o": 1.0},
                }
            },
            "functions of the standard STA switches at the origin",
        ),
    ],
)
def test_loops_without_a_frequency_response(study, changes, text):
    with pytest.raises(dj.ConfigError, match=text):
        dj.loop_margins(study.override({"draws": 8} | changes))


def test_times_lie_in_the_flight(study):
    for times in ((3.0,), (1.0, 0.5), (-1.0,)):
        with pytest.raises(dj.ConfigError, match="must ascend within"):
            dj.loop_margins(study, times=times)


def test_y_is_broken_in_all_its_sensors():
    """Where LQG measures y alone, all of the loop passes y: the loops broken there and at the command are one.

    The error of the integral and the estimator read y through sensors of their own; one of both stayed closed.
    """
    study = dj.Study.from_table(
        {
            "name": "measured",
            "draws": 3,
            "loop": {"duration": 2.0, "sample_time": 0.01},
            "plant": {"kind": "normal_form", "k_p": {"uniform": [0.8, 1.2]}},
            "sensor": {"measures": ["y"]},
            "controller": {
                "kind": "lqg",
                "integral_weight": 4.0,
                "state_weights": [1.0, 0.1],
                "command_weight": 0.1,
                "disturbance_std": [1.0],
                "signal_std": [0.01],
            },
        }
    )
    margins = dj.loop_margins(study).dataset
    for name in ("gain_upper", "phase", "disk"):
        values = margins[name].sel(operating_point="equilibrium")
        np.testing.assert_allclose(values.sel(loop="output"), values.sel(loop="input"), rtol=1e-6)
