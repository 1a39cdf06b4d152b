"""An outage from the first sample on shows the sensor's first reading, with its errors."""

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.core.events import Wrapped
from dssc_jax.models.events.sensor_outage import SENSOR_OUTAGE
from dssc_jax.models.sensors import IDEAL
from dssc_jax.models.sensors.noisy import NOISY, NoisyParams
from tests.models.events.test_events import BASE

PLANT = {"kind": "uav", "vehicle": "m600", "position": [0.3, 0.0, 0.0], "velocity": [0.5, 0.0, 0.0]}
SENSORS = (
    {"kind": "noisy", "position_bias": 0.2, "velocity_bias": 0.1, "delay_samples": 2},
    {"kind": "noisy", "position_std": 0.1, "velocity_std": 0.1},
    {"kind": "noisy", "position_resolution": 0.25},
    {"kind": "ideal"},
)


def readings(sensor, *events):
    """Readings of y and y' of channel x."""
    table = BASE | {
        "plant": PLANT,
        "sensor": sensor,
        "event": list(events),
        "loop": {"duration": 0.5, "sample_time": 0.01},
    }
    run = dj.simulate(dj.Study.from_table(table))
    return np.stack([run["x_y_measured"].values, run["x_y_dot_measured"].values])


@pytest.mark.parametrize("sensor", SENSORS, ids=str)
@pytest.mark.parametrize("at", [0.0, 0.1])
def test_an_outage_shows_the_last_reading_or_the_first_one(sensor, at):
    outage = {"kind": "sensor_outage", "at": at, "duration": 0.2, "channel": "x"}
    found = readings(sensor, outage)
    plain = readings(sensor)
    begin = round(at / 0.01)
    shown = plain[:, max(begin - 1, 0)]
    np.testing.assert_array_equal(found[:, begin : begin + 20], np.tile(shown[:, None], 20))
    assert np.all(found[:, :begin] == plain[:, :begin])
    assert not np.array_equal(found[:, begin + 20 :], np.tile(shown[:, None], 50 - begin - 20))


def test_a_sensor_with_an_outage_rounds_as_without():
    params = NoisyParams(position_resolution=0.1)
    event = SENSOR_OUTAGE.params(at=1.0, duration=0.2)
    assert SENSOR_OUTAGE.wrap(NOISY).resolution(Wrapped(params, event)) == 0.1
    assert SENSOR_OUTAGE.wrap(IDEAL).resolution(Wrapped(IDEAL.params(), event)) is None
