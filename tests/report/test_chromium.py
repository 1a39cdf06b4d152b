"""The page in a real browser, where there is one: something is seen, nothing is complained of, it prints."""

import subprocess

import numpy as np
import pytest
from matplotlib.image import imread

from dssc_jax.report import write
from tests.browser import BROWSER, needs_browser

pytestmark = needs_browser


@pytest.fixture(scope="module")
def page(swept, tmp_path_factory):
    return write(swept, tmp_path_factory.mktemp("page") / "report.html", worst=0)


def browse(page, *options):
    """Chromium without a window; returns what it logs."""
    profile = f"--user-data-dir={page.parent / 'profile'}"
    always = (BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", profile)
    done = subprocess.run(
        [*always, "--enable-logging=stderr", *options, page.as_uri()], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    return [line for line in done.stderr.splitlines() if "CONSOLE" in line]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_screenshot(page, scheme):
    shot = page.with_name(f"{scheme}.png")
    preferred = f"--blink-settings=preferredColorScheme={0 if scheme == 'dark' else 1}"
    assert browse(page, preferred, "--window-size=1200,2400", f"--screenshot={shot}") == []
    seen = imread(shot)[..., :3]
    assert (seen[:50, :50].mean() > 0.9) == (scheme == "light")
    assert len(np.unique(seen.reshape(-1, 3), axis=0)) > 50


def test_print(page):
    pdf = page.with_suffix(".pdf")
    assert browse(page, "--no-pdf-header-footer", f"--print-to-pdf={pdf}") == []
    assert pdf.read_bytes().startswith(b"%PDF")
    assert pdf.stat().st_size > 20_000
