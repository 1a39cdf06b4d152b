"""The browser of the tests that open a page in one."""

import shutil

import pytest

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
needs_browser = pytest.mark.skipif(
    BROWSER is None,
    reason="needs Chromium, which pip cannot install; .ci/run installs it where apt-get can",
)
