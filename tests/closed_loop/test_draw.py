"""One draw: what a draw that has ended keeps, and plants of one channel with and without a name for it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.closed_loop.draw import initial_progress, make_sample_step
from dssc_jax.closed_loop.metrics.requirements import Requirement
from dssc_jax.closed_loop.metrics.streaming import Measure, Window
from dssc_jax.core.adapters import as_mimo_plant, as_mimo_reference
from dssc_jax.core.signals import Measurement, Outcome, PlantInput, ReferencePoint
from dssc_jax.models.plants.normal_form import NORMAL_FORM, NormalFormParams, NormalFormState
from dssc_jax.models.references.sine import SINE, SineParams, sine_at

DIVERGING = {
    "name": "diverging",
    "loop": {"duration": 400.0, "sample_time": 0.5},
    "plant": {"kind": "normal_form", "a_p": -3.0, "initial": [1.0, 1.0]},
    "controller": {"kind": "pi", "l0": 1.0, "k_p": 0.0, "k_i": 0.0},
    "requirement": [{"metric": "error_max", "max": 10.0}],
}


@pytest.mark.parametrize("freeze", [True, False])
def test_a_draw_that_has_ended_is_frozen_where_that_is_asked_for(freeze):
    """Either way its outcome and its samples stay; the state stays finite only where it is frozen."""
    study = dj.Study.from_table(DIVERGING)
    key, params = jax.random.key(0), study.params({})
    sample = make_sample_step(study.loop, params, key, study.measures, (), freeze)
    begin = initial_progress(study.loop, params, key, study.measures)
    end = jax.lax.fori_loop(0, study.loop.steps, lambda _, at: sample(at)[0], begin)
    assert int(end.outcome) == Outcome.NON_FINITE
    assert 0 < int(end.steps) < study.loop.steps
    assert int(end.k) == study.loop.steps
    assert bool(jnp.isfinite(end.state.plant.x1)) is freeze
    assert bool(jnp.all(jnp.isfinite(jnp.asarray(jax.tree.leaves(end.accumulators))))) is freeze


def test_a_siso_plant_as_a_mimo_plant_of_one_channel():
    plant, params = as_mimo_plant(NORMAL_FORM), NormalFormParams(k_p=2.0, a_p=0.5, initial=(1.0, -1.0))
    state = plant.init(params)
    assert plant.measure(params, state, PlantInput((0.0,), (0.0,))) == (Measurement(1.0, -1.0),)
    assert plant.input_gain(params) == (2.0,)
    slope = plant.derivative(params, state, PlantInput((0.3,), (0.1,)), 0.0)
    assert slope == NORMAL_FORM.derivative(params, state, PlantInput(0.3, 0.1), 0.0) == NormalFormState(-1.0, 1.3, ())
    (point,) = as_mimo_reference(SINE).at(wave := SineParams(1.0, 4.0), 0.7)
    assert isinstance(point, ReferencePoint)
    np.testing.assert_array_equal(point, sine_at(wave, 0.7))


def test_the_one_channel_of_a_plant_may_have_a_name(monkeypatch, tmp_path):
    """A name makes no other loop of it: the plant's values stay plain, only the results are named after it."""
    (tmp_path / "named_plant.py").write_text(
        "from dssc_jax.models.plants.normal_form import NORMAL_FORM\nPLANT = NORMAL_FORM._replace(channels=('x',))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    plain = dj.Study.from_table(DIVERGING | {"plant": {"kind": "normal_form", "initial": [1.0, 1.0]}})
    named = plain.override({"plant.kind": "named_plant:PLANT", "requirement.0.metric": "error_max_x"})
    first, second = dj.run(plain).dataset, dj.run(named).dataset
    np.testing.assert_array_equal(first["error_rms"], second["error_rms_x"])
    assert named.requirements[0].text == "error_max_x <= 10 m"


def test_a_requirement_reads_its_channel_from_its_measure_whatever_the_channel_is_called():
    measure = Measure("error_max_x_after_2_after_5", "error_max", Window(5.0), 0, channel_name="x_after_2")
    assert Requirement(measure, maximum=1.0).text == "error_max_x_after_2 after 5 s <= 1 y"
