"""Regenerates the pictures of docs/explore.md: the pages, as Chromium shows them.

Run it as ``make screenshots``.
"""

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

import dssc_jax as dj
from dssc_jax.exploration.interactive_report import interactive_html

FIGURES = Path(__file__).parents[1] / "docs" / "figures"
STUDY, NUMBER, MOVES = "mu_robustness", 1, 8
SIZE = {"width": 1280, "height": 870}
TALL = {"width": 1280, "height": 1180}
PATIENCE = 300_000  # ms


def study_page(page: Page) -> None:
    """A study whose second slider, tau_av, has been moved by keyboard."""
    command = [sys.executable, "-m", "dssc_jax.cli", "explore", STUDY, "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        try:
            page.goto(server.stdout.readline().strip())
            page.get_by_text("failure probability").first.wait_for()
            headline = page.get_by_text("failures in").first.inner_text()
            page.locator(".noUi-handle").nth(NUMBER).focus()
            for _ in range(MOVES):
                page.keyboard.press("ArrowLeft")
            page.get_by_text(headline).wait_for(state="detached")
            page.wait_for_timeout(3000)
            page.screenshot(path=FIGURES / "explore_study.png")
        finally:
            server.terminate()


def draws_page(page: Page) -> None:
    """The interactive report of a run, brushed."""
    result = dj.run(dj.Study.load(STUDY).without_sweep().override({"draws": 4000}))
    with tempfile.TemporaryDirectory() as folder:
        page.set_viewport_size(TALL)
        file = Path(folder) / "draws.html"
        file.write_text(interactive_html(result), encoding="utf-8")
        page.goto(file.as_uri())
        page.get_by_text("all 4,000 draws").wait_for()
        box = page.locator(".bk-events").first.bounding_box()
        assert box is not None
        page.mouse.move(box["x"] + 60, box["y"] + 300)
        page.mouse.down()
        page.mouse.move(box["x"] + 300, box["y"] + 500, steps=5)
        page.mouse.up()
        page.get_by_text("brushed: ").first.wait_for()
        page.wait_for_timeout(1000)
        page.screenshot(path=FIGURES / "explore_draws.png")


def result_page(page: Page) -> None:
    """A result whose worst and median draws are shown: the worst one pinned."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "result"
        dj.run(dj.Study.load("motor").override({"draws": 2000}), out)
        command = [sys.executable, "-m", "dssc_jax.cli", "explore", str(out), "--no-browser"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
            assert server.stdout is not None
            try:
                page.set_viewport_size({**TALL, "height": 1340})
                page.goto(server.stdout.readline().strip())
                page.get_by_text("all 2,000 draws").wait_for()
                for button, said in (("Worst", "meets|violates"), ("Pin this draw", "pinned"), ("Median", "meets")):
                    page.locator(".bk-btn", has_text=re.compile(f"^{button}")).click()
                    page.get_by_text(re.compile(said)).first.wait_for()
                    page.wait_for_timeout(1500)
                page.screenshot(path=FIGURES / "explore_result.png")
            finally:
                server.terminate()


def main() -> None:
    """Take all pictures."""
    with sync_playwright() as tool:
        browser = tool.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        for take in (study_page, draws_page, result_page):
            page = browser.new_page(viewport=SIZE)
            page.set_default_timeout(PATIENCE)
            take(page)
            page.close()
        browser.close()


if __name__ == "__main__":
    main()
