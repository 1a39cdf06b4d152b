"""Tables of channels beside the common table of a slot."""

import pytest

import dssc_jax as dj
from dssc_jax.study import Study

VEHICLE = {
    "name": "channels",
    "draws": 2,
    "loop": {"duration": 0.2, "sample_time": 0.01},
    "plant": {"kind": "uav", "vehicle": {"kind": "x500"}},
    "controller": {"kind": "pid", "l0": 0.5, "k_p": 1.0, "k_d": 0.2, "low": -2.0, "high": 2.0},
    "reference": {"kind": "hover"},
}
SMC = {"kind": "smc", "gain": 0.3, "l0": 1.0}


def study_with(**tables: object) -> Study:
    return dj.Study.from_table({**VEHICLE, **tables})


@pytest.mark.parametrize(
    ("slot", "common", "own", "numbers"),
    [
        ("controller", VEHICLE["controller"], SMC, {"gain": 0.3, "l0": 1.0}),
        ("sensor", {"kind": "noisy", "position_std": 0.01}, {"kind": "lag", "mu": 0.1}, {"mu": 0.1}),
        ("unmodelled", {"kind": "lag", "mu": 0.01}, {"kind": "delay", "samples": 1.0}, {"samples": 1.0}),
        ("disturbance", {"kind": "constant", "value": 0.1}, {"kind": "step", "value": 0.2, "at": 0.1}, {"value": 0.2}),
        ("differentiator", {"kind": "lead_filter", "tau_f": 0.1}, {"kind": "none"}, {}),
    ],
)
def test_a_table_of_another_kind_replaces_the_common_one(slot, common, own, numbers):
    """The numbers of the common kind were unknown names in it."""
    study = study_with(**{slot: {**common, "psi": own}})
    alone = study_with(**{slot: {**dict.fromkeys("xyz", common), "psi": own}})
    assert getattr(study.loop, slot) == getattr(alone.loop, slot)
    assert getattr(study.template, slot) == getattr(alone.template, slot)
    leaves = study.leaves()
    assert {name: leaves[f"{slot}.psi.{name}"] for name in numbers} == numbers


def test_numbers_of_a_replaced_table_are_the_channels_own():
    """A default of the channel's kind must not move with the common number of the same name."""
    pi = {"kind": "pi", "l0": 1.0, "k_p": 1.0, "k_i": 0.1}
    study = study_with(controller={**VEHICLE["controller"], "psi": pi}).override({"controller.k_p": 2.0})
    numbers = [name for name in study.numbers if name.startswith("controller.psi.")]
    assert {"controller.psi.l0", "controller.psi.k_p", "controller.psi.k_i"} <= set(numbers)
    assert all(path.startswith("controller.3") for name in numbers for path in study.numbers[name].paths)
    others = [path for name in study.numbers if name not in numbers for path in study.numbers[name].paths]
    assert not any(path.startswith("controller.3") for path in others)


def test_a_common_table_without_kind_is_shared_by_all_kinds():
    pid = {"kind": "pid", "k_p": 1.0}
    study = study_with(controller={"l0": 0.7, **dict.fromkeys("xyz", pid), "psi": {"kind": "smc", "gain": 0.3}})
    assert study.leaves()["controller.l0"] == 0.7
    assert len(study.numbers["controller.l0"].paths) == 4
