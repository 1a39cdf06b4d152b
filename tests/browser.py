"""The browser of the tests that open a page in one."""

import shutil

import pytest

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
NO_BROWSER = "no Chromium on the PATH (chromium, chromium-browser, google-chrome); on Debian: apt-get install chromium"
needs_browser = pytest.mark.skipif(BROWSER is None, reason=NO_BROWSER)
