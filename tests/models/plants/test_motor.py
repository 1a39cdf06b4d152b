"""The study of the motor: its numbers are the tutorial's, and its linear plant is of the class."""

import numpy as np
import pytest
from scipy import signal

import dssc_jax as dj
from dssc_jax.core.normal_form import RealisedSystem, normal_form, transfer_function
from dssc_jax.design.certification import mark
from dssc_jax.models.plants.linear import nominal_values

J, DAMPING, K, R, L = 0.01, 0.1, 0.01, 1.0, 0.5


@pytest.fixture(scope="module")
def motor():
    return dj.Study.load("studies/motor.toml")


def test_its_medians_are_the_tutorials(motor):
    plant = motor.template.plant
    system = RealisedSystem(*(nominal_values(part) for part in (plant.a, plant.b, plant.c)))
    expected = [[-DAMPING / J, K / J], [-K / L, -R / L]]
    np.testing.assert_allclose(np.array(system.a), expected, rtol=0.06)  # laws are symmetric about a rounded middle
    numerator, denominator = [K], np.polyadd(np.polymul([J, DAMPING], [L, R]), [K * K])
    a, b, c, _ = signal.tf2ss(numerator, denominator)
    found = transfer_function(RealisedSystem(tuple(map(tuple, expected)), (0.0, 1.0 / L), (1.0, 0.0)))
    np.testing.assert_allclose(found[0], signal.ss2tf(a, b, c, [[0.0]])[0][0][2:], rtol=1e-9)
    form = normal_form(numerator, denominator)
    assert form.obstacle == ""
    numbers = [form.gain, form.damping, form.stiffness]
    assert numbers == pytest.approx([K / (J * L), DAMPING / J + R / L, (DAMPING * R + K * K) / (J * L)])
    assert numbers == pytest.approx([2.0, 12.0, 20.02])  # docs/motor.md
    assert "uncertain" in mark(motor).reason


def test_units_everywhere(motor):
    assert motor.quantities["controller.k_p"].unit == "V s/rad"
    assert motor.quantities["reference.size"].unit == "rad/s"
    assert [requirement.measure.unit for requirement in motor.requirements] == ["%", "s", "rad/s", "rad/s"]


def test_pid_and_dssc_on_the_same_motors(motor):
    contest = dj.compare(motor.override({"draws": 64}), ["pid", "dssc"], candidates=0)
    assert list(contest.dataset["controller"].values) == ["pid", "dssc"]
    alone = dj.run(motor.override({"draws": 64}))
    np.testing.assert_array_equal(contest.dataset["failed"].sel(controller="pid"), alone.failed)
    assert 0 < int(contest.dataset["failed"].sel(controller="dssc").sum()) < 32
