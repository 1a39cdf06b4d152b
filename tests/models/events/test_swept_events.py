"""Swept, drawn and searched numbers of events pass the checks of plain ones."""

import pytest

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import extent
from tests.models.events.test_events import BASE

ROTOR = {"kind": "rotor", "rotor": 1, "at": 1.0}
DROP = {"kind": "payload", "mass": -1.0, "at": 1.0}


def refused(**changes):
    """The message that refuses a study."""
    with pytest.raises(ConfigError) as refusal:
        dj.Study.from_table(BASE | changes)
    return str(refusal.value)


@pytest.mark.parametrize(
    "law", [{"choice": [1, 2.5, 4]}, {"uniform": [1, 4]}, {"triangular": [1, 2, 4]}, {"normal": [3, 1]}]
)
def test_the_law_of_a_rotor_is_a_choice_of_whole_numbers(law):
    message = refused(event=[ROTOR | {"rotor": law}])
    assert "event.0.rotor: " in message
    if "normal" not in law:  # whose support is refused before
        assert "must be a whole number" in message
        assert "{ choice = [1, 2, 3] }" in message


def test_a_rotor_follows_from_a_choice_of_whole_numbers():
    event = [ROTOR | {"rotor": "=2*pair - 1"}]
    study = dj.Study.from_table(BASE | {"event": event, "parameters": {"pair": {"choice": [1, 2, 3]}}})
    assert extent(study.numbers["event.0.rotor"].value) == (1.0, 5.0)
    assert "must be a whole number" in refused(event=event, parameters={"pair": {"choice": [1, 1.25, 2]}})
    assert "must be a whole number" in refused(event=event, parameters={"pair": {"uniform": [1, 2]}})


@pytest.mark.parametrize(
    ("values", "rule"), [([1.0, 4.5, 6.0], "must be a whole number"), ([1.0, 8.0], "must be <= 6")]
)
def test_a_sweep_takes_existing_rotors_alone(values, rule):
    message = refused(event=[ROTOR], sweep={"event.0.rotor": values})
    assert "sweep.event.0.rotor" in message
    assert rule in message
    pair = {"event": [ROTOR | {"rotor": "=pair"}], "parameters": {"pair": 1.0}}
    assert rule in refused(**pair, sweep={"parameters.pair": values})
    assert dj.Study.from_table(BASE | {"event": [ROTOR], "sweep": {"event.0.rotor": [1.0, 6.0]}}).axes


def test_a_sweep_leaves_some_of_the_mass():
    masses = {"event.0.mass": [-13.0, -1.0]}
    assert "event.0.mass: must leave some of the vehicle's mass" in refused(event=[DROP], sweep=masses)
    heavy = [DROP | {"mass": -5.0}]
    assert "must leave some" in refused(event=heavy, sweep={"plant.vehicle.mass": [4.0, 10.0]})
    assert dj.Study.from_table(BASE | {"event": heavy, "sweep": {"plant.vehicle.mass": [6.0, 10.0]}}).axes
    loss = {"parameters": {"loss": -1.0}, "event": [DROP | {"mass": "=loss"}]}
    assert "must leave some" in refused(**loss, sweep={"parameters.loss": [-13.0, -1.0]})


def test_a_margin_walks_over_admissible_events_alone():
    rotor = dj.Study.from_table(BASE | {"event": [ROTOR]})
    with pytest.raises(ConfigError, match=r"event\.0\.rotor is a whole number; sweep it instead"):
        dj.margin(rotor, over="event.0.rotor", bounds=(1.0, 6.0))
    pair = dj.Study.from_table(BASE | {"event": [ROTOR | {"rotor": "=pair"}], "parameters": {"pair": 1.0}})
    with pytest.raises(ConfigError, match=r"parameters\.pair: .* event\.0\.rotor is a whole number"):
        dj.margin(pair, over="parameters.pair", bounds=(1.0, 6.0))
    drop = dj.Study.from_table(BASE | {"event": [DROP]})
    with pytest.raises(ConfigError, match="must leave some of the vehicle's mass"):
        dj.margin(drop, over="event.0.mass", bounds=(-1.0, -13.0))


def test_a_bare_kind_of_plant_is_swept():
    table = BASE | {"plant": {"kind": "uav"}, "event": [DROP | {"mass": -0.1}], "sweep": {"event.0.mass": [-0.1, 0.1]}}
    assert dj.Study.from_table(table).axes
