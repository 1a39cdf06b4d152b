"""The study of one draw: it flies as it did among all draws, whatever follows from nominal numbers."""

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.study.known_draws import study_of_draw
from dssc_jax.study.laws import Law, parse_law
from dssc_jax.study.tables import to_toml
from tests.conftest import UNCERTAIN
from tests.models.uav.test_cascades import study_of

SPRING = {
    "name": "spring",
    "draws": 40,
    "seed": 5,
    "parameters": {"k": {"uniform": [5.0, 20.0], "unit": "N/m"}, "d": {"value": "=0.02*k"}},
    "loop": {"duration": 3.0, "sample_time": 0.02},
    "plant": {"kind": "state_space", "a": [[0.0, 1.0], ["=-k", "=-d"]], "b": [0.0, 1.0], "c": [1.0, 0.0], "x0": [0.3]},
    "controller": {"kind": "lqg", "command_weight": 0.01, "state_weights": [10.0, 1.0], "signal_std": [0.01]},
    "requirement": [{"metric": "error_rms", "max": 0.05}],
}
SPRING["controller"]["disturbance_std"] = [1.0]


def test_a_point_has_a_value_and_a_nominal_value():
    law = parse_law({"point": [2.5, 4.0]})
    assert isinstance(law, Law)
    assert (law.support, law.median, law.nominal) == ((2.5, 2.5), 2.5, 4.0)
    np.testing.assert_array_equal(law.quantile(np.array([0.1, 0.9])), [2.5, 2.5])


def test_a_controller_that_is_fitted_keeps_its_gains():
    """Each draw alone gives the metric that it has among all draws; with plain numbers the gains would be others."""
    study = dj.Study.from_table(SPRING)
    dataset = dj.run(study, check=False).dataset
    for draw in (3, 11):
        numbers = {"parameters.k": float(dataset["parameters.k"][draw])}
        alone = study_of_draw(study, numbers).override({"draws": 1})
        assert alone.template.controller == study.template.controller
        found = float(dj.run(alone, check=False).dataset["error_rms"][0])
        assert found == pytest.approx(float(dataset["error_rms"][draw]), rel=1e-12)
        refitted = float(dj.run(study.override({**numbers, "draws": 1}), check=False).dataset["error_rms"][0])
        assert abs(refitted / found - 1.0) > 1e-4


def test_a_witness_fails_as_it_did_in_the_search(tmp_path):
    found = dj.falsify(dj.Study.from_table(SPRING), budget=64)
    file = tmp_path / "witness.toml"
    file.write_text(to_toml(found.witness_study.table))
    again = dj.run(dj.Study.load(file), check=False).dataset
    assert float(again["error_rms"][0]) == pytest.approx(0.05 - 0.05 * found.slack, rel=1e-9)


def test_an_inner_loop_keeps_the_mass_that_it_believes():
    study = study_of("px4", (1.0, 0.0, 1.0, 0.0)).override({"plant.vehicle.mass": {"uniform": [1.0, 1.4]}, "draws": 4})
    alone = study_of_draw(study, {"plant.vehicle.mass": 1.05})
    assert alone.template.plant.believed == study.template.plant.believed
    assert study.override({"plant.vehicle.mass": 1.05}).template.plant.believed.mass == 1.05


def test_plain_numbers_stay_where_nothing_follows_from_nominal_ones():
    study = dj.Study.from_table({**UNCERTAIN, "sweep": {}})
    alone = study_of_draw(study, {"plant.k_p": 1.1, "unmodelled.mu": 0.02})
    assert alone.table["plant"]["k_p"] == 1.1
    assert alone.table["unmodelled"]["mu"] == 0.02


def test_records_are_the_same_in_every_draw():
    """A record is an array, which has no truth value."""
    record = {"kind": "record", "time": [0.0, 1.0, 2.0], "position": [0.0, 0.01, 0.0], "velocity": [0.0, 0.0, 0.0]}
    reference = {"kind": "record", "time": [0.0, 1.0, 2.0], "value": [0.0, 0.5, 0.0]}
    study = dj.Study.from_table({**SPRING, "sensor": record, "reference": reference})
    alone = study_of_draw(study, {"parameters.k": 10.0})
    assert alone.table["parameters"]["k"]["point"][0] == 10.0  # its controller is fitted
    study = study.override({"controller": {"kind": "pid", "k_p": 1.0}})
    assert study_of_draw(study, {"parameters.k": 10.0}).table["parameters"]["k"]["value"] == 10.0
