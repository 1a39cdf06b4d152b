"""The simulation visits nothing of Theorem 1; a result asks for its certificate where it is shown."""

import json
import subprocess
import sys

import numpy as np
import pytest

import dssc_jax as dj

PLANT = {"kind": "normal_form", "k_p": {"uniform": [0.9, 1.1]}, "a_p": 0.5}
PI = {"kind": "pi", "l0": 0.5, "k_p": 1.0, "k_i": 1.0}
TABLE_1 = {
    "kind": "vgsta",
    **{"phi_a": 0.1, "phi_b": 8.0, "delta": 0.5, "epsilon": 0.3, "gamma": 3.5},
    **{"kappa_a": 1.0, "kappa_b": 0.2, "kappa_c": 4.0, "kappa_d": 2.0, "k_o": 1.0},
}
DSSC = {"kind": "dssc", "l0": 0.5, "rho": 50.0, "functions": TABLE_1}
SCRIPT = """
import json, sys
import dssc_jax as dj
table, folder = json.loads(sys.argv[1])
result = dj.run(dj.Study.from_table(table), folder)
print(json.dumps([name for name in sys.modules if name.startswith("dssc_jax.design")]))
if folder is None:
    print(json.dumps(result.certificate))
    print(json.dumps("dssc_jax.design.certification" in sys.modules))
"""


def table(controller):
    return {
        "name": "plain",
        "draws": 4,
        "loop": {"duration": 0.1, "sample_time": 0.001},
        "plant": PLANT,
        "controller": controller,
    }


def printed(controller, folder):
    """What the script prints in a fresh interpreter."""
    arguments = json.dumps([table(controller), folder])
    done = subprocess.run([sys.executable, "-c", SCRIPT, arguments], capture_output=True, text=True, check=True)
    return [json.loads(line) for line in done.stdout.splitlines()[-3 if folder is None else -1 :]]


def test_a_run_into_a_folder_imports_nothing_of_the_theorem(tmp_path):
    (modules,) = printed(PI, str(tmp_path / "out"))
    assert modules == []
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["certificate"] == ""


def test_a_result_asks_the_theorem_only_when_it_is_shown():
    modules, certificate, loaded = printed(DSSC, None)
    assert modules == []
    assert "Theorem 1" in certificate
    assert loaded


@pytest.mark.parametrize("controller", [PI, DSSC], ids=["pi", "table 1"])
def test_a_run_calls_nothing_of_the_theorem(controller):
    visited = set()

    def record(frame, event, argument):
        del event, argument
        visited.add(frame.f_globals.get("__name__", ""))

    study = dj.Study.from_table(table(controller))
    sys.setprofile(record)
    try:
        dj.run(study)
    finally:
        sys.setprofile(None)
    assert "dssc_jax.runs.run" in visited
    assert [name for name in visited if name.startswith("dssc_jax.design")] == []


def test_marks_stay_with_the_points_that_are_selected():
    sweep = {"controller.functions.phi_b": [1.0, 8.0], "plant.k_p": [0.9, 1.0, 1.1]}
    result = dj.run(dj.Study.from_table(table(DSSC) | {"sweep": sweep}))
    assert "certified" not in result.dataset
    marked = result.with_theorem()
    assert marked.with_theorem() is marked
    marks = marked.dataset["certified"]
    assert marks.shape == (2, 3)
    selected = result.at({"controller.functions.phi_b": 1})
    np.testing.assert_array_equal(selected.dataset["certified"].values, marks.values[1])
    assert selected.certificate.startswith(f"Theorem 1 certifies {int(marks.values[1].sum())} of 3 points")


def test_other_controllers_have_no_marks():
    result = dj.run(dj.Study.from_table(table(PI)))
    assert result.with_theorem() is result
    assert result.certificate == ""
