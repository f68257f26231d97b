"""Print an HTML page to PDF through an installed browser, headless and without network."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Final

from twin._common.errors import InputError

VARIABLE: Final = "TWIN_BROWSER"
"""Environment variable that names the browser."""
BROWSERS: Final = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "microsoft-edge",
    "msedge",
    "chrome",
)
WORKING: Final = f"a working browser; {VARIABLE} names another"
TIMEOUT_S: Final = 120.0
OPTIONS: Final = (
    "--headless=new --no-first-run --disable-background-networking --disable-component-update --disable-sync --disable-extensions "
    "--no-pdf-header-footer --host-resolver-rules=MAP\x00*\x00~NOTFOUND"
)


def find_browser() -> str:
    """Return the path of a browser of the Chromium family.

    Raises:
        InputError: none is installed, or the environment variable ``TWIN_BROWSER`` names no program.
    """
    named = os.environ.get(VARIABLE)
    if named:
        found = shutil.which(named)
        if found is None:
            raise InputError(
                f"{VARIABLE} names no program", expected="the path of Chromium, Chrome or Edge", value=named
            )
        return found
    found = next((path for path in map(shutil.which, BROWSERS) if path), None)
    if found is None:
        raise InputError(
            "no PDF without a browser",
            expected=f"Chromium, Chrome or Edge (Debian: apt install chromium), or its path in {VARIABLE}; or print the HTML file",
        )
    return found


def page_to_pdf(page: str, browser: str) -> bytes:
    """Return a page as PDF.

    Args:
        page: self-contained HTML.
        browser: path of the browser.

    Raises:
        InputError: the browser failed or took longer than 120 s.
    """
    with tempfile.TemporaryDirectory(prefix="twin-pdf-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        source, target = folder / "page.html", folder / "page.pdf"
        source.write_text(page, encoding="utf-8")
        options = [option.replace("\x00", " ") for option in OPTIONS.split(" ")]
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            options.append("--no-sandbox")  # Chromium refuses to run as root otherwise
        call = [browser, *options, f"--user-data-dir={folder / 'profile'}", f"--print-to-pdf={target}", source.as_uri()]
        try:
            done = subprocess.run(call, capture_output=True, timeout=TIMEOUT_S, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise InputError(
                "the browser did not print the page",
                expected=WORKING,
                value=type(error).__name__,
                file=browser,
            ) from error
        if done.returncode or not target.is_file() or not target.read_bytes().startswith(b"%PDF"):
            raise InputError(
                "the browser did not print the page",
                expected=WORKING,
                value=f"exit status {done.returncode}",
                file=browser,
            )
        return target.read_bytes()
