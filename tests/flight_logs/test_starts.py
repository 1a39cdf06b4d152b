"""What a fit says of a study that begins in the air."""

import pytest

import dssc_jax as dj
from dssc_jax.flight_logs.fit import wind_doubts
from dssc_jax.flight_logs.starts import begins_in_air

WIND = [{"kind": "constant", "x": 3.0, "y": 0.0, "z": 0.0}]
RISING = {"velocity_integral": [0.0, 0.0, 1.5]}
UNCERTAIN = {"velocity_integral": [0.0, 0.0, {"normal": [0.0, 1.0]}]}


def study(inner_loop, wind):
    """An X500 on PX4's cascade."""
    return dj.Study.from_table(
        {
            "name": "start",
            "draws": 4,
            "loop": {"duration": 1.0, "sample_time": 0.02, "substeps": 16},
            "controller": {"kind": "pid", "k_p": 1.0},
            "plant": {"kind": "uav", "inner_loop": {"kind": "px4", **inner_loop}, "vehicle": {"kind": "x500"}},
            **({"wind": wind} if wind else {}),
        }
    )


@pytest.mark.parametrize(
    ("inner_loop", "in_air"), [({}, False), ({"start": "settled"}, True), (RISING, True), (UNCERTAIN, True)]
)
@pytest.mark.parametrize("wind", [[], WIND])
def test_a_start_in_the_air_in_wind_is_doubted(inner_loop, in_air, wind):
    chosen = study(inner_loop, wind)
    assert begins_in_air(chosen) == in_air
    told = "".join(doubt.text for doubt in wind_doubts(chosen))
    assert ("a vehicle in wind is tilted" in told) == (in_air and bool(wind))
