"""Entries of lists that a study leaves at their defaults, by dotted name."""

import pytest

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from dssc_jax.study.tables import merge_tables

AXIS = {
    "name": "axis",
    "draws": 2,
    "loop": {"duration": 0.5, "sample_time": 0.01},
    "plant": {"kind": "normal_form", "k_p": {"uniform": [0.8, 1.2]}},
    "controller": {"kind": "pid", "k_p": 6.0, "k_i": 2.0, "k_d": 3.0},
    "requirement": [{"metric": "error_max", "max": 0.4}],
}
VEHICLE = {
    "name": "vehicle",
    "loop": {"duration": 0.2, "sample_time": 0.01, "substeps": 4},
    "plant": {"kind": "uav", "vehicle": {"kind": "x500"}, "inner_loop": {"kind": "px4"}},
    "controller": {"kind": "pid", "k_p": 1.0, "k_d": 0.2},
    "reference": {"kind": "hover"},
}


def test_an_entry_is_set_and_the_others_keep_their_defaults():
    study = dj.Study.from_table(AXIS).override({"plant.initial.1": 0.5})
    assert [study.leaves()[f"plant.initial.{index}"] for index in range(2)] == [0.0, 0.5]
    study = dj.Study.from_table(study.table).override({"plant.initial.0": {"uniform": [0.1, 0.2]}})
    assert set(study.laws) == {"plant.k_p", "plant.initial.0"}
    assert study.leaves()["plant.initial.1"] == 0.5


def test_an_entry_is_swept_and_walked():
    study = dj.Study.from_table(AXIS)
    swept = dj.run(study.override({"sweep.plant.initial.0": [0.1, 0.3]})).dataset
    assert swept["error_max"].values.max(axis=-1) == pytest.approx([0.1, 0.3])
    walk = dj.margin(study, over="plant.initial.0", bounds=(0.1, 0.6), points=3, bisections=1)
    slack = walk.dataset["slack"].values[:, 0]
    assert slack[0] > 0.0
    assert slack[-1] < 0.0


@pytest.mark.parametrize(
    "name",
    [
        "plant.position.2",
        "plant.vehicle.body_inertia.0",
        "plant.vehicle.rotor.0.position.0",
        "plant.inner_loop.attitude_p.0",
    ],
)
def test_an_entry_of_a_vehicle_is_swept(name):
    study = dj.Study.from_table(VEHICLE)
    value = study.leaves()[name]
    assert isinstance(value, float)
    assert study.override({f"sweep.{name}": [value, 1.01 * value]}).axes == {name: (value, 1.01 * value)}
    changed = study.override({name: value + 0.001}).leaves()
    assert changed == study.leaves() | {name: value + 0.001}


def test_a_channel_changes_an_entry_of_the_common_list():
    controller = {"kind": "discrete_transfer_function", "numerator": [3.0, -2.9], "denominator": [1.0, -0.5]}
    study = dj.Study.from_table({**VEHICLE, "controller": controller}).override({"controller.z.numerator.0": 4.0})
    numbers = study.leaves()
    assert [numbers["controller.numerator.0"], numbers["controller.z.numerator.0"]] == [3.0, 4.0]
    assert "controller.z.numerator.1" not in numbers
    with pytest.raises(
        ConfigError, match=r"study: controller.z.numerator: has 2 entries, whose indices are 0 to 1; got"
    ):
        study.override({"controller.z.numerator.7": 4.0})


def test_an_index_beyond_the_default_list_is_refused():
    with pytest.raises(ConfigError) as caught:
        dj.Study.from_table(AXIS).override({"plant.initial.2": 0.5})
    assert str(caught.value) == "study: plant.initial: has 2 entries, whose indices are 0 to 1; got '2'"


def test_an_index_beyond_a_list_in_an_inherited_table_is_named_with_its_whole_path():
    common = {"model": {"kind": "stated", "a": [1.0, 2.0]}}
    assert merge_tables(common, {"model": {"a": {"1": 3.0}}}) == {"model": {"kind": "stated", "a": [1.0, 3.0]}}
    with pytest.raises(ConfigError) as caught:
        merge_tables(common, {"model": {"a": {"7": 3.0}}})
    assert str(caught.value) == "model.a: has 2 entries, whose indices are 0 to 1; got '7'"


def test_an_entry_of_another_kind_replaces_a_table_in_a_list():
    common = {"parts": [{"kind": "lag", "mu": 0.1}]}
    assert merge_tables(common, {"parts": {"0": {"mu": 0.2}}}) == {"parts": [{"kind": "lag", "mu": 0.2}]}
    delay = {"kind": "delay", "samples": 1.0}
    assert merge_tables(common, {"parts": {"0": delay}}) == {"parts": [delay]}


def test_an_entry_of_an_empty_list_is_refused_with_the_remedy():
    plant = {"kind": "state_space", "a": [[-1.0]], "b": [1.0], "c": [1.0]}
    study = dj.Study.from_table({**AXIS, "plant": plant})
    with pytest.raises(ConfigError, match=r"if plant\.x0 is a list that is empty, state it in the study first"):
        study.override({"sweep.plant.x0.0": [0.2, 1.4]})
    with pytest.raises(ConfigError, match=r"plant\.x0: has no entry by default; state the list in the study first"):
        study.override({"plant.x0.0": 0.2})


def test_an_element_has_the_unit_of_its_place():
    zero_dynamics = {"a": [2.0, 1.0], "c": [0.2, 0.1]}
    study = dj.Study.from_table(AXIS).override(
        {"plant.initial": [0.1, {"uniform": [0.0, 0.1]}, 0.0, 0.2], "plant.zero_dynamics": zero_dynamics}
    )
    assert [study.quantities[f"plant.initial.{index}"].unit for index in range(4)] == ["m", "m/s", "SI", "SI"]
    with pytest.raises(dj.ConfigError, match=r"plant\.initial: must be a finite number \(.*\[y/s\]\)"):
        study.override({"plant.initial": [0.1, "fast"]})
