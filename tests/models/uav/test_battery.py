"""The battery: its equations by bisection, a flight's charge from its rotors' speeds, and what refuses it."""

import numpy as np
import pytest
from scipy.optimize import brentq

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from dssc_jax.design.certification import NotCovered
from dssc_jax.models.uav.battery import Battery, supply

BATTERY = {
    "capacity": 3600.0,
    "resistance": 0.05,
    "full_voltage": 25.2,
    "empty_voltage": 19.8,
    "efficiency": 0.7,
    "charge": 0.9,
}
DURATION = 12.0


def study_of(**battery):
    """A vehicle that hovers on a battery."""
    return dj.Study.from_table(
        {
            "name": "battery",
            "draws": 1,
            "loop": {"duration": DURATION, "sample_time": 0.01},
            "plant": {"kind": "uav", "position": [0.0, 0.0, 5.0], "vehicle": "m600", "battery": BATTERY | battery},
            "reference": {"kind": "hover", "position": [0.0, 0.0, 5.0]},
            "controller": {"kind": "pid", "k_p": 1.0, "k_i": 0.5},
            "metrics": {"names": ["error_max"]},
        }
    )


@pytest.mark.parametrize("charge", [1.0, 0.3, 0.0, -5.0])
@pytest.mark.parametrize("power", [0.0, 50.0, 2000.0])
def test_voltage_and_current_obey_the_circuit(charge, power):
    battery = Battery(**BATTERY)
    rest = 19.8 + 5.4 * charge if charge > 0.0 else 0.0
    voltage, current = (float(value) for value in supply(battery, charge, power))

    def balance(r):
        current = 0.0 if r == 0.0 else power * r**2 / 25.2
        return rest - 0.05 * current - 25.2 * r

    expected = brentq(balance, -0.1, 1.1, xtol=1e-15)
    assert voltage == pytest.approx(expected, abs=1e-12)
    assert voltage * 25.2 * current == pytest.approx(power * voltage**3, rel=1e-12, abs=1e-12)


def test_a_flight_takes_the_charge_that_its_rotors_need():
    study = study_of()
    flight = dj.simulate(study)
    vehicle = study.template.plant.vehicle
    rotors = range(1, vehicle.rotors + 1)
    speeds = np.stack([flight[f"rotor_speed_{rotor}"].values for rotor in rotors])
    power = np.sum(abs(vehicle.torque_coefficient) * vehicle.thrust_coefficient * speeds**3, axis=0) / 0.7
    charge = flight["battery_charge"].values
    rest = 19.8 + 5.4 * charge
    voltage = 0.5 * (rest + np.sqrt(rest**2 - 4.0 * 0.05 * power))  # V = V_0 - R P/V
    np.testing.assert_allclose(flight["rotor_voltage"], voltage / 25.2, rtol=1e-9)
    taken = (
        np.concatenate([[0.0], np.cumsum(0.5 * (power / voltage)[1:] + 0.5 * (power / voltage)[:-1])]) * 0.01 / 3600.0
    )
    assert taken[-1] > 0.05
    np.testing.assert_allclose(0.9 - charge, taken, rtol=1e-4, atol=1e-6)
    hovering = np.sqrt(float(vehicle.mass) * 9.81 / vehicle.rotors / vehicle.thrust_coefficient)
    assert speeds.mean() == pytest.approx(hovering, rel=0.01)


def test_with_an_empty_battery_the_vehicle_falls():
    """From the sample on at which no charge is left, the height is that of a free fall."""
    flight = dj.simulate(study_of(capacity=250.0))
    charge = flight["battery_charge"].values
    empty = int(np.argmax(charge <= 0.0))
    assert 0 < empty < len(charge) - 150
    np.testing.assert_array_equal(charge[empty:], charge[empty])
    assert charge[empty] > -0.01
    np.testing.assert_array_equal(flight["rotor_voltage"][empty:], 0.0)
    first = empty + 50  # rotors have a lag
    fall = flight["z_y_dot"].values[first : first + 100] - flight["z_y_dot"].values[first]
    np.testing.assert_allclose(fall, -9.81 * 0.01 * np.arange(100), rtol=0.02)  # and some drag


@pytest.mark.parametrize("scale", [1.0, 0.3])
def test_a_hover_power_is_taken_whatever_the_scale_of_the_coefficients(scale):
    """A rotor's k_T and c_tau set the speeds alone: the battery gives 900 W in hover."""
    table = study_of().table
    hovering = BATTERY | {"hover_power": 900.0}
    del hovering["efficiency"]
    nominal = {"kind": "m600", "thrust_coefficient": scale * 2.8e-4, "rotor_coefficients": "nominal"}
    study = dj.Study.from_table(table | {"plant": table["plant"] | {"vehicle": nominal, "battery": hovering}})
    flight = dj.simulate(study)
    charge = flight["battery_charge"].values
    current = -3600.0 * np.gradient(charge, 0.01)
    power = current * 25.2 * flight["rotor_voltage"].values
    assert power[400:-1].mean() == pytest.approx(900.0, rel=0.01)


def test_a_power_from_nominal_coefficients_is_refused():
    """A vehicle of the package has its own, and its study is as before."""
    nominal = {"plant.vehicle": {"kind": "m600", "rotor_coefficients": "nominal"}}
    with pytest.raises(ConfigError, match=r"battery: needs hover_power in watts in place of efficiency"):
        study_of().override(nominal)
    with pytest.raises(ConfigError, match=r"battery: needs either efficiency, or hover_power in watts"):
        study_of(hover_power=900.0)


def test_what_a_battery_excludes():
    with pytest.raises(ConfigError, match=r"battery\.empty_voltage: must be below full_voltage = 25\.2, got up to 26"):
        study_of(empty_voltage=26.0)
    with pytest.raises(ConfigError, match="has a battery, which is never at rest"):
        dj.loop_margins(study_of())
    with pytest.raises((NotCovered, ConfigError), match="battery"):
        dj.prove(study_of())
