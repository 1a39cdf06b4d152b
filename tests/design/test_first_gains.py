"""First gains for plants of one's own: in their units, at the bandwidth that was asked for, and stable."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.optimize import brentq

import dssc_jax as dj
from dssc_jax.analyses.loop_margins.designed import designed_margins
from dssc_jax.core.errors import ConfigError
from dssc_jax.design.first_gains import first_gains, linearised_plant
from dssc_jax.design.linearised_plant import equilibrium, holding_command
from tests.engine.linearisation.test_margin_values import response_of
from tests.study.test_signals import held

INDUCTANCE, CAPACITY, SUPPLY, LOAD = 1e-5, 1e-4, 12.0, 2.0
T_S = 2e-6
BANDWIDTH = 6e4


def buck(controller=None, **changes):
    """A buck converter: volts from a duty ratio."""
    a = [[0.0, -1.0 / INDUCTANCE], [1.0 / CAPACITY, -1.0 / (LOAD * CAPACITY)]]
    table = {
        "name": "buck",
        "loop": {"duration": 4e-3, "sample_time": T_S},
        "plant": {"kind": "state_space", "a": a, "b": [SUPPLY / INDUCTANCE, 0.0], "c": [0.0, 1.0]},
        "units": {"output": "V", "command": "1"},
        "reference": {"kind": "step", "size": 3.3},
        "disturbance": {"kind": "step", "value": 0.05, "at": 1e-3},
        "controller": controller or {"kind": "pid", "k_p": 0.1},
    }
    return dj.Study.from_table({**table, **changes})


@pytest.mark.parametrize("kind", ["pid", "lqg", "ssc"])
def test_a_buck_converter_follows_its_reference(kind):
    found = first_gains(buck(), kind, BANDWIDTH, 1.0)
    run = dj.simulate(buck(found.table))
    assert found.sensitivity_peak < 2.0
    assert run.attrs["outcome_meaning"] == "ok"
    assert abs(float(run["e"][-1])) < 0.02
    assert float(np.max(np.abs(run["u"]))) <= 1.0 + 1e-12
    assert not found.radius >= 1.0


def test_the_pid_loop_crosses_one_at_the_bandwidth_with_its_phase_margin():
    found = first_gains(buck(), "pid", BANDWIDTH)
    law = found.table
    a, b, c = linearised_plant(buck())[:3]
    transition, columns = held(a, b[:, None], T_S)
    z = np.exp(1j * BANDWIDTH * T_S)
    plant = c @ np.linalg.solve(z * np.eye(2) - transition, columns[:, 0])
    s = 1j * BANDWIDTH
    loop = plant * (law["k_p"] + law["k_i"] / s + law["k_d"] * s / (law["filter"] * s + 1.0))
    assert abs(loop) == pytest.approx(1.0, rel=2e-3)
    assert np.degrees(np.angle(loop)) == pytest.approx(-120.0, abs=0.2)


def test_the_largest_pole_is_that_of_the_loops_own_step():
    """Free decay of the simulated loop, late, against the largest pole."""
    found = first_gains(buck(), "pid", BANDWIDTH)
    study = buck(found.table, reference={"kind": "zero"}, disturbance={"kind": "none"})
    run = dj.simulate(study.override({"plant.x0": [0.0, 1.0]}))
    y = np.abs(run["y"].values)
    assert (y[1500] / y[1000]) ** (1.0 / 500.0) == pytest.approx(found.radius, rel=1e-4)


def simulated_settling(table):
    """Time after which the simulated output of an undisturbed buck converter forgets a step at the command."""
    quiet = buck(table, reference={"kind": "zero"}, disturbance={"kind": "step", "value": 1.0})
    run = dj.simulate(quiet.override({"loop.duration": 2e-2}))
    size = np.abs(run["y"].values)
    return float(run["t"][np.flatnonzero(size > 0.02 * np.max(size))[-1] + 1])


@pytest.mark.parametrize("kind", ["pid", "lqg"])
def test_without_a_bandwidth_the_loop_settles_no_slower_than_at_others(kind):
    found = first_gains(buck(), kind)
    settled = simulated_settling(found.table)
    assert found.settling == pytest.approx(settled, rel=0.02)
    assert found.sensitivity_peak <= 2.0
    slower = first_gains(buck(), kind, 0.5 * found.bandwidth)
    assert settled < 1.05 * simulated_settling(slower.table)


def boost(**changes):
    """A boost converter at half duty: its pole pair resonates, and its zero lies in the right half-plane."""
    inductance, capacity, load, supply = 1e-4, 1.9e-4, 13.4, 12.0
    output = 2.0 * supply
    a = [[-500.0, -0.5 / inductance], [0.5 / capacity, -1.0 / (load * capacity)]]
    b = [output / inductance, -2.0 * output / (load * capacity)]
    return buck(loop={"duration": 0.05, "sample_time": 1e-5}, **changes).override(
        {"plant.a": a, "plant.b": b, "plant.c": [0.0, 1.0]}
    )


def test_between_two_halvings_a_loop_may_settle_much_faster():
    """That of the motor with friction has a peak of abs(S) above 2 at 15.7 rad/s, and settles slowly at 7.85 rad/s."""
    motor = dj.Study.load("studies/motor.toml")
    highest = 0.05 * np.pi / motor.loop.sample_time
    found = first_gains(motor, "ssc", limit=0.5)
    halved = [first_gains(motor, "ssc", highest * 0.5**half, limit=0.5) for half in range(1, 6)]
    calm = [design.settling for design in halved if design.sensitivity_peak <= 2.0]
    assert found.sensitivity_peak <= 2.0
    assert found.settling < 0.7 * min(calm)


def test_the_integral_is_fast_enough_above_a_resonance():
    """At 3,900 rad/s, just above the resonance, little gain is left below it; the integral is slow then."""
    found = first_gains(boost(), "pid")
    assert found.settling < 0.5 * first_gains(boost(), "pid", 3900.0).settling
    assert found.sensitivity_peak < 2.0


def test_the_margins_of_a_design_are_those_of_its_frequency_response():
    """Crossings of L, written term by term, on a dense grid, refined by Brent's method."""
    found = first_gains(boost(), "pid", 3900.0)
    t_s = 1e-5
    margins = designed_margins(found.loop, t_s)
    respond = response_of(*linearised_plant(boost())[:3], found.table, t_s)
    grid = np.geomspace(1.0, np.pi / t_s * (1.0 - 1e-9), 20_000)
    values = np.array([respond(omega) for omega in grid])
    gain = [brentq(lambda w: abs(respond(w)) - 1.0, *grid[k : k + 2]) for k in changes(np.abs(values) - 1.0)]
    crossed = [brentq(lambda w: respond(w).imag, *grid[k : k + 2]) for k in changes(values.imag)]
    negative = [omega for omega in crossed if respond(omega).real < 0.0]
    assert len(gain) == 3
    assert margins.gain_crossovers == pytest.approx(gain, rel=1e-6)
    assert margins.phase_crossings[: len(negative)] == pytest.approx(negative, rel=1e-6)
    assert margins.gain_margin == pytest.approx(min(-1.0 / respond(omega).real for omega in negative), rel=1e-6)
    left = [abs(np.angle(-respond(omega))) for omega in gain]
    assert margins.phase_margin == pytest.approx(min(left), rel=1e-6)
    assert margins.phase_margin_at == pytest.approx(gain[int(np.argmin(left))], rel=1e-6)


def changes(values):
    """Where the sign changes."""
    return np.flatnonzero(values[:-1] * values[1:] < 0.0)


@pytest.mark.parametrize(
    ("kind", "bandwidth", "limit", "message"),
    [
        ("dssc", BANDWIDTH, 1.0, "must be one of pid, lqg, state_feedback, ssc"),
        ("pid", 1e7, None, "must be > 0 and <="),
        ("pid", 3.1e5, None, "needs a phase lead"),
        ("ssc", BANDWIDTH, None, "is required for 'ssc'"),
    ],
)
def test_what_cannot_be_designed_gets_its_line(kind, bandwidth, limit, message):
    with pytest.raises(ConfigError, match=message):
        first_gains(buck(), kind, bandwidth, limit)


def test_a_plant_with_the_other_sign_is_refused():
    with pytest.raises(ConfigError, match=r"turn the command's sign|is not stable"):
        first_gains(buck().override({"plant.b": [-SUPPLY / INDUCTANCE, 0.0]}), "pid", BANDWIDTH)


DELAY, LAG = 1.3, 1e-6  # samples, s
BEHIND = [{"kind": "lag", "mu": LAG}, {"kind": "delay", "samples": DELAY, "memory": 3}]


def augmented(a, b, actuators=True):
    """The buck converter behind lag and delay, written out: states x, lag, u(k-1), u(k-2)."""
    n = len(a)
    system = np.zeros((n + 1, n + 1))
    system[:n, :n] = a
    system[:n, n] = b
    system[n, n] = -1.0 / LAG
    transition, columns = held(system, np.append(np.zeros(n), 1.0 / LAG)[:, None], T_S)
    whole = np.zeros((n + 3, n + 3))
    whole[: n + 1, : n + 1] = transition
    whole[: n + 1, n + 1] = (2.0 - DELAY) * columns[:, 0]
    whole[: n + 1, n + 2] = (DELAY - 1.0) * columns[:, 0]
    whole[n + 2, n + 1] = 1.0
    return whole, np.eye(n + 3)[n + 1]


def largest(matrix):
    return np.max(np.abs(np.linalg.eigvals(matrix)))


def test_the_pid_loop_has_its_phase_margin_behind_lag_and_delay():
    study = buck(actuator=BEHIND)
    bandwidth = 4e4
    found = first_gains(study, "pid", bandwidth)
    assert found.linear_kinds == ("lag", "delay")
    law = found.table
    a, b, c = linearised_plant(study)[:3]
    whole, entry = augmented(a, b)
    row = np.append(c, np.zeros(3))
    z = np.exp(1j * bandwidth * T_S)
    s = 1j * bandwidth
    plant = row @ np.linalg.solve(z * np.eye(5) - whole, entry)
    loop = plant * (law["k_p"] + law["k_i"] / s + law.get("k_d", 0.0) * s / (law.get("filter", 0.0) * s + 1.0))
    assert abs(loop) == pytest.approx(1.0, rel=2e-3)
    assert np.degrees(np.angle(loop)) == pytest.approx(-120.0, abs=0.2)


def test_the_poles_of_lqg_behind_actuators_are_those_of_the_loop_written_out():
    """Regulator and filter know the plant alone; python's own Riccati solutions, and the loop with 5 + 3 states."""
    study = buck(actuator=BEHIND)
    found = first_gains(study, "lqg", 2e4)
    law = found.table
    a, b, c = linearised_plant(study)[:3]
    transition, columns = held(a, b[:, None], T_S)
    column = columns[:, 0]
    extended = np.block([[transition, np.zeros((2, 1))], [T_S * c[None, :], np.ones((1, 1))]])
    q = np.zeros((3, 3))
    q[:2, :2] = np.outer(c, c)
    q[2, 2] = law["integral_weight"]
    entry = np.append(column, 0.0)[:, None]
    p = solve_discrete_are(extended, entry, q, [[law["command_weight"]]])
    gains = np.linalg.solve(law["command_weight"] + entry.T @ p @ entry, entry.T @ p @ extended)[0]
    p = solve_discrete_are(transition.T, c[:, None], np.outer(column, column), [[law["signal_std"][0] ** 2]])
    correction = p @ c / (c @ p @ c + law["signal_std"][0] ** 2)
    whole, plant_entry = augmented(a, b)
    y = np.concatenate([c, np.zeros(6)])
    matrix = np.zeros((8, 8))
    unit = np.eye(8)
    estimate = unit[5:7] + np.outer(correction, y - c @ unit[5:7])
    command = -gains[:2] @ estimate - gains[2] * unit[7]
    matrix[:5, :5] = whole
    matrix[:5] += np.outer(plant_entry, command)
    matrix[5:7] = transition @ estimate + np.outer(column, command)
    matrix[7] = unit[7] + T_S * y
    assert found.radius == pytest.approx(largest(matrix), abs=1e-9)


@pytest.mark.parametrize("kind", ["lqg", "state_feedback", "ssc"])
def test_late_decay_behind_actuators_is_that_of_the_largest_pole(kind):
    found = first_gains(buck(actuator=BEHIND, sensor={"measures": "state"}), kind, 1e4, 1e6)
    quiet = {"reference": {"kind": "zero"}, "disturbance": {"kind": "none"}, "actuator": BEHIND}
    study = buck(found.table, sensor={"measures": "state"}, **quiet).override({"plant.x0": [0.0, 1e-3]})
    y = np.abs(dj.simulate(study)["y"].values)
    assert max(y[1500:1800]) / max(y[1200:1500]) == pytest.approx(found.radius**300.0, rel=0.1)


@pytest.mark.parametrize("kind", ["pid", "lqg", "state_feedback", "ssc"])
def test_gains_that_are_stable_without_their_actuators_alone_are_refused(kind):
    slow = [{"kind": "lag", "mu": 1e-4}, {"kind": "delay", "samples": 3.0}]
    sensor = {"measures": "state"} if kind == "state_feedback" else {"kind": "ideal"}
    assert first_gains(buck(sensor=sensor), kind, BANDWIDTH, 1.0).radius < 1.0
    with pytest.raises(ConfigError, match=r"not stable, behind its linear actuators \(lag \+ delay\)|phase lead"):
        first_gains(buck(actuator=slow, sensor=sensor), kind, BANDWIDTH, 1.0)
    found = first_gains(buck(actuator=slow, sensor=sensor), kind, limit=1.0)
    assert found.bandwidth < BANDWIDTH
    assert found.radius < 1.0
    assert found.sensitivity_peak <= 2.0


def test_what_is_not_linear_is_named_as_left_out():
    limit = {"kind": "saturation", "limit": 1.0}
    found = first_gains(buck(actuator=[limit, *BEHIND], sensor={"kind": "noisy", "position_std": 0.01}), "pid", 4e4)
    assert found.left_out == ("sensor 'noisy'", "saturation")
    assert found.table == first_gains(buck(actuator=BEHIND), "pid", 4e4).table


def test_lqg_of_several_signals_has_their_noise_in_proportion_to_their_sizes():
    """Sizes by the plant's own response to the command's disturbance, at four times the bandwidth."""
    study = buck(sensor={"measures": ["x1", "y"]})
    bandwidth = 2e4
    found = first_gains(study, "lqg", bandwidth)
    a, b, _ = linearised_plant(study)[:3]
    transition, columns = held(a, b[:, None], T_S)
    z = np.exp(4j * bandwidth * T_S)
    current, voltage = np.abs(np.linalg.solve(z * np.eye(2) - transition, columns[:, 0]))
    first, second = found.table["signal_std"]
    assert first / second == pytest.approx(current / voltage, rel=1e-3)
    assert dj.simulate(buck(found.table, sensor={"measures": ["x1", "y"]})).attrs["outcome_meaning"] == "ok"


def test_state_feedback_of_states_that_are_not_measured_names_them():
    a = [[0.0, 1.0, 0.0], [-4.0, -1.0, 2.0], [0.0, 0.0, -10.0]]
    plant = {"kind": "state_space", "a": a, "b": [0.0, 0.0, 10.0], "c": [1.0, 0.0, 0.0]}
    loop = {"duration": 1.0, "sample_time": 0.01}
    table = {"plant": plant, "loop": loop, "disturbance": {"kind": "none"}}
    with pytest.raises(ConfigError, match="shows y and y', and the regulator feeds back all 3 states; add measures"):
        first_gains(buck(**table), "state_feedback", 5.0)
    found = first_gains(buck(**table, sensor={"measures": "state"}), "state_feedback", 5.0)
    assert len(found.table["signals"]) == 3


def boost_slopes(x, duty, load):
    """Slopes of current and voltage of an averaged boost converter of 12 V."""
    current, voltage = x
    return [(12.0 - 0.05 * current - (1.0 - duty) * voltage) / 5e-5, ((1.0 - duty) * current - voltage / load) / 2e-4]


def test_a_rate_with_the_last_command_is_no_state_to_feed_back():
    a = [[-1000.0, -10_000.0], [2500.0, -400.0]]
    plant = {"kind": "state_space", "a": a, "b": [5e5, -2e4], "c": [0.0, 1.0]}
    message = "shows y and y', which contain the last command, and the regulator feeds back all 2 states"
    with pytest.raises(ConfigError, match=message):
        first_gains(buck(plant=plant), "state_feedback", 5e3)


def test_a_start_where_the_terms_of_the_slope_cancel_is_an_equilibrium():
    duty, load = 0.5, 10.0
    voltage = 12.0 / (0.5 + 0.05 / (load * 0.5))
    start = jnp.array([voltage / (load * 0.5), voltage])

    def slope(x, u):
        return jnp.stack(boost_slopes(x, duty + u, load))

    with jax.enable_x64(True):
        assert np.max(np.abs(slope(start, 0.0))) > 0.0
        assert holding_command(slope, start) == pytest.approx(0.0, abs=1e-12)
        assert holding_command(slope, start * 1.001) is None


def test_the_equilibrium_with_an_output_is_that_of_the_closed_form():
    """With the duty d and no losses but those of the coil, V (1 - d + 0.05/(R (1 - d))) = 12."""
    load = 10.0
    start = jnp.array([1.0, 11.9])

    def slope(x, u):
        return jnp.stack(boost_slopes(x, u, load))

    with jax.enable_x64(True):
        x, duty = equilibrium(slope, lambda x, u: x[1], start, 24.0)
        share = 0.5 * (0.5 + np.sqrt(0.25 - 4.0 * 0.05 / load))
        assert 1.0 - duty == pytest.approx(share, rel=1e-9)
        assert x.tolist() == pytest.approx([24.0 / (load * share), 24.0], rel=1e-9)
        with pytest.raises(ConfigError, match="`at`: no equilibrium with the output 400 is found"):
            equilibrium(slope, lambda x, u: x[1], start, 400.0)
    with pytest.raises(ConfigError, match="`at`: is of a nonlinear plant"):
        first_gains(buck(), "pid", BANDWIDTH, at=5.0)


def test_a_negative_gain_is_told():
    plant = {"kind": "transfer_function", "numerator": [-2.0], "denominator": [1.0, 1.0]}
    table = buck(plant=plant, loop={"duration": 10.0, "sample_time": 0.01})
    for bandwidth in (None, 0.5, 5.0):
        with pytest.raises(ConfigError, match="plant: has a negative gain at rest"):
            first_gains(table, "pid", bandwidth)


def test_without_a_stated_bandwidth_none_is_blamed():
    """The plant has settled within a sample, and no weight of LQG brings its loop to cross 1 at a bandwidth."""
    plant = {"kind": "transfer_function", "numerator": [1e9], "denominator": [1.0, 1_001_000.0, 1e9]}
    with pytest.raises(ConfigError, match="plant: has no gains at any bandwidth tried from"):
        first_gains(buck(plant=plant, loop={"duration": 10.0, "sample_time": 0.01}), "lqg")


def test_the_pid_loop_of_a_first_order_lag_cancels_it():
    """k (s + 1/tau)/s: an integrator of the bandwidth, but for the half sample of the hold."""
    tau, gain, bandwidth = 3.0, 5.0, 0.2
    plant = {"kind": "transfer_function", "numerator": [gain], "denominator": [tau, 1.0]}
    table = buck(plant=plant, loop={"duration": 60.0, "sample_time": 0.01})
    law = first_gains(table, "pid", bandwidth).table
    assert law["k_i"] / law["k_p"] == pytest.approx(1.0 / tau, rel=5e-3)
    assert law["k_p"] == pytest.approx(bandwidth * tau / gain, rel=5e-3)


def test_an_integral_that_nothing_feeds_is_no_pole_of_the_loop():
    """A plant with a zero at rest gets no k_i, and the integral's eigenvalue of 1 is not the loop's."""
    plant = {"kind": "transfer_function", "numerator": [1.0, 0.0], "denominator": [1.0, 1.0, 4.0]}
    found = first_gains(buck(plant=plant, loop={"duration": 4.0, "sample_time": 0.01}), "pid", 20.0)
    assert "k_i" not in found.table
    assert found.radius < 1.0


@pytest.mark.parametrize("kind", ["pid", "lqg"])
def test_an_actuator_that_limits_earlier_limits_the_controller(kind):
    duty = [{"kind": "saturation", "low": 0.0, "limit": 0.75}, {"kind": "lag", "mu": 1e-6}]
    found = first_gains(buck(actuator=duty), kind, BANDWIDTH, 0.9)
    assert (found.table["low"], found.table["high"]) == (0.0, 0.75)
    found = first_gains(buck(actuator=duty), kind, BANDWIDTH, 0.5)
    assert (found.table["low"], found.table["high"]) == (0.0, 0.5)
