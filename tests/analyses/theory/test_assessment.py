"""Theory and simulation together: every part is there, or says why it is not."""

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.console.margins import show_theory
from tests.design.test_certification import table

WALK = {"over": "unmodelled.mu", "bounds": (0.002, 0.2), "log": True, "points": 6, "bisections": 8}


@pytest.fixture(scope="module")
def study():
    """Gains that Theorem 1 certifies, under a lag."""
    changes = {
        "draws": 60,
        "loop.duration": 12.0,
        "loop.sample_time": 0.002,
        "plant.initial": [0.2, 0.0],
        "controller.predictor_start": "matched",
        "unmodelled": {"kind": "lag", "order": 2, "mu": 0.01},
        "requirement": [{"metric": "command_tv", "after": 8.0, "max": 2.0}],
    }
    return dj.Study.from_table(table()).override(changes)


@pytest.fixture(scope="module")
def found(study):
    relay = study.override({"controller": {"kind": "smc", "l0": 0.5, "gain": 1.0}})
    return dj.theory.assess(study, **WALK, rivals={"smc": relay})


def test_every_part_is_the_one_that_is_computed_alone(study, found):
    alone = dj.margin(study, **WALK)
    assert np.array_equal(found.performance.dataset["critical"].values, alone.dataset["critical"].values)
    for kind, margins in found.local.items():
        local = dj.theory.local_margin(study, **WALK, kind=kind)
        assert np.array_equal(margins.dataset["critical"].values, local.dataset["critical"].values)
    assert set(found.local) == {"sampled", "continuous"}
    assert set(found.oscillations) == {"dssc", "smc"}
    assert found.performance.certificate.value == 0.0
    assert not found.not_covered


def test_the_amplitudes_are_printed_in_the_unit_of_sigma(found, study, capsys):
    show_theory(found, [])
    assert "amplitude of sigma [m/s]" in " ".join(capsys.readouterr().out.split())
    loop = study.override({"units": {"output": "rad/s"}})
    short = dj.theory.assess(loop, **{**WALK, "points": 2, "bisections": 1})
    show_theory(short, [])
    assert "amplitude of sigma [rad/s^2]" in " ".join(capsys.readouterr().out.split())


def test_the_parts_tell_one_story(found):
    """The requirement bounds the command's travel, which the local margin decides here; the relay chatters anyway."""
    summary = found.summary()
    local, simulated = summary["local"]["sampled"]["median"], summary["performance"]["median"]
    assert simulated == pytest.approx(local, rel=0.1)
    assert local < summary["local"]["continuous"]["median"] < 1.3 * local
    mu = np.array(summary["oscillations"]["smc"]["mu"])
    assert mu[0] == pytest.approx(0.04)  # 20 T_s
    assert summary["oscillations"]["smc"]["amplitude"][0] == pytest.approx(
        summary["oscillations"]["smc"]["predicted"][0], rel=0.1
    )
    assert set(summary["oscillations"]["dssc"]["predicted"]) == {None}
    assert summary["edge"] == pytest.approx(local, rel=0.05)


def test_the_figure_says_what_the_theorem_says(found):
    figure = dj.plot.theory(found.margins, found.oscillations, found.edge)
    assert figure.get_supxlabel() == found.performance.certificate.text
    left, right = figure.axes
    labels = left.get_legend_handles_labels()[1]
    assert labels[-1] == "certified as far as 0"
    assert {line.get_linestyle() for line in left.lines[:3]} == {"-", "--", ":"}
    assert "smc, describing function" in right.get_legend_handles_labels()[1]


def test_what_is_not_covered_says_why(study):
    few = study.override({"draws": 4, "loop.duration": 9.0})
    options = {"points": 3, "bisections": 2}
    gain = dj.theory.assess(few, over="plant.k_p", bounds=(1.0, 0.5), **options)
    assert "time constant of the unmodelled dynamics" in gain.not_covered["oscillations"]
    assert gain.performance.certificate.value == pytest.approx(0.896, abs=0.01)
    assert len(dj.plot.theory(gain.margins, gain.oscillations).axes) == 1
    bias = dj.theory.assess(few, over="disturbance.amplitude", bounds=(0.1, 1.0), **options)
    assert "has no effect near the origin" in bias.not_covered["sampled"]
    switching = few.override({"controller": {"kind": "smc", "l0": 0.5, "gain": 1.0}})
    fine = dj.theory.assess(switching, over="unmodelled.mu", bounds=(0.001, 0.01), **options)
    assert "switches at the origin" in fine.not_covered["sampled"]
    assert "the clock would chatter" in fine.not_covered["oscillations"]
    assert fine.edge is None


def test_oscillations_before_a_refused_rival_stay(study):
    few = study.override({"draws": 4, "loop.duration": 9.0})
    rivals = {"without a lag": few.override({"unmodelled": {"kind": "none"}})}
    found = dj.theory.assess(few, over="unmodelled.mu", bounds=(0.04, 0.2), points=3, bisections=2, rivals=rivals)
    assert set(found.oscillations) == {"dssc"}
    assert found.not_covered["oscillations"]
