"""The page as a browser, a reader and a screen reader meet it."""

import re
from html import unescape
from html.parser import HTMLParser
from itertools import pairwise

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.report import elements, html, write
from dssc_jax.report.page import SECTIONS, STYLE_SHEET
from dssc_jax.report.proof_section import proofs
from dssc_jax.report.study_sections import dependence
from dssc_jax.report.subject import Subject, worst_draws
from dssc_jax.report.vector import SVG_COLOURS, inline_svg
from dssc_jax.results.proofs import SweepProofs
from dssc_jax.study import read_toml
from tests.conftest import UNCERTAIN

VOID = {"meta", "br", "link", "input", "img", "hr"}


class Page(HTMLParser):
    """Tags in order, their text, and whether they are closed in order."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.open, self.texts = [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if "style" not in self.open:
            self.texts.append(data)

    def all(self, tag):
        return [attrs for name, attrs in self.tags if name == tag]

    @property
    def text(self):
        return " ".join(" ".join(self.texts).split())


def test_a_study_whose_optional_slots_give_no_kind_has_a_page():
    """Of the slots of one channel only a sensor with measured signals may give none; others are absent."""
    optional = ("reference", "sensor", "differentiator", "unmodelled", "disturbance", "wind", "actuator", "sweep")
    table = {name: value for name, value in UNCERTAIN.items() if name not in optional}
    study = dj.Study.from_table({**table, "sensor": {"measures": ["y"]}, "draws": 4})
    assert "The loop" in Page(html(dj.run(study), worst=0)).text


@pytest.fixture(scope="module")
def sweep_page(swept):
    return Page(html(swept, worst=1))


@pytest.fixture(scope="module")
def run_page(ran):
    return Page(html(ran, worst=2))


def test_it_is_well_formed(sweep_page, run_page):
    for page in (sweep_page, run_page):
        assert page.open == []
        identifiers = [attrs["id"] for _, attrs in page.tags if "id" in attrs]
        assert len(identifiers) == len(set(identifiers))
        for link in page.all("a"):
            assert link["href"].removeprefix("#") in identifiers


def test_nothing_comes_from_outside(sweep_page, run_page):
    for page in (sweep_page, run_page):
        assert not page.all("script")
        assert not page.all("link")
        for _, attrs in page.tags:
            assert not any(name.startswith("on") for name in attrs)
            for name in ("src", "href", "xlink:href"):
                assert (attrs.get(name) or "#").startswith(("#", "data:image/png;base64,"))
    assert "url(" not in STYLE_SHEET.read_text()


def test_markup_in_names_is_text(sweep_page, swept):
    assert swept.study.config.description in sweep_page.text
    assert not any(tag == "b" for tag, _ in sweep_page.tags)


def test_it_can_be_read_without_seeing(sweep_page, run_page):
    for page in (sweep_page, run_page):
        tags = [tag for tag, _ in page.tags]
        assert [tags.count(tag) for tag in ("h1", "main", "header", "footer", "nav")] == [1] * 5
        assert page.all("html")[0]["lang"] == "en"
        levels = [int(tag[1]) for tag in tags if re.fullmatch(r"h[1-6]", tag)]
        assert all(after <= before + 1 for before, after in pairwise(levels))
        for drawing in page.all("svg"):
            assert drawing["role"] == "img"
            assert len(drawing["aria-label"]) > 20
        assert all("scope" in cell for cell in page.all("th"))
        assert tags.count("caption") == tags.count("table")


def luminance(colour):
    channels = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    return float(np.dot((0.2126, 0.7152, 0.0722), linear))


@pytest.mark.parametrize("scheme", [0, 1], ids=["light", "dark"])
def test_contrast(scheme):
    """WCAG 2.2: text at 4.5 against page and panel, graphics at 3."""
    block = re.findall(r":root \{(.*?)\}", STYLE_SHEET.read_text(), re.DOTALL)[scheme]
    colours = dict(re.findall(r"--(\w+): (#\w{6})", block))
    for name in ("text", "quiet", "accent", "blue", "orange", "green", "red", "grey"):
        for ground in ("page", "panel"):
            low, high = sorted((luminance(colours[name]), luminance(colours[ground])))
            assert (high + 0.05) / (low + 0.05) >= (4.5 if name in ("text", "quiet", "accent") else 3.0), (name, ground)


def test_it_tells_what_the_summary_tells(run_page, ran):
    (point,) = ran.summary()["points"]
    assert 0 < point["failures"] < point["draws"]
    assert f"{point['failures']} of {point['draws']} draws fail" in run_page.text
    low, high = point["interval"]
    assert f"{low:.3g} to {high:.3g}" in run_page.text
    assert "Theorem 1" not in run_page.text  # these are not the functions of Table 1
    for name in (*ran.study.laws, *(measure.name for measure in ran.study.measures)):
        assert name in run_page.text
    assert ran.study.hash in run_page.text
    assert "largest |e| after 2 s: at most 1.6 m" in run_page.text


def test_the_sweep_shows_every_point(sweep_page, swept):
    """Six points in the folded table, and nothing about a theorem that speaks of other functions."""
    assert "All 6 points" in sweep_page.text
    assert "Theorem 1 does not apply" not in sweep_page.text


def test_the_certified_region_is_drawn_and_told(swept):
    grid = swept.dataset["outcome"].isel(draw=0, drop=True)
    told = swept.dataset.assign(certified=grid["controller.l0"] + 0 * grid < 0.7)
    page = html(dj.Result(swept.study, told, swept.manifest), worst=0)
    assert (
        "Theorem 1 certifies 3 of 6 points, without lag and sampling and with a rho that keeps sliding (hatched)"
        in page
    )
    assert "Theorem 1: without lag and sampling</text>" in page


def test_the_study_file_in_it_gives_the_study(ran, tmp_path):
    page = html(ran, worst=0)
    listing = re.search(r"<pre[^>]*><code>(.*?)</code>", page, re.DOTALL)[1]
    path = tmp_path / "again.toml"
    path.write_text(unescape(listing))
    assert dj.Study.from_table(read_toml(path)).override({}).hash == ran.study.hash


def test_worst_draws_are_the_worst(ran):
    slacks = ran.dataset["slack_error_max_after_2"].values
    chosen = worst_draws(ran, 3)
    assert sorted(slacks)[:3] == [slacks[draw] for draw in chosen]
    subject = Subject(ran, 2)
    assert [run.attrs["draw"] for run in subject.trajectories] == chosen[:2]
    assert max(run.attrs["deviation"] for run in subject.trajectories) < 1e-9


def test_among_draws_that_end_early_the_earliest_is_worst(ran):
    data = ran.dataset.copy(deep=True)
    data["slack_error_max_after_2"][:3] = -np.inf
    data["failed_at"][:3] = [2.0, 1.0, 3.0]
    assert worst_draws(dj.Result(ran.study, data, ran.manifest), 3) == [1, 0, 2]


def test_a_sweep_is_looked_at_where_half_fail(swept):
    subject = Subject(swept)
    share = swept.failed.mean("draw")
    assert abs(float(share.isel(subject.index)) - 0.5) == float(abs(share - 0.5).min())
    assert subject.point_result.failed.dims == ("draw",)


def test_correlated_numbers_are_not_told_as_independent(ran):
    """The page is of the same draws; only what it says of their laws is looked at."""
    assert dependence(ran.study) == "independent"
    correlated = ran.study.override({"correlation": {"plant.k_p, plant.a_p": -0.5}})
    page = html(dj.Result(correlated, ran.dataset, ran.manifest), worst=0)
    wanted = "with rank correlations (plant.k_p, plant.a_p: \N{MINUS SIGN}0.5), otherwise independent"
    assert f"Laws of the uncertain numbers, {wanted}" in page


def test_without_requirements_and_laws():
    """The smallest study has a page too, shorter by what it does not have."""
    table = {
        "name": "bare",
        "loop": {"duration": 0.2, "sample_time": 0.01},
        "plant": {"kind": "normal_form", "initial": [1.0, 0.0]},
        "controller": {"kind": "pi", "l0": 1.0, "k_p": 1.0, "k_i": 0.5},
    }
    page = Page(html(dj.run(dj.Study.from_table(table))))
    assert page.open == []
    assert "What is uncertain" not in page.text
    assert "The worst draws" in page.text


def test_a_section_more_is_a_function_more(ran, monkeypatch):
    def made(subject):
        return elements.Section("more", "One more", f"{subject.result.study.name} has it")

    monkeypatch.setattr("dssc_jax.report.page.SECTIONS", (*SECTIONS, made))
    assert "uncertain has it" in html(ran, worst=0)


def test_numbers():
    assert [elements.number(x) for x in (None, np.inf, -np.inf, np.nan, 0.000012345, -2.0)] == [
        "∞",
        "∞",
        "\N{MINUS SIGN}∞",
        "none",
        "1.234e\N{MINUS SIGN}05",
        "\N{MINUS SIGN}2",
    ]
    assert elements.probability_text(0.0, (0.0, 0.0362)) == "≤ 0.0362"
    assert elements.probability_text(0.5, (0.4, 0.6)) == "0.5"


def test_figures_take_the_pages_colours(ran):
    drawn = inline_svg(lambda: dj.plot.distribution(ran), 'a "figure"', "p")
    assert 'aria-label="a &#34;figure&#34;"' in drawn
    assert "currentColor" in drawn
    assert not any(colour.lower() in drawn.lower() for colour in SVG_COLOURS)
    assert "var(--red)" in drawn


WITHOUT = [{}, {"times": {"rate": "x"}}, {"device": [], "versions": None, "started": {}}]


@pytest.mark.parametrize("broken", WITHOUT)
def test_a_manifest_without_provenance(ran, broken):
    assert "not recorded" in html(dj.Result(ran.study, ran.dataset, broken), worst=0)


def test_where_it_cannot_be_written(ran, tmp_path):
    with pytest.raises(OSError, match="No such file"):
        write(ran, tmp_path / "no" / "report.html", worst=0)


def test_a_hundred_thousand_draws(ran):
    """The page stays under 5 MB; 100,000 draws are made of the 24 by repetition."""
    index = np.resize(np.arange(24), 100_000)
    data = ran.dataset.isel(draw=index).assign_coords(draw=np.arange(100_000))
    values = {name: data[name] * np.linspace(0.99, 1.01, 100_000) for name in data if data[name].dtype.kind == "f"}
    big = dj.Result(ran.study, data.assign(values), ran.manifest)
    assert len(html(big, worst=0).encode()) < 5e6


def test_proved_bounds_have_the_unit_of_the_output():
    """A wheel's angle is proved in radians, not in metres."""
    table = {
        "name": "wheel",
        "draws": 4,
        "loop": {"duration": 1.0, "sample_time": 0.01},
        "units": {"output": "rad"},
        "plant": {"kind": "normal_form", "k_p": {"uniform": [0.9, 1.1]}, "initial": [0.1, 0.0]},
        "controller": {"kind": "pi", "l0": 1.0, "k_p": 4.0, "k_i": 2.0},
        "sweep": {"controller.k_p": [3.0, 4.0]},
    }
    result = dj.run(dj.Study.from_table(table))
    points = [{"proved": True, "error": 0.01}, {"proved": False, "error": None}]
    proved = result.with_proofs(SweepProofs(result.study.hash, dict(result.study.axes), points, [{}, {}], 0.0))
    assert "largest |e| once settled, proved [rad]" in "".join(map(str, proofs(Subject(proved)).body))
