"""The block diagram holds what the study holds, and nothing else."""

import re
from itertools import combinations

import pytest

import dssc_jax as dj
from dssc_jax.report.diagram import LINE_LENGTH, diagram, words
from dssc_jax.study.library import find
from tests.conftest import CASE_2, UNCERTAIN


def titles(study):
    return set(re.findall(r'<text class="title"[^>]*>([^<]*)<', str(diagram(study))))


ALWAYS = {"reference", "controller", "plant"}


def test_only_what_is_present():
    assert titles(dj.Study.from_table(CASE_2)) == ALWAYS | {"nominal control", "disturbance d"}
    assert titles(dj.Study.from_table(UNCERTAIN)) == ALWAYS | {"unmodelled", "disturbance d"}
    study = dj.Study.from_table({**UNCERTAIN, **MEASURED, "disturbance": {"kind": "none"}})
    assert titles(study) == ALWAYS | {"unmodelled", "sensor", "differentiator"}


def test_a_vehicle_has_wind_and_channels():
    study = dj.Study.load(find("uav_robustness"))
    assert titles(study) == ALWAYS | {"nominal control", "sensor", "wind"}
    assert "x, y, z, psi" in str(diagram(study))
    assert "dryden" in words(study)


def test_a_sensor_of_one_channel_alone_is_there():
    study = dj.Study.load(find("uav_robustness")).override({"sensor": {"psi": {"kind": "noisy"}, "kind": "ideal"}})
    assert "sensor" in titles(study)


def test_uncertain_and_swept_numbers_are_marked():
    drawn = str(diagram(dj.Study.load(find("mu_robustness"))))
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
    drawn = str(diagram(dj.Study.load(find(name))))
    left, top, width, height = map(float, re.search(r'viewBox="([^"]*)" width', drawn)[1].split())
    for x, y, right, lower in blocks(drawn):
        assert left <= x < right <= left + width
        assert top <= y < lower <= top + height
    lines = re.findall(r'<text class="line"[^>]*>([^<]*)<', drawn)
    assert len(lines) > 2
    for line in lines:
        assert len(line) <= LINE_LENGTH
