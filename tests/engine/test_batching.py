"""Batches: bit-identical for any chunk, tile and device count; one compile; flat memory."""

import subprocess
import sys

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.engine.batching import Engine, Layout, values_of_draws
from tests.tolerances import COMPILER, SINGLE


def assert_same(left, right):
    for name in left.dataset.data_vars:
        np.testing.assert_array_equal(left.dataset[name].values, right.dataset[name].values, err_msg=name)


@pytest.fixture(scope="module")
def complete():
    from tests.conftest import UNCERTAIN

    return dj.run(dj.Study.from_table(UNCERTAIN))


def test_the_study_is_not_trivial(complete):
    share = complete.failed.mean().item()
    assert 0.05 < share < 0.95
    assert complete.dataset.sizes == {"controller.functions.tau_av": 3, "controller.l0": 2, "draw": 24}


@pytest.mark.parametrize("block", [1, 7, 24, 1000])
def test_any_chunk_size(complete, block):
    found = dj.run(complete.study, block=block)
    assert_same(complete, found)
    assert found.manifest["times"]["traces"] <= 1  # one compile


@pytest.mark.parametrize("tile", [1, 40, 1024])
def test_any_tile_size(complete, tile):
    assert_same(complete, dj.run(complete.study, tile=tile))


def test_any_number_of_devices(complete):
    """All of them made the whole."""
    assert_same(complete, dj.run(complete.study, devices=1))


def test_more_draws_keep_the_first_ones(complete):
    extended = dj.run(complete.study.override({"draws": 60}))
    for name in complete.dataset.data_vars:
        np.testing.assert_array_equal(
            extended.dataset[name].values[..., :24], complete.dataset[name].values, err_msg=name
        )


def test_another_law_does_not_move_the_draws_of_the_others(complete):
    fixed = dj.run(complete.study.override({"plant.k_p": 1.0}))
    for name in ("plant.a_p", "unmodelled.mu", "controller.rho", "plant.zero_dynamics.a.1"):
        np.testing.assert_array_equal(fixed.dataset[name].values, complete.dataset[name].values, err_msg=name)


def test_another_seed_gives_other_draws(complete):
    second = dj.run(complete.study.override({"seed": 4}))
    assert not np.any(second.dataset["plant.k_p"].values == complete.dataset["plant.k_p"].values)


def test_vmap_equals_a_loop(complete):
    """A batch against one draw at a time, by the single-draw path."""
    for draw in (0, 5, 23):
        point = {"controller.functions.tau_av": 0.05, "controller.l0": 0.5}
        alone = dj.simulate(complete.study, draw, point=point)
        batch = complete.dataset.sel(point).isel(draw=draw)
        for measure in complete.study.measures:
            assert alone.attrs[measure.name] == pytest.approx(batch[measure.name].item(), rel=1e-11), measure.name


def test_a_replay_agrees(complete):
    repeated = dj.replay(complete, 11, point={"controller.functions.tau_av": 0.1, "controller.l0": 1.0})
    assert repeated.attrs["agreement"] == "agrees"
    assert 0.0 <= repeated.attrs["deviation"] < 1e-11


def test_one_compile_for_the_whole_sweep(complete):
    assert complete.manifest["times"]["traces"] <= 1


@pytest.mark.parametrize("shape", [{}, {"draws": 1}, {"draws": 1000, "sweep": {}}])
def test_layout_covers_every_lane_once(uncertain, shape):
    study = uncertain.override(shape)
    for lanes in (1, 5, 24, 48, 100, 16384):
        layout = Layout.of(study, lanes)
        assert layout.lanes <= lanes
        count = np.zeros(layout.shape, dtype=int)
        for block in layout.blocks():
            count[block] += 1
        assert np.all(count == 1)


def test_single_precision_is_close_and_keeps_its_type(uncertain):
    """Noise included: both precisions draw the same."""
    double, single = dj.run(uncertain), dj.run(uncertain.override({"loop.precision": 32}))
    assert single.dataset["error_rms"].dtype == np.float32
    assert single.dataset["plant.k_p"].dtype == np.float64
    np.testing.assert_array_equal(single.dataset["plant.k_p"], double.dataset["plant.k_p"])
    np.testing.assert_allclose(single.dataset["error_rms"], double.dataset["error_rms"], rtol=SINGLE)
    np.testing.assert_array_equal(single.dataset["outcome"], double.dataset["outcome"])


def test_machine_code_and_plain_xla_agree(case_2, uncertain):
    """Case 2 over 10 s, implicit scheme, and the uncertain study with its noise."""
    for study in (case_2.override({"loop.duration": 10.0, "requirement": []}), uncertain.without_sweep()):
        draws = study.config.draws
        fast, plain = (
            Engine(study, draws, kernel=form)(values_of_draws(study, slice(0, draws)), np.arange(draws))()
            for form in ("lanes", "scan")
        )
        for measure in study.measures:
            np.testing.assert_allclose(
                fast[measure.name], plain[measure.name], rtol=COMPILER, atol=1e-12, err_msg=measure.name
            )
        np.testing.assert_array_equal(fast["outcome"], plain["outcome"])


MEMORY = """
import dssc_jax as dj
from dssc_jax.study.library import find_study
shorter = {"draws": 100_000, "loop.duration": 6.0, "requirement": [{"metric": "error_rms", "max": 20.0}]}
study = dj.Study.load(find_study("mu_robustness")).without_sweep().override(shorter)
result = dj.run(study)
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))  # ru_maxrss is inherited on exec
print(int(peak.split()[1]) / 1e6, result.manifest["times"]["seconds"])
"""


def test_hundred_thousand_draws_fit_in_two_gigabytes():
    """Draws of 6 s: memory does not grow with the duration, see above."""
    out = subprocess.run([sys.executable, "-c", MEMORY], capture_output=True, text=True, check=True)
    gigabytes, seconds = map(float, out.stdout.split())
    print(f"\n100,000 draws of 6 s: peak {gigabytes:.2f} GB, {seconds:.1f} s")
    assert gigabytes < 2.0
