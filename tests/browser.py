"""Headless Chromium for the tests of HTML pages."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

OPTIONS = (
    "--headless=new --no-sandbox --use-angle=swiftshader --enable-unsafe-swiftshader --disable-background-networking "
    "--disable-component-update --disable-sync --no-first-run"
).split()


def run_chromium(page: str, *options: str) -> subprocess.CompletedProcess[str]:
    """Open a page (a URL) in headless Chromium; skip the test if Chromium is not installed."""
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if found is None:
        pytest.skip("Chromium is not installed (Debian: apt install chromium)")
    done = subprocess.run([found, *OPTIONS, *options, page], capture_output=True, text=True, timeout=180, check=False)
    assert done.returncode == 0, done.stderr
    return done


def title_of(text: str, path: Path, expression: str, *, width: int) -> str:
    """Write a page to a file, open it in a window of some width, and return a JavaScript expression evaluated 2 s after loading.

    A frame may unpack itself after loading.
    """
    probe = f"<script>onload = () => setTimeout(() => {{ document.title = {expression}; }}, 2000)</script></body>"
    before, _, after = text.rpartition("</body>")
    path.write_text(f"{before}{probe}{after}", encoding="utf-8")
    done = run_chromium(path.as_uri(), f"--window-size={width},900", "--virtual-time-budget=5000", "--dump-dom")
    title = re.search(r"<title>(.*?)</title>", done.stdout)
    assert title is not None, done.stderr[-500:]
    return title[1]
