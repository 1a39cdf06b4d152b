"""A small study file, and how the tests of commands read what they say."""

import json

import pytest

STUDY = """
name = "small"
seed = 3
draws = 20
[loop]
duration = 2.0
sample_time = 0.01
[plant]
kind = "normal_form"
k_p = { uniform = [0.8, 1.2] }
initial = [1.0, 0.0]
[controller]
kind = "pi"
l0 = 1.0
k_p = 1.0
k_i = 0.5
[[requirement]]
metric = "error_max"
after = 1.0
max = 0.47
[sweep]
"controller.k_p" = { linspace = [0.5, 2.0, 3] }
"""


@pytest.fixture
def study(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "small.toml"
    path.write_text(STUDY)
    return path


def last_json(capsys):
    """stdout is one JSON object and nothing else."""
    out = capsys.readouterr().out
    return json.loads(out)
