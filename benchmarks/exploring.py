"""Measures the pages of docs/explore.md in Chromium, and writes its section on speed.

Run it as ``make exploring`` on a quiet machine.
"""

import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

import dssc_jax as dj
from benchmarks.page import put
from dssc_jax.exploration.interactive_report import interactive_html

PAGE = Path(__file__).parents[1] / "docs" / "explore.md"
WARM, MOVES = 4, 20  # moves that are not counted, and moves that are
DRAWS, BRUSHING = 100_000, 4.0  # draws of the page to send; seconds of brushing
PATIENCE = 300_000  # ms
CALM = 1000  # ms without a change, after which an answer is complete
WATCH = """() => {
  globalThis.began = globalThis.ended = 0
  for (const kind of ["keydown", "pointerup"])
    document.addEventListener(kind, () => { globalThis.began = performance.now() }, true)
  const seen = () => requestAnimationFrame(() => setTimeout(() => { globalThis.ended = performance.now() }))
  for (const shown of Bokeh.documents)
    for (const model of shown._all_models.values())
      if (model.type == "ColumnDataSource") model.properties.data.change.connect(seen)
}"""
"""Notes when a key or a button went, and when the last figure that this changed was painted."""
ANSWERED = f"globalThis.ended > globalThis.began && performance.now() - globalThis.ended > {CALM}"
COUNT = """() => {
  globalThis.paintings = 0
  for (const model of Bokeh.documents[0]._all_models.values())
    if (model.type == "CustomJS" && model.code.startsWith("for (const part of parts)")) {
      const execute = model.execute.bind(model)
      model.execute = (...given) => { globalThis.paintings += 1; return execute(...given) }
    }
}"""
"""Counts how often the page shows another set of brushed draws."""


@contextmanager
def served(page: Page, *arguments: str) -> Iterator[None]:
    """A page that ``dssc-jax explore`` serves, open and watched."""
    command = [sys.executable, "-m", "dssc_jax.cli", "explore", *arguments, "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        try:
            page.goto(server.stdout.readline().strip())
            page.get_by_text("draws").first.wait_for()
            page.wait_for_timeout(5000)
            page.evaluate(WATCH)
            yield
        finally:
            server.terminate()


def answered(page: Page) -> float:
    """Seconds from the last key or button to the last figure that it changed."""
    page.wait_for_function(ANSWERED)
    return page.evaluate("globalThis.ended - globalThis.began") / 1000.0


def slider_seconds(page: Page, study: str) -> list[float]:
    """From each of the arrow keys on the first slider to the figures of all draws again."""
    with served(page, study):
        page.locator(".noUi-handle").first.focus()
        times = []
        for move in range(WARM + MOVES):
            page.keyboard.press("ArrowRight" if move % 2 else "ArrowLeft")
            times.append(answered(page))
        return times[WARM:]


def flight_seconds(page: Page, study: dj.Study) -> list[float]:
    """From each click on a draw of a result to its flight; the first one, which compiles, is left out."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "result"
        dj.run(study, out)
        with served(page, str(out)):
            button = page.locator(".bk-btn", has_text="Random")
            button.click()
            page.get_by_text("stored metrics").wait_for()
            page.wait_for_timeout(CALM)
            times = []
            for _ in range(MOVES):
                button.click()
                times.append(answered(page))
            return times


def brushing(page: Page) -> tuple[float, float, float, float]:
    """Megabytes of a page to send; seconds until it is open; sets of draws a second brushed in each of its figures."""
    result = dj.run(dj.Study.load("mu_robustness").without_sweep().override({"draws": DRAWS}))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "draws.html"
        file.write_text(interactive_html(result), encoding="utf-8")
        start = time.monotonic()
        page.goto(file.as_uri())
        page.get_by_text(f"all {DRAWS:,} draws").wait_for()
        page.evaluate("new Promise(requestAnimationFrame)")
        opened = time.monotonic() - start
        page.wait_for_timeout(3000)
        page.evaluate(COUNT)
        rates = [brushed_a_second(page, figure, height) for figure, height in ((0, 430), (3, 180))]
        return file.stat().st_size / 1e6, opened, *rates


def brushed_a_second(page: Page, figure: int, height: int) -> float:
    """How many sets of draws a figure brushes in a second while the mouse moves as fast as the page follows."""
    box = page.locator(".bk-events").nth(figure).bounding_box()
    assert box is not None
    left, top = box["x"] + 80, box["y"] + 50
    page.mouse.move(left, top)
    page.mouse.down()
    start, move = time.monotonic(), 0
    page.evaluate("globalThis.paintings = 0")
    while time.monotonic() - start < BRUSHING:
        move += 1
        page.mouse.move(left + 100 + 7 * move % 400, top + height * (0.5 + 0.5 * (5 * move % 100) / 100))
    rate = page.evaluate("globalThis.paintings") / (time.monotonic() - start)
    page.mouse.up()
    return rate


def main() -> None:
    """Measure and write the section."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
        case, vehicle = dj.Study.load("mu_robustness"), dj.Study.load("uav_robustness")

        def new_page() -> Page:
            page = browser.new_page(viewport={"width": 1280, "height": 1180})
            page.set_default_timeout(PATIENCE)
            return page

        rows = [
            ("from slider to figures, 1,000 draws of 60 s", slider_seconds(new_page(), "mu_robustness")),
            ("from slider to figures, vehicle, 64 draws of 80 s", slider_seconds(new_page(), "uav_robustness")),
            ("from button to flight of 60 s", flight_seconds(new_page(), case.override({"draws": 200}))),
            ("from button to flight of a vehicle of 80 s", flight_seconds(new_page(), vehicle.override({"draws": 16}))),
        ]
        megabytes, opened, scatter, lines = brushing(new_page())
        browser.close()
    table = ["| | median | slowest |", "|---|---|---|"]
    table += [f"| {label} | {statistics.median(times):.2f} s | {max(times):.2f} s |" for label, times in rows]
    parts = (
        f"Each is measured {MOVES} times, from the key or button to the last figure that it changes. What is compiled "
        "first is left out.",
        "\n".join(table),
        f"A page of {DRAWS:,} draws has {megabytes:.1f} MB and opens in {opened:.1f} s. While the mouse draws a box, "
        f"it counts and paints {scatter:.0f} sets of brushed draws a second over two axes, and {lines:.0f} over "
        "parallel axes.",
    )
    text = "\n\n".join(parts)
    print(text)
    put("speed", text, PAGE)


if __name__ == "__main__":
    main()
