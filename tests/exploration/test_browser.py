"""The served page in Chromium, where there is one: sliders by keyboard, two tabs, a wrong token, nothing outside."""

import re

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.exploration.brushing import SCRIPT
from dssc_jax.exploration.draw_table import DrawTable
from dssc_jax.exploration.interactive_report import interactive_html
from dssc_jax.exploration.live import LiveStudy
from dssc_jax.exploration.study_page import StudyPage
from dssc_jax.statistics import clopper_pearson, rounded_probability
from tests.browser import BROWSER, needs_browser
from tests.exploration.serving import serving

pytestmark = needs_browser
PATIENCE = 120_000  # ms; the machine may be busy
HEADLINE = "failure probability"


@pytest.fixture(scope="module")
def served(live, tmp_path_factory):
    """The page of the small study, and its pages in the order of their sessions."""
    pages, folder = [], tmp_path_factory.mktemp("saved")

    def make():
        pages.append(StudyPage(live, background=True, folder=folder))
        return pages[-1]

    with serving(make) as server:
        server.pages, server.folder = pages, folder
        yield server


@pytest.fixture(scope="module")
def chromium():
    sync_api = pytest.importorskip("playwright.sync_api")
    with sync_api.sync_playwright() as tool:
        browser = tool.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture
def tab(chromium):
    """A tab as wide as a small screen; what it complains of, and what it asks others for, fails the test."""
    page, wrong = chromium.new_page(viewport={"width": 1280, "height": 900}), []
    page.set_default_timeout(PATIENCE)
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("console", lambda line: wrong.append(line.text) if line.type in ("error", "warning") else None)
    page.on("request", lambda request: wrong.append(request.url) if is_outside(request.url) else None)
    yield page
    page.close()
    assert wrong == []


def is_outside(url):
    return not url.startswith(("http://127.0.0.1:", "ws://127.0.0.1:", "data:", "blob:", "file:"))


def headline(tab):
    return tab.get_by_text(HEADLINE).first


def wait_until(tab, condition):
    """Wait for a condition of the served page: what the browser sends, and the run for it, arrive in their own time."""
    waited = 0
    while not condition():
        assert waited < PATIENCE
        tab.wait_for_timeout(50)
        waited += 50


def test_a_slider_by_keyboard(served, tab):
    """The arrow key moves the focused slider; the headline changes to what the page's own run says."""
    tab.goto(served.url)
    headline(tab).wait_for()
    page = served.pages[-1]
    shown = headline(tab).inner_text()
    slider = next(widget for slider, widget in page.sliders.items() if slider.key == "unmodelled.mu")
    handle = tab.locator(".noUi-handle").nth(list(page.sliders.values()).index(slider))
    handle.focus()
    for _ in range(20):
        tab.keyboard.press("ArrowRight")
    tab.get_by_text(shown).wait_for(state="detached")
    last = list(slider.options.values())[round(float(handle.get_attribute("aria-valuenow")))]
    assert last > 0.02
    wait_until(tab, lambda: page.now.study.leaves()["unmodelled.mu"] == last == slider.value and page.wait(0))
    tab.get_by_text(page.now.statement).wait_for()
    assert tab.evaluate("document.documentElement.scrollWidth <= window.innerWidth")


def test_save_from_the_browser(served, tab):
    tab.goto(served.url)
    headline(tab).wait_for()
    tab.locator("input[type=text]").first.fill("from-browser.toml")
    tab.locator("input[type=text]").first.press("Enter")
    tab.locator(".bk-btn", has_text=re.compile("^Save$")).click()
    tab.get_by_text("gives the same outcome in every draw").wait_for()
    assert dj.Study.load(served.folder / "from-browser.toml").config.draws == 120


def test_two_tabs_are_two_sessions(served, tab, chromium):
    """Moving one leaves the other alone, and closing one does not end the other."""
    tab.goto(served.url)
    headline(tab).wait_for()
    first = served.pages[-1]
    second = chromium.new_page()
    second.goto(served.url)
    headline(second).wait_for(timeout=PATIENCE)
    assert served.pages[-1] is not first
    second.locator(".noUi-handle").nth(0).focus()
    second.keyboard.press("ArrowRight")
    second.close()
    assert first.positions == first.live.start
    tab.locator(".noUi-handle").nth(5).focus()
    tab.keyboard.press("ArrowRight")
    wait_until(tab, lambda: first.positions != first.live.start and first.wait(0))


def test_a_tab_closed_during_a_run(served, tab, chromium):
    """The run ends unseen; another tab is served as before."""
    closed = chromium.new_page()
    closed.goto(served.url)
    headline(closed).wait_for(timeout=PATIENCE)
    left = served.pages[-1]
    closed.locator(".noUi-handle").nth(0).focus()
    for _ in range(5):
        closed.keyboard.press("ArrowRight")
    closed.close()
    assert left.wait(60)
    tab.goto(served.url)
    headline(tab).wait_for()


def test_markup_in_names_is_text(explored, tab):
    """Names, units and errors are shown, never run."""
    nasty = explored.override({"units": {"output_meaning": "<img src=x onerror=alert(1)> y"}})
    with serving(lambda: StudyPage(LiveStudy(nasty, ["controller.rho"], draws=4))) as server:
        tab.goto(server.url)
        headline(tab).wait_for()
        assert tab.locator("img[src=x]").count() == 0


@pytest.fixture(scope="module")
def brushed_page(explored, tmp_path_factory):
    """The interactive report of 300 draws, and its table."""
    result = dj.run(explored.override({"draws": 300}))
    file = tmp_path_factory.mktemp("interactive") / "interactive.html"
    file.write_text(interactive_html(result))
    return file, DrawTable(result)


def test_a_brush_counts_its_draws(brushed_page, tab):
    """Dragged over the left part of the scatter: the page's counts are NumPy's and SciPy's of the draws selected."""
    file, table = brushed_page
    tab.goto(file.as_uri())
    tab.get_by_text("all 300 draws").wait_for()
    box = tab.locator(".bk-events").first.bounding_box()
    left, top = box["x"] + 90, box["y"] + 15  # within the axes
    tab.mouse.move(left, top)
    tab.mouse.down()
    tab.mouse.move(left + 150, top + 200)
    tab.mouse.move(left + 250, top + 530)
    tab.get_by_text("brushed: ").first.wait_for()  # while the box is drawn
    assert tab.evaluate("Bokeh.documents[0].get_model_by_name('draws').selected.indices.length") == 0
    tab.mouse.up()
    tab.wait_for_function("Bokeh.documents[0].get_model_by_name('draws').selected.indices.length > 0")
    said = tab.get_by_text("brushed: ").first.inner_text()
    indices = tab.evaluate("[...Bokeh.documents[0].get_model_by_name('draws').selected.indices]")
    assert 0 < len(indices) < 300
    failures = int(table.failed[indices].sum())
    low, high = clopper_pearson(failures, len(indices))
    assert f"{len(indices)} draws, {failures} fail" in said
    found = [float(text) for text in re.search(r"\[(.*), (.*)\]", said).groups()]
    np.testing.assert_allclose(found, [low, high], rtol=6e-3)
    tab.keyboard.press("Escape")
    tab.get_by_text("all 300 draws").first.wait_for()
    assert tab.evaluate("Bokeh.documents[0].get_model_by_name('draws').selected.indices.length") == 0


def test_a_box_over_parallel_axes_brushes_and_shift_adds(brushed_page, tab):
    """The upper half of the first axis: the draws above the middle; then, with Shift, the lower half too: all."""
    file, table = brushed_page
    tab.set_viewport_size({"width": 1280, "height": 1200})
    tab.goto(file.as_uri())
    tab.get_by_text("all 300 draws").wait_for()
    frame = tab.evaluate(
        """() => { const view = Bokeh.index.roots[0].owner.query(v => v.frame && v.model.inner_width > 900).next().value
          const { left, top, width, height } = view.frame.bbox, { x_range, y_range } = view.model
          return { left, top, width, height, x: [x_range.start, x_range.end], y: [y_range.start, y_range.end] } }"""
    )
    box = tab.locator(".bk-events").last.bounding_box()

    def at(axis, height):
        """Pixels of a place on the parallel axes."""
        across, up = ((v - low) / (high - low) for v, (low, high) in ((axis, frame["x"]), (height, frame["y"])))
        left, top = box["x"] + frame["left"], box["y"] + frame["top"]
        return left + across * frame["width"], top + (1.0 - up) * frame["height"]

    def brush(low, high):
        tab.mouse.move(*at(-0.2, high))
        tab.mouse.down()
        tab.mouse.move(*at(0.1, 0.5 * (low + high)))
        tab.mouse.move(*at(0.2, low))
        tab.mouse.up()

    values = table.columns[table.first_axes[0]]
    heights = (values - values.min()) / np.ptp(values)
    brush(0.5, 1.1)
    tab.get_by_text("brushed: ").first.wait_for()
    chosen = set(tab.evaluate("[...Bokeh.documents[0].get_model_by_name('draws').selected.indices]"))
    unsure = set(np.flatnonzero(np.abs(heights - 0.5) < 0.02))  # a pixel
    assert chosen - unsure == set(np.flatnonzero(heights > 0.5)) - unsure
    tab.keyboard.down("Shift")
    brush(-0.1, 0.52)
    tab.keyboard.up("Shift")
    tab.get_by_text("brushed: 300 draws").first.wait_for()


def test_a_click_on_a_cell_brushes_its_draws(explored, tab, tmp_path):
    swept = dj.run(
        explored.override({"draws": 30, "sweep": {"unmodelled.mu": [0.01, 0.2], "controller.l0": [0.5, 1.0]}})
    )
    file = tmp_path / "map.html"
    file.write_text(interactive_html(swept))
    tab.goto(file.as_uri())
    tab.get_by_text("all 120 draws").wait_for()
    box = tab.locator(".bk-events").first.bounding_box()
    tab.mouse.click(box["x"] + 0.3 * box["width"], box["y"] + 0.6 * box["height"])  # the lower left cell
    tab.get_by_text("brushed: 30 draws").first.wait_for()
    indices = tab.evaluate("[...Bokeh.documents[0].get_model_by_name('draws').selected.indices]")
    table = DrawTable(swept)
    assert set(table.columns["unmodelled.mu"][indices]) == {0.01}
    assert set(table.columns["controller.l0"][indices]) == {0.5}


def test_a_click_gives_the_nearest_draw_or_none(brushed_page, tab):
    """At the pixel of a draw: its command appears; beside all draws: nothing is chosen."""
    file, table = brushed_page
    tab.goto(file.as_uri())
    tab.get_by_text("all 300 draws").wait_for()
    chosen = "[...Bokeh.documents[0].get_model_by_name('draws').selected.indices]"
    frame = tab.evaluate(
        """() => { const plot = [...Bokeh.documents[0]._all_models.values()].find(m => m.inner_width > 550),
          source = Bokeh.documents[0].get_model_by_name('draws'), { x_range, y_range } = plot
          return { width: plot.inner_width, height: plot.inner_height,
            x: (source.data.x[7] - x_range.start) / (x_range.end - x_range.start),
            y: (source.data.y[7] - y_range.start) / (y_range.end - y_range.start) } }"""
    )
    box = tab.locator(".bk-events").first.bounding_box()
    left = box["x"] + tab.evaluate(
        "Bokeh.index.roots[0].owner.query(v => v.frame && v.model.inner_width > 550).next().value.frame.bbox.left"
    )
    top = box["y"] + tab.evaluate(
        "Bokeh.index.roots[0].owner.query(v => v.frame && v.model.inner_width > 550).next().value.frame.bbox.top"
    )
    tab.mouse.click(left + frame["x"] * frame["width"], top + (1.0 - frame["y"]) * frame["height"])
    tab.get_by_text("--draw").first.wait_for()
    (index,) = tab.evaluate(chosen)
    x, y = (table.columns[name] for name in table.first_axes)
    assert abs(x[index] - x[7]) < 0.02 * np.ptp(x)
    assert abs(y[index] - y[7]) < 0.02 * np.ptp(y)
    tab.wait_for_timeout(1000)  # two quick clicks are another gesture
    tab.mouse.click(left + 8, top + 8)
    tab.get_by_text("all 300 draws").wait_for()
    assert tab.evaluate(chosen) == []


def test_the_script_s_interval_is_exact(tab):
    """Against SciPy's inverse of the incomplete beta function, from no failure to all, up to 100,000 draws."""
    cases = [(0, 1), (1, 1), (0, 100_000), (3, 100_000), (50_000, 100_000), (100_000, 100_000), (7, 24), (999, 1000)]
    found = tab.evaluate(f"(cases) => {{ {SCRIPT}; return cases.map(([k, n]) => exactInterval(k, n, 0.95)) }}", cases)
    failures, draws = np.array(cases).T
    np.testing.assert_allclose(found, clopper_pearson(failures, draws), rtol=1e-8)


@pytest.mark.parametrize("probability", [0.0, 0.12345, 0.9994, 0.99987654, 1.0 - 1e-7, 1.0])
def test_the_script_rounds_as_the_reports_do(tab, probability):
    said = tab.evaluate(f"(p) => {{ {SCRIPT}; return describe(p, 1, [p, p], true) }}", probability)
    assert said.count(f" {rounded_probability(probability)} in [{rounded_probability(probability)}, ") == 1
