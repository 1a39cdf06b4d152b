"""The worst wind: flights against trajectories, the extreme wind against its optimality, the search against theory."""

import re

import jax
import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.analyses.worst_wind.ascent import Ascent
from dssc_jax.analyses.worst_wind.flights import WindFlights, WindGrid
from dssc_jax.analyses.worst_wind.wind_set import Limits, WindSet
from tests.tolerances import ROUNDING

CHANNELS = ("x", "y", "z", "psi")
SHORT = {"loop": {"duration": 10.0, "sample_time": 0.02}, "requirement": []}
L0 = 0.2
"""l_0 of every channel in hover_wind."""


@pytest.fixture(scope="module")
def hover():
    return dj.Study.load("studies/hover_wind.toml").override(SHORT)


@pytest.fixture(scope="module")
def winds():
    rng = np.random.default_rng(3)
    limits, grid = Limits(6.0, 3.0, None), WindGrid(0.5, 20, False)
    return WindSet(limits, grid).random_winds(3, rng)


def largest(flight, name):
    """The largest magnitude of a column of a trajectory."""
    return float(np.abs(flight[name].values).max())


def peaks(flight):
    """What a trajectory reaches at most, computed from its columns alone."""
    found = {}
    for channel in CHANNELS:
        rate = flight[f"{channel}_sigma"].values - L0 * flight[f"{channel}_e"].values
        found[f"error_max_{channel}"] = largest(flight, f"{channel}_e")
        found[f"error_rate_max_{channel}"] = float(np.abs(rate).max())
        found[f"sigma_max_{channel}"] = largest(flight, f"{channel}_sigma")
    thrusts = np.stack([flight[name].values for name in flight if re.fullmatch(r"rotor_\d+", str(name))])
    found["rotor_thrust_max"] = float(thrusts.max())
    found["rotor_thrust_min"] = float(thrusts.min())
    found["tilt_max"] = largest(flight, "tilt")
    return found


def test_flights_reach_what_their_trajectories_do(hover, winds):
    """Piecewise constant winds: each flight of the batch against the trajectory of one study."""
    flown = dj.fly_winds(hover, winds)
    assert (flown["outcome"] == 0).all()
    for index, wind in enumerate(winds):
        columns = dict(zip("xyz", wind.T.tolist(), strict=True))
        table = {"kind": "piecewise", "times": (0.5 * np.arange(20)).tolist(), **columns}
        expected = peaks(dj.simulate(hover.override({"wind": table})))
        assert set(expected) == set(flown.data_vars) - {"outcome"}
        for name, value in expected.items():
            assert float(flown[name][index]) == pytest.approx(value, rel=1e-9, abs=1e-12), name
    assert flown["error_max_x"].attrs == {"units": "m", "long_name": "largest |e|"}


def test_uncertain_numbers_have_their_medians_or_given_values(hover, winds):
    heavy = hover.override({"plant.vehicle": {"kind": "m600_quadrotor", "mass": {"uniform": [10.0, 12.0]}}})
    usual = dj.fly_winds(heavy, winds)["rotor_thrust_max"]
    given = dj.fly_winds(heavy, winds, {"plant.vehicle.mass": np.array([10.0, 11.0, 12.0])})["rotor_thrust_max"]
    assert float(given[1]) == float(usual[1])
    assert float(given[0]) < float(usual[0])
    assert float(given[2]) > float(usual[2])
    with pytest.raises(dj.ConfigError, match=r"plant\.vehicle\.masses: is no uncertain number"):
        dj.fly_winds(heavy, winds, {"plant.vehicle.masses": np.ones(3)})


def test_a_flight_that_ends_early_has_infinite_peaks(hover):
    """A storm that turns the vehicle over."""
    storm = np.zeros((2, 10, 3))
    storm[1, :, 0] = 500.0
    flown = dj.fly_winds(hover, storm)
    assert flown["outcome"].values.tolist() == [0, 2]
    assert float(flown["error_max_y"][1]) == np.inf
    assert float(flown["rotor_thrust_min"][1]) == -np.inf
    assert float(flown["error_max_y"][0]) < 1e-6


def test_winds_of_a_wrong_shape_are_refused(hover):
    with pytest.raises(dj.ConfigError, match="must have the shape"):
        dj.fly_winds(hover, np.zeros((2, 10)))
    with pytest.raises(dj.ConfigError, match="got 300 vectors, of which 250 would do"):
        dj.fly_winds(hover, np.zeros((2, 300, 3)))


@pytest.mark.parametrize("rate", [None, 2.0])
def test_random_winds_of_a_study_fly_within_its_bounds(hover, rate):
    """None of many random winds is worse than the one that the search finds."""
    study = hover if rate is None else hover.override({"wind.rate": rate})
    winds = dj.switching_winds(study, 500, segments=20)
    assert_within(winds, Limits(5.0, 2.5, rate), 0.5)
    flown = dj.fly_winds(study, winds, smooth=rate is not None)
    found = dj.worst_wind(study, signals=["error_max_x", "sigma_max_z"], segments=20, rounds=4)
    for answer in found.answer.signals:
        random = float(flown[answer.signal].max())
        assert 0.3 * answer.worst < random <= answer.worst


@pytest.mark.parametrize("rate", [None, 1.5])
def test_candidates_stay_within_the_bounds(rate):
    limits = Limits(4.0, 1.0, rate)
    winds = WindSet(limits, WindGrid(0.5, 40, rate is not None))
    for group in (winds.resonant_winds(), winds.random_winds(200, np.random.default_rng(0))):
        assert_within(group, limits, 0.5)
        assert np.hypot(group[..., 0], group[..., 1]).max() == pytest.approx(4.0)
        assert np.abs(group[..., 2]).max() == pytest.approx(1.0)


def assert_within(winds, limits, interval):
    assert np.hypot(winds[..., 0], winds[..., 1]).max() <= limits.speed * (1.0 + ROUNDING)
    assert np.abs(winds[..., 2]).max() <= limits.vertical * (1.0 + ROUNDING)
    if limits.rate is not None:
        changes = np.diff(winds, axis=1)
        most = limits.rate * interval * (1.0 + 1e-9)
        assert max(np.hypot(changes[..., 0], changes[..., 1]).max(), np.abs(changes[..., 2]).max()) <= most


@pytest.mark.parametrize("rate", [None, 1.5])
def test_the_extreme_wind_beats_all_others(rate):
    """Its product with the slopes exceeds that of every candidate and of random winds within the bounds."""
    rng = np.random.default_rng(1)
    limits = Limits(4.0, 1.0, rate)
    winds = WindSet(limits, WindGrid(0.5, 30, rate is not None))
    others = np.concatenate([winds.resonant_winds(), winds.random_winds(2000, rng)])
    for roughness in (1, 8):
        slopes = np.repeat(rng.normal(size=(1, -(-30 // roughness), 3)), roughness, axis=1)[:, :30]
        best = winds.extreme_winds(slopes, np.zeros((1, 30, 3)))
        assert_within(best, limits, 0.5)
        assert np.sum(slopes * best) > np.sum(slopes * others, axis=(1, 2)).max()


def test_without_a_rate_the_extreme_is_known_in_closed_form():
    winds = WindSet(Limits(5.0, 2.0, None), WindGrid(0.5, 3, False))
    slopes = np.array([[[3.0, -4.0, 0.1], [0.0, 0.0, -0.2], [0.0, 0.0, 0.0]]])
    present = np.full((1, 3, 3), 0.5)
    expected = [[[3.0, -4.0, 2.0], [0.5, 0.5, -2.0], [0.5, 0.5, 0.5]]]
    np.testing.assert_allclose(winds.extreme_winds(slopes, present), expected, rtol=ROUNDING)


def test_with_a_slow_rate_the_extreme_ramps():
    """One change of sign of the slope: a straight ramp around it at the bounded rate, vertically."""
    winds = WindSet(Limits(1.0, 3.0, 1.0), WindGrid(1.0, 20, True))
    slopes = np.zeros((1, 20, 3))
    slopes[0, :, 2] = np.where(np.arange(20) < 10, 1.0, -1.0)
    found = winds.extreme_winds(slopes, np.zeros((1, 20, 3)))[0, :, 2]
    ramp = np.clip(9.5 - np.arange(20.0), -3.0, 3.0)
    assert np.sum(slopes[0, :, 2] * found) == pytest.approx(np.sum(slopes[0, :, 2] * ramp), rel=1e-6)


SLIGHT = 0.004
"""A bound at which drag is almost linear in the wind [m/s]."""


def test_in_a_slight_wind_the_worst_is_the_sum_of_all_pulse_responses(hover):
    """Superposition: max |e_x(T)| over |w_x| <= W is the sum of the magnitudes of the responses to each part's pulse.

    The loop at rest does not depend on time: a later pulse has the response to the first one, later.
    """
    study = hover.override({"wind.speed": SLIGHT, "wind.vertical": 0.0})
    pulse = {"kind": "piecewise", "times": [0.0, 0.5], "x": [SLIGHT, 0.0], "y": [0.0, 0.0], "z": [0.0, 0.0]}
    response = np.abs(dj.simulate(study.override({"wind": pulse}))["x_e"].values)
    part = 25  # samples
    reached = sum(np.pad(response, (part * place, 0))[: len(response)] for place in range(20)).max()
    found = dj.worst_wind(study, signals=["error_max_x"], segments=20, rounds=8)
    assert found.answer.signals[0].worst == pytest.approx(reached, rel=0.01)


class Weak(Ascent):
    """A search that begins with weak winds only."""

    def first_winds(self):
        """Random turns at a tenth of the bound."""
        return [0.1 * self.winds.random_winds(64, self.rng)]


@pytest.mark.parametrize("rate", [None, 3.0])
def test_a_climb_reaches_the_worst_from_weak_winds(hover, rate):
    grid = WindGrid.of(hover, 20, rate is not None)
    flights = WindFlights(hover, grid, 2048)
    winds = WindSet(Limits(5.0, 2.5, rate), grid)
    signals = ["error_max_x", "tilt_max", "rotor_thrust_min"]
    full = Ascent(flights, winds, signals, 10, np.random.default_rng(0)).run()
    weak = Weak(flights, winds, signals, 10, np.random.default_rng(0)).run()
    for name in signals:
        sign = flights.signals[name].sign
        first, reached, best = (sign * value for value in (weak[name].candidate, weak[name].value, full[name].value))
        assert reached > first
        assert reached >= best - 0.03 * abs(best)
        assert_within(weak[name].point.winds, winds.limits, grid.interval)


def test_the_slopes_are_those_of_differences(hover):
    """The gradient by which a climb goes, of every signal, against central differences of flights."""
    grid = WindGrid.of(hover, 5, False)
    flights = WindFlights(hover, grid, 64)
    wind = WindSet(Limits(5.0, 2.5, None), grid).random_winds(1, np.random.default_rng(5))
    names = list(flights.signals)
    slopes = flights.with_slopes(np.repeat(wind, len(names), axis=0), {}, names).wind
    step = 1e-4
    for place, axis in ((0, 0), (1, 1), (2, 0), (3, 2)):
        shifted = np.repeat(wind, 2, axis=0)
        shifted[:, place, axis] += [step, -step]
        flown = flights(shifted, {})
        for row, name in enumerate(names):
            high, low = flown[name]
            expected = (high - low) / (2.0 * step)
            assert slopes[row, place, axis] == pytest.approx(expected, rel=1e-4, abs=1e-8), name


def test_vehicles_in_the_box_are_searched_too_and_the_flight_replays(hover):
    box = {"kind": "m600_quadrotor", "mass": {"uniform": [10.0, 12.0]}, "structure_drag": [{"uniform": [0.02, 0.06]},
           0.03, 0.015]}  # fmt: skip
    study = hover.override({"plant.vehicle": box, "plant.believed": {"mass": 10.9}})
    found = dj.worst_wind(study, signals=["rotor_thrust_max", "error_max_x"], segments=10, rounds=6)
    assert found.numbers("rotor_thrust_max")["plant.vehicle.mass"] == pytest.approx(12.0)
    assert found.numbers("error_max_x")["plant.vehicle.structure_drag.0"] == pytest.approx(0.06)
    for answer in found.answer.signals:
        replayed = peaks(dj.simulate(found.flight(answer.signal)))
        assert replayed[answer.signal] == pytest.approx(answer.worst, rel=1e-9)


def test_a_bounded_rate_is_kept_between_the_knots(hover):
    study = hover.override({"wind.rate": 2.0})
    found = dj.worst_wind(study, signals=["error_max_x"], segments=20, rounds=3)
    flight = found.flight("error_max_x")
    times = np.linspace(0.0, 10.0, 2001)
    params = flight.params({}).wind
    winds = np.stack(jax.vmap(lambda t: flight.loop.wind.value(params, (), t))(times), axis=-1)
    assert_within(winds[None], found.limits, times[1])
    replayed = peaks(dj.simulate(flight))["error_max_x"]
    assert replayed == pytest.approx(found.answer.signals[0].worst, rel=1e-9)
    free = dj.worst_wind(hover, signals=["error_max_x"], segments=20, rounds=3)
    assert replayed < free.answer.signals[0].worst


def test_all_signals_but_the_rates_are_searched_by_default(hover):
    found = dj.worst_wind(hover.override({"loop.duration": 2.0}), segments=4, rounds=0)
    kinds = {name.removesuffix(f"_{channel}") for name in found.signals for channel in CHANNELS}
    assert "error_rate_max" not in kinds
    assert len(found.signals) == 11
    assert found.slopes == 0
    for answer in found.answer.signals:
        assert answer.worst == answer.candidate
    with pytest.raises(dj.ConfigError, match="was not searched for"):
        found.flight("error_rate_max_x")


@pytest.mark.parametrize(
    ("changes", "options", "rule"),
    [
        ({"wind": {"kind": "dryden", "speed": 5.0, "altitude": 9.0, "airspeed": 5.0}}, {}, "wind.kind: .*no bounds"),
        ({"wind": {"kind": "none"}}, {}, "wind: never blows"),
        ({"wind.speed": {"uniform": [1.0, 2.0]}}, {}, r"wind\.speed: is uncertain"),
        ({}, {"signals": ["error_max_w"]}, "signals: unknown signal 'error_max_w'"),
        ({}, {"segments": 1}, r"segments: must be in 2 \.\. 400, got 1"),
        ({}, {"rounds": -1}, r"rounds: must be in 0 \.\. 1000, got -1"),
    ],
)
def test_what_cannot_be_searched_is_refused(hover, changes, options, rule):
    with pytest.raises(dj.ConfigError, match=rule):
        dj.worst_wind(hover.override(changes), **options)


@pytest.mark.parametrize(("count", "segments"), [(-1, 10), (3, 0), (3, -1)])
def test_random_winds_need_segments(hover, count, segments):
    with pytest.raises(dj.ConfigError, match="need a count >= 0 and segments >= 1"):
        dj.switching_winds(hover, count, segments=segments)


def test_a_plant_that_does_not_fly_is_refused(uncertain):
    with pytest.raises(dj.ConfigError, match="never blows"):
        dj.worst_wind(uncertain)
    with pytest.raises(dj.ConfigError, match="does not fly"):
        dj.fly_winds(uncertain, np.zeros((1, 2, 3)))
