"""Sliders: scales, limits, and the study that their positions describe."""

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.core.quantities import Quantity
from dssc_jax.exploration.positions import slider_positions, study_changes
from dssc_jax.exploration.sliders import admissible_sliders, scale_around, sliders_of
from dssc_jax.study.laws import LAWS as FAMILIES
from dssc_jax.study.laws import Law

LAWS = [
    Law("uniform", (0.8, 1.6)),
    Law("loguniform", (0.01, 1.0)),
    Law("normal", (2.0, 0.5)),
    Law("truncated_normal", (1.0, 0.4, 0.5, 3.0)),
    Law("lognormal", (0.3, 0.7)),
    Law("beta", (2.0, 5.0)),
    Law("beta", (2.0, 5.0, 1.0, 3.0)),
    Law("triangular", (0.0, 1.0, 4.0)),
]


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_a_moved_law_moves_its_values(law):
    """Quantiles move as the definition says, whatever the family."""
    level, median, share = np.linspace(0.01, 0.99, 21), 1.7, 0.6
    original, moved = law.quantile(level), law.moved(median, share).quantile(level)
    if law.logarithmic:
        expected = median * (original / law.median) ** share
    else:
        expected = median + share * (original - law.median)
    np.testing.assert_allclose(moved, expected, rtol=1e-12)


def test_what_cannot_be_moved():
    assert {law.kind for law in LAWS} == {kind for kind, family in FAMILIES.items() if family.roles}
    with pytest.raises(ValueError, match="a choice has no width"):
        Law("choice", (1.0, 2.0)).moved(1.0, 1.0)
    with pytest.raises(ValueError, match="median > 0"):
        Law("loguniform", (0.1, 1.0)).moved(-1.0, 1.0)


@pytest.mark.parametrize(
    ("value", "quantity", "expected"),
    [
        (2.0, Quantity("s", "a time", above=0.0), (0.2, 20.0, True)),
        (0.0, Quantity("1", "any"), (-1.0, 1.0, False)),
        (-3.0, Quantity("1", "any"), (-9.0, 3.0, False)),
        (0.5, Quantity("1", "a share", at_least=0.0, at_most=1.0), (0.05, 1.0, True)),
        (0.0, Quantity("1", "a magnitude", at_least=0.0), (0.0, 1.0, False)),
    ],
)
def test_scales(value, quantity, expected):
    assert scale_around(value, quantity) == expected


def test_ends_outside_are_not_reached():
    low, high, _ = scale_around(0.9, Quantity("1", "a share", above=0.0, below=1.0))
    assert 0.0 < low < 0.9 < high < 1.0


def test_positions(explored):
    """Every grid is increasing and contains the ends and the study's own value."""
    for slider in sliders_of(explored):
        values = slider_positions(slider)
        assert list(values) == sorted(set(values))
        assert {slider.low, slider.start, slider.high} <= set(values)


def test_the_study_s_own_value_is_a_position_whatever_its_digits():
    """kappa_o = 110.651 has the text 110.7, and so has no second position of that text."""
    study = dj.Study.load("mu_robustness")
    slider = sliders_of(study, ["controller.functions.kappa_o"])[0]
    values = slider_positions(slider)
    assert 110.651 in values
    assert len({f"{value:.4g}" for value in values}) == len(values)


def test_a_study_is_as_its_sliders_stand(explored):
    by_key = {slider.key: slider for slider in sliders_of(explored)}
    assert study_changes(explored, {slider: slider.start for slider in by_key.values()}) == {}
    positions = {"controller.l0": 2.0, "plant.k_p (width)": 0.5, "loop.sample_time": 0.04}
    moved = explored.override(study_changes(explored, {by_key[key]: value for key, value in positions.items()}))
    assert moved.leaves()["controller.l0"] == 2.0
    np.testing.assert_allclose(moved.laws["plant.k_p"].arguments, (0.85, 1.15))
    assert moved.loop.sample_time == 0.04


def test_sample_times_divide_the_duration(explored):
    times = slider_positions(sliders_of(explored, ["loop.sample_time"])[0])
    assert times == (0.005, 0.01, 0.02, 0.04, 0.08)
    for time in times:
        explored.override({"loop.sample_time": time})


def test_names(explored):
    assert [s.key for s in sliders_of(explored, ["controller.rho"])] == ["controller.rho"]
    with pytest.raises(dj.ConfigError, match=r"did you mean 'controller.rho'"):
        sliders_of(explored, ["controller.roh"])


def test_a_swept_number_moves_along_its_axis(explored):
    swept = explored.override({"sweep": {"controller.rho": [3.0, 9.0], "unmodelled.mu": [0.01, 0.3]}})
    rho, mu = sliders_of(swept)[:2]
    assert (rho.name, rho.low, rho.start, rho.high) == ("controller.rho", 3.0, 6.0, 9.0)
    assert (mu.low, mu.start, mu.high) == (0.01, 0.02, 0.3)


def test_rules_between_numbers_narrow_a_slider(explored):
    """A rate limit's sliders may be anything; those of a saturating PID with lo < hi may not cross."""
    law = explored.override({"disturbance": {"kind": "sine", "amplitude": 0.2, "period": 3.0}})
    assert [s.key for s in admissible_sliders(law, sliders_of(law))] == [s.key for s in sliders_of(law)]


def test_a_vehicle_begins_with_few_numbers():
    """Mass, rotor lag, wind, noise, two gains and the sample time, one slider each; any number by its name."""
    study = dj.Study.load("uav_robustness")
    keys = [slider.key for slider in sliders_of(study.without_sweep())]
    assert keys == [
        "plant.vehicle.mass (median)",
        "plant.vehicle.motor_lag (median)",
        "wind.speed (median)",
        "sensor.position_std",
        "controller.functions.kappa_o",
        "controller.functions.kappa_m",
        "loop.sample_time",
    ]
    swept = [slider.key for slider in sliders_of(study)]
    assert swept[0] == "plant.vehicle.motor_lag"
    assert len(swept) == 7
    named = [slider.key for slider in sliders_of(study, ["plant.vehicle.mass"])]
    assert named == ["plant.vehicle.mass (median)", "plant.vehicle.mass (width)"]
