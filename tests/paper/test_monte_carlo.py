"""The Monte Carlo behind Fig. 5: same draws for all, a lane is a flight, lost flights are the worst."""

import numpy as np
import pytest

import dssc_jax as dj
from benchmarks.paper import monte_carlo, search
from benchmarks.paper.loops import AXES, RHO, TAU_AV, comparison, sta
from benchmarks.paper.monte_carlo import Flights

COUNT = 3


@pytest.fixture(scope="module")
def values():
    return monte_carlo.drawn(COUNT)


@pytest.fixture(scope="module")
def pair():
    return search.studies({})


def flights(swing, lost=None):
    swing = np.asarray(swing, dtype=float)
    return Flights(np.zeros(len(swing), bool) if lost is None else np.asarray(lost), swing, 2.0 * swing)


def test_kappa_1_is_one_number_for_both(values):
    dssc = comparison(**{"plant.vehicle.motor_lag": 0.02})
    own = monte_carlo.columns(dssc, values)
    other = monte_carlo.columns(dssc.override({"controller": sta()}), values)
    for place, axis in (("", "x"), ("z.", "z"), ("psi.", "psi")):
        kappa_o = own[f"controller.{place}functions.kappa_o"]
        np.testing.assert_allclose(2.0 / (kappa_o * TAU_AV[axis]), other["controller.kappa1"])
    assert {name for name in own if name.startswith("plant.")} == {name for name in other if name.startswith("plant.")}


def test_rotors_without_lag_have_none_to_draw(values, pair):
    found = monte_carlo.columns(pair[0], values)
    assert "plant.vehicle.motor_lag" not in found
    assert "plant.vehicle.mass" in found


def test_a_number_that_the_loop_lacks_is_an_error(values, pair):
    with pytest.raises(KeyError, match="wingspan"):
        monte_carlo.columns(pair[0], {**values, "plant.wingspan": values["kappa1"]})


def test_a_lane_is_the_flight_of_its_numbers(values):
    study = comparison(**{"loop.duration": 36.0, "plant.vehicle.motor_lag": 0.02})
    columns = monte_carlo.columns(study, values)
    found = monte_carlo.fly(study, columns, COUNT)
    assert not found.lost.any()
    position = [float(columns[f"plant.position.{i}"][1]) for i in range(3)]
    inertia = [float(columns[f"plant.vehicle.body_inertia.{i}"][1]) for i in range(3)]
    plain = {name: float(column[1]) for name, column in columns.items() if not name[-1].isdigit()}
    believed = {"mass": 10.9, "inertia": [0.44, 0.44, 0.74002]}
    run = dj.simulate(
        study.override(
            {**plain, "plant.position": position, "plant.vehicle.body_inertia": inertia, "plant.believed": believed}
        )
    )
    swing = 2.0 * np.pi / 40.0
    ahead = 20.0 * swing * np.cos(swing * run["t"].values) - 20.0 * swing**2 * np.sin(swing * run["t"].values)
    exact = monte_carlo.oscillation(run["x_u_total"].values - ahead, 0.005, monte_carlo.SMOOTH)
    assert found.swing[1, 0] == pytest.approx(exact, rel=1e-6)


def test_oscillation_of_a_known_signal():
    t = np.arange(0.0, 60.0, 0.005)
    signal = np.stack([0.3 * np.sin(7.0 * t) + 0.02 * t, 0.3 * np.sin(2.0 * np.pi * t / 8.0)])
    fast, slow = (monte_carlo.oscillation(signal, 0.005, period) for period in (2.0, 10.0))
    assert fast[0] == pytest.approx(0.3 / np.sqrt(2.0), rel=0.1)
    assert fast[1] < 0.15 * slow[1]
    assert slow[1] == pytest.approx(0.3 / np.sqrt(2.0), rel=0.25)


def test_lost_is_worst():
    one = flights([[0.1] * 4, [0.1] * 4, [0.1] * 4, [0.6] * 4], [False, True, False, False])
    other = flights([[1.0] * 4, [1.0] * 4, [0.0] * 4, [1.0] * 4], [False, False, True, False])
    np.testing.assert_array_equal(monte_carlo.calmer(one, other)[:, 0], [True, False, True, False])


def test_tables_and_ranks():
    """A ratio that falls with kappa_m and with nothing else."""
    values = monte_carlo.drawn(64)
    one, other = flights(np.tile(1.0 / values["kappa_m"][:, None], 4)), flights(np.ones((64, 4)))
    ranks = monte_carlo.ranks(values, one, other)
    assert ranks["kappa_m"] == pytest.approx(-1.0)
    assert max(abs(rank) for name, rank in ranks.items() if name != "kappa_m") < 0.5
    names = ("DSSC", "DSSC, rho = 100", "DSSC, 1/tau_m in u_n")
    flown = {**{("", name): one for name in names}, ("", "STA clipped"): other}
    rows = monte_carlo.class_rows(values, flown)
    assert [row[4].split()[0] for row in rows[:3]] == ["0.00"] * 3
    assert sum(int(row[1]) for row in rows) == 64
    assert [row[-1] for row in monte_carlo.setup_rows(flown)][-1] == ""


def test_setups_share_their_numbers_with_a_loop(pair):
    """A name that neither controller's loop has would change nothing, silently."""
    leaves = {name for study in pair for name in study.leaves()}
    assert {name for setup in search.SETUPS.values() for name in setup.numbers} <= leaves


def test_setups_are_silent_about_the_rest(pair):
    study, other = pair
    setups = [search.Setup({}), search.Setup({search.KAPPA_M: 1.0, "controller.kappa2": 50.0})]
    np.testing.assert_allclose(search.stacked(study, setups)[search.KAPPA_M], [0.006025, 1.0])
    assert {name: list(column) for name, column in search.stacked(other, setups).items()} == {
        "controller.kappa2": [100.0, 50.0]
    }


def test_like_figure_5():
    rho = np.array([list(RHO.values())])
    calm, loud = flights(0.05 * rho), flights(rho * [1.0, 1.0, 0.01, 0.2])
    assert search.like_figure_5(calm, loud) == "x, y, psi"
    assert search.like_figure_5(loud, loud) == "no"
    assert search.like_figure_5(flights(rho, [True]), loud) == "no"
    assert tuple(RHO) == AXES


def test_one_degree_of_freedom_keeps_the_controller(pair):
    for study in pair:
        alone = search.single(study, 0.1)
        assert alone.loop.channels == ("",)
        assert alone.leaves()["controller.l0"] == 0.2
        bound = "controller.limit" if study.table["controller"]["kind"] == "sta" else "controller.rho"
        assert alone.leaves()[bound] == RHO["x"]
