"""Several processes fill one folder: the bits of one process, also where a worker is killed."""

import os
import pickle
import signal

import distributed
import pytest
import xarray as xr

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.lanes.llvm import machine
from dssc_jax.runs import cluster
from tests.results.test_durability import SMALL

pytestmark = pytest.mark.filterwarnings("default")  # dask's own


@pytest.fixture(scope="module")
def study():
    return dj.Study.from_table({**SMALL, "loop": {"duration": 300.0, "sample_time": 0.01}})


def test_a_worker_is_killed(study, tmp_path):
    """Two workers, one killed when the first task is done: identical, told, and nothing computed in this process."""
    said, victims = [], []

    def progress(done, total):
        if done and not victims:
            pids = distributed.default_client().run(os.getpid)
            victims.append(next(iter(pids)))
            os.kill(pids[victims[0]], signal.SIGKILL)

    result = dj.run(study, tmp_path / "r", block=8, cluster="local:2", progress=progress, notify=said.append)
    xr.testing.assert_identical(result.dataset, dj.run(study).dataset)
    about = result.manifest["cluster"]
    assert about["lost"] == victims
    assert f"worker {victims[0]} was lost; its unfinished blocks go to others" in said
    assert (about["address"], about["workers"]) == ("local:2", 2)
    assert result.manifest["times"]["traces"] <= 1  # each worker compiles once
    assert result.manifest["times"]["rate"] > 0
    assert dj.run(study, tmp_path / "r", resume=True).manifest == result.manifest  # nothing is left to do


@pytest.mark.parametrize("address", ["local:0", "local:x", "local:-1", "localhost", "local:"])
def test_addresses(study, tmp_path, address):
    with pytest.raises(ConfigError, match=r"cluster: must be tcp://HOST:PORT or local:N"):
        dj.run(study, tmp_path / "r", cluster=address)
    assert not (tmp_path / "r").exists()


def test_nobody_answers(study, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(cluster, "CONNECTION_TIMEOUT", 0.5)
    assert guarded(["run", "mu_robustness", "--cluster", "tcp://127.0.0.1:9", "--out", str(tmp_path / "r")]) == 2
    assert "no scheduler with workers answers at tcp://127.0.0.1:9" in capsys.readouterr().err
    with pytest.raises(ConfigError, match="out: is needed on a cluster"):
        dj.run(study, cluster="local:1")


def test_workers_must_agree():
    """Other versions on one of them would break the bits."""

    class Client:
        def nthreads(self):
            return {"a": 1, "b": 1}

        def run(self, function):
            found = function()
            return {"a": found, "b": {**found, "versions": {**found["versions"], "jax": "0.0.1"}}}

    with pytest.raises(
        ConfigError, match=r"workers a and b would not give bit-identical .*versions.jax: .* '0.0.1' here"
    ):
        cluster.Cluster(Client(), "tcp://x", print).machinery()


def test_ranges_cover_every_block_once():
    for count in (0, 1, 7, 100, 5000):
        blocks = [(slice(i, i + 1),) for i in range(count)]
        for workers in (1, 2, 64):
            parts = cluster.block_ranges(blocks, workers)
            assert [block for part in parts for block in part] == blocks
            assert all(len(part) <= cluster.MOST_BLOCKS for part in parts)


def test_workers_share_the_machine(monkeypatch):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "3,5")
    assert [cluster.worker_environment(i, 3)["CUDA_VISIBLE_DEVICES"] for i in range(3)] == ["3", "5", "3"]
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    monkeypatch.setattr(machine, "usable_cores", lambda: 8)
    assert cluster.worker_environment(0, 2) == {machine.CORES_VARIABLE: "4"}
    assert cluster.worker_environment(0, 64) == {machine.CORES_VARIABLE: "1"}


def test_errors_travel():
    error = pickle.loads(pickle.dumps(ConfigError("plant.k_p", "must be > 0")))
    assert (error.where, error.rule, str(error)) == ("plant.k_p", "must be > 0", "plant.k_p: must be > 0")
