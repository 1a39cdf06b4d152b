"""The block diagram holds what the study holds, and nothing else."""

import copy
import re
import tomllib
from itertools import combinations
from pathlib import Path

import pytest

import dssc_jax as dj
from dssc_jax.report.diagram import LINE_LENGTH, NAMES, diagram, diagram_text
from dssc_jax.study.library import find_study
from tests.conftest import CASE_2, UNCERTAIN

DOCS = Path(__file__).parents[2] / "docs"
PAGES = ("actuators", "flight", "parameters", "references", "signals", "tutorial", "vehicle")  # with whole studies
BLOCK = re.compile(r"^```toml\n(.*?)^```", re.DOTALL | re.MULTILINE)


def titles(study):
    return set(re.findall(r'<text class="title"[^>]*>([^<]*)<', str(diagram(study))))


ALWAYS = {"reference", "controller", "plant"}


def test_only_what_is_present():
    assert titles(dj.Study.from_table(CASE_2)) == ALWAYS | {"nominal control", "disturbance d"}
    assert titles(dj.Study.from_table(UNCERTAIN)) == ALWAYS | {"unmodelled", "disturbance d"}
    study = dj.Study.from_table({**UNCERTAIN, **MEASURED, "disturbance": {"kind": "none"}})
    assert titles(study) == ALWAYS | {"unmodelled", "sensor", "differentiator"}


def test_a_vehicle_has_wind_and_channels():
    study = dj.Study.load(find_study("uav_robustness"))
    assert titles(study) == ALWAYS | {"nominal control", "sensor", "wind"}
    assert "x, y, z, psi" in str(diagram(study))
    assert "dryden" in diagram_text(study)


def test_a_sensor_of_one_channel_alone_is_there():
    study = dj.Study.load(find_study("uav_robustness")).override(
        {"sensor": {"psi": {"kind": "noisy"}, "kind": "ideal"}}
    )
    assert "sensor" in titles(study)


CHANNEL_PARTS = {
    "sensor": {"kind": "noisy"},
    "unmodelled": {"kind": "lag", "mu": 0.1},
    "disturbance": {"kind": "constant", "value": 0.1},
    "differentiator": {"kind": "lead_filter", "tau_f": 0.01},
}


@pytest.mark.parametrize("slot", CHANNEL_PARTS)
def test_the_common_kind_of_a_slot_may_be_absent(slot):
    """A study takes a slot whose channels each have a kind, and no table for all of them has one."""
    study = dj.Study.load(find_study("uav_robustness")).without_sweep()
    part = CHANNEL_PARTS[slot]
    by_channel = dj.Study.from_table({**study.table, slot: dict.fromkeys(study.loop.channels, part)})
    common = dj.Study.from_table({**study.table, slot: part})
    assert diagram_text(by_channel) == diagram_text(common)
    neutral = {"kind": "ideal" if slot == "sensor" else "none"}
    absent = dj.Study.from_table({**study.table, slot: dict.fromkeys(study.loop.channels, neutral)})
    assert titles(absent) == titles(common) - {NAMES[slot]}


def test_the_sensor_of_measured_signals_needs_no_kind():
    table = copy.deepcopy(UNCERTAIN)
    plain = titles(dj.Study.from_table(table))
    assert "sensor" not in plain
    table["sensor"] = {"measures": ["y"]}
    assert titles(dj.Study.from_table(table)) == plain
    table["sensor"]["y"] = {"kind": "noisy", "position_std": 0.1}
    study = dj.Study.from_table(table)
    assert titles(study) == plain | {"sensor"}
    assert "sensor noisy" in diagram_text(study)


@pytest.mark.parametrize("page", PAGES)
def test_the_studies_of_the_documentation_have_a_diagram(page):
    checked = 0
    for text in BLOCK.findall((DOCS / f"{page}.md").read_text("utf-8")):
        table = tomllib.loads(text)
        if not {"loop", "plant", "controller"} <= table.keys():
            continue
        study = dj.Study.from_table(table)
        assert str(study.config.plant["kind"]) in diagram_text(study)
        checked += 1
    assert checked


def test_uncertain_and_swept_numbers_are_marked():
    drawn = str(diagram(dj.Study.load(find_study("mu_robustness"))))
    assert "~ k_p  ~ a_p" in drawn
    assert "⇄ tau_av" in drawn
    assert "~ 3 uncertain or swept" in str(diagram(dj.Study.from_table(UNCERTAIN)))


def blocks(drawn):
    """Every block's left, top, right and lower edge."""
    rectangles = re.findall(r'<rect class="block" x="(\d+)" y="(\d+)" width="(\d+)" height="(\d+)"', drawn)
    assert len(rectangles) > 2
    for found in rectangles:
        x, y, width, height = map(int, found)
        yield x, y, x + width, y + height


LAG = {"kind": "lag", "order": 2, "mu": 0.1}
MEASURED = {"sensor": {"kind": "noisy"}, "differentiator": {"kind": "lead_filter", "tau_f": 0.01}}


@pytest.mark.parametrize("disturbed", [True, False])
@pytest.mark.parametrize("lagging", [True, False])
@pytest.mark.parametrize("nominal", [True, False])
def test_blocks_do_not_overlap(disturbed, lagging, nominal):
    table = {**CASE_2, **MEASURED, "controller": dict(CASE_2["controller"])}
    table |= {} if disturbed else {"disturbance": {"kind": "none"}}
    table |= {"unmodelled": LAG} if lagging else {}
    if not nominal:
        del table["controller"]["nominal"]
    for one, other in combinations(blocks(str(diagram(dj.Study.from_table(table)))), 2):
        beside = one[2] < other[0] or other[2] < one[0]
        assert beside or one[3] < other[1] or other[3] < one[1]


@pytest.mark.parametrize("name", ["mu_robustness", "paper_field_test", "uav_robustness", "residual_scaling"])
def test_it_stays_within_its_frame(name):
    drawn = str(diagram(dj.Study.load(find_study(name))))
    left, top, width, height = map(float, re.search(r'viewBox="([^"]*)" width', drawn)[1].split())
    for x, y, right, lower in blocks(drawn):
        assert left <= x < right <= left + width
        assert top <= y < lower <= top + height
    lines = re.findall(r'<text class="line"[^>]*>([^<]*)<', drawn)
    assert len(lines) > 2
    for line in lines:
        assert len(line) <= LINE_LENGTH
