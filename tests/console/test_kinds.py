"""What `info` tells of every kind: complete, and as the study file takes it."""

import json

import pytest

from dssc_jax.cli.main import guarded
from dssc_jax.console.kinds import HEADS, kinds, registries, rows_of
from dssc_jax.study.fields import field_specs

EVERY = [(slot, kind) for slot, registry in registries().items() for kind in registry]


@pytest.mark.parametrize(("slot", "kind"), EVERY, ids=[f"{slot}-{kind}" for slot, kind in EVERY])
def test_every_field_is_told(slot, kind):
    entry = registries()[slot][kind]
    rows = rows_of(entry)
    member = next(iter(entry.members.values()))
    specs = field_specs(getattr(member, "params", member))
    named = {row[0].split(".")[0] for row in rows}
    assert named - {entry.option} - entry.keys.keys() == {n for n, s in specs.items() if not s.is_derived}
    assert all(meaning for _, _, meaning, _, _ in rows)
    assert kinds()[slot][kind]["about"].keys() == {row[0] for row in rows}


def test_parts_of_models_are_kinds_too():
    assert {"controller.functions", "controller.rho", "plant.vehicle"} <= registries().keys()
    assert HEADS.keys() <= registries().keys()


def test_a_kind_alone(capsys):
    """Unit, range and default stand where the study file would be refused otherwise; both sines are told of."""
    assert guarded(["info", "sine"]) == 0
    shown = capsys.readouterr().out
    assert '[reference] kind = "sine"' in shown
    assert '[disturbance] kind = "sine"' in shown
    row = next(line.split() for line in shown.splitlines() if line.startswith("period"))
    assert row == ["period", "s", "period", ">", "0", "required"]
    assert guarded(["info", "dssc"]) == 0
    shown = capsys.readouterr().out
    assert "a number alone is 'constant'" in shown
    assert "nominal.predictor_term" in shown


def test_a_field_tells_the_kinds_that_have_it(capsys):
    assert guarded(["info", "ground"]) == 0
    shown = capsys.readouterr().out
    assert '[plant] kind = "uav"' in shown
    assert "ground.friction" in shown
    assert "battery" not in shown
    assert guarded(["info", "mu", "--json"]) == 0
    described = json.loads(capsys.readouterr().out)
    assert described.keys() == {"fields"}
    assert described["fields"]["unmodelled"]["lag"]["mu"]["unit"] == "s"


def test_what_info_refuses(capsys):
    assert guarded(["info", "sqare_root"]) == 2
    assert "sqare_root: is no kind and no field; did you mean 'square_root'?" in capsys.readouterr().err
    assert guarded(["info", "sqare_root", "--json"]) == 2
    assert "did you mean 'square_root'?" in capsys.readouterr().err


def test_the_json_of_a_name(capsys):
    assert guarded(["info", "x500", "--json"]) == 0
    (vehicle,) = json.loads(capsys.readouterr().out)["kinds"].values()
    assert vehicle["about"]["mass"]["default"] == "2.06431"
    assert guarded(["info", "uniform", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"law": {"arguments": "[lo, hi]", "rule": "lo must be below hi"}}
    assert guarded(["info", "error_rms", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["metric"]["of"] == "channel"


def test_the_json_of_all(capsys):
    assert guarded(["info", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["kinds"]["controller"]["dssc"]["about"]["l0"]["admissible"] == "> 0"
    state_space = ["a", "b", "c", "disturbance", "x0", "outputs", "inputs", "d"]
    assert found["kinds"]["plant"]["state_space"]["fields"] == state_space
    assert "allocation" not in found["kinds"]["plant"]["uav"]["fields"]
