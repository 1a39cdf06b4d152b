"""The figure of a flight: path, attitude and thrust of a vehicle; channels that hold rounding noise are left out."""

import io

import numpy as np
import pytest
import xarray as xr

from dssc_jax.plotting import trajectory

T = np.linspace(0.0, 20.0, 401)


@pytest.fixture
def flown():
    """A circle flown with an error in x and y, at a constant height that is kept to rounding."""
    ref = {"x": 5.0 * np.cos(T), "y": 5.0 * np.sin(T), "z": np.full_like(T, 10.0), "psi": np.zeros_like(T)}
    error = {"x": 0.3 * np.exp(-T), "y": 0.1 * np.sin(T), "z": 2e-15 * np.sin(T), "psi": 0.2 * np.exp(-T)}
    columns = {}
    for name in ref:
        unit = "rad" if name == "psi" else "m"
        u = 1e-15 * np.cos(T) if name == "z" else np.cos(T)
        signals = {"y": ref[name] + error[name], "y_ref": ref[name], "e": error[name], "u": u, "u_total": u}
        columns |= {f"{name}_{each}": ("t", values, {"units": unit}) for each, values in signals.items()}
    own = {"phi": 0.1 * np.sin(T), "theta": 0.2 * np.cos(T), "thrust": 100.0 + T, "rotor_limited": (T > 15.0) * 1.0}
    own |= {f"rotor_{i}": np.minimum(25.0 + T / 4.0 + 0.1 * i, 28.75) for i in range(1, 7)}
    own |= {"rotor_limit": np.full_like(T, 28.75), "wind_x": np.where(T < 5.0, 0.0, 4.0)}
    own |= dict.fromkeys(("wind_y", "wind_z"), np.zeros_like(T))
    columns |= {name: ("t", values, {"units": "1"}) for name, values in own.items()}
    return xr.Dataset(columns, coords={"t": T}, attrs={"study": "circle", "draw": 3, "verdict": "meets all"})


def test_the_flight(flown):
    figure = trajectory(flown)
    space, above, attitude, rotors, wind, lift, *rows = figure.axes
    assert space.name == "3d"
    assert above.lines[1].get_xdata()[0] == pytest.approx(5.3)
    assert np.max(attitude.lines[0].get_ydata()) == pytest.approx(np.degrees(0.1), rel=1e-3)
    assert [text.get_text() for text in rotors.get_legend().get_texts()] == [*"123456", "one at its limit", "limit"]
    assert [text.get_text() for text in wind.get_legend().get_texts()] == ["x", "onset at 5 s"]
    assert lift.get_ylabel() == "wanted thrust [N]"
    assert [ax.get_ylabel().partition(":")[0] for ax in rows] == ["x", "x", "y", "y", "psi", "psi"]
    assert "not shown: z, whose error and command are rounding noise" in figure._suptitle.get_text()
    figure.savefig(io.BytesIO(), format="png")


def test_without_wind_there_is_no_wind(flown):
    """The limit of rotors that stay far below is a number, not a line."""
    calm = flown.assign(wind_x=0.0 * flown["wind_x"], rotor_limit=0.0 * flown["rotor_limit"] + 60.0)
    _, _, _, rotors, lift, *_ = trajectory(calm.assign(rotor_limited=0.0 * flown["rotor_limited"])).axes
    assert rotors.get_ylabel() == "rotor thrust [N]\n(limit 60)"
    assert lift.get_ylabel() == "wanted thrust [N]"


def test_a_draw_that_ended_early_is_drawn_up_to_its_end(flown):
    trajectory(flown.where(flown["t"] < 7.0)).savefig(io.BytesIO(), format="png")


def test_without_a_vehicle_there_is_no_path(flown):
    two = flown[[name for name in flown if str(name).startswith(("x_", "psi_"))]]
    assert len(trajectory(two).axes) == 4
