"""Render a machine report as one HTML file: the summary first, then the details. Needs the extra ``plots`` (matplotlib).

Pictures and the 3D field are embedded; the page loads nothing from the network. In print, a still picture replaces the 3D field. The
text is in the templates next to this module, one per section.
"""

from __future__ import annotations

import html
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Final

from matplotlib.figure import Figure

from twin._common.errors import InputError
from twin._common.families import Language
from twin.controls import ControlSection
from twin.display import Html, place, render, with_half
from twin.display.figures import embedded
from twin.display.numbers import COVERAGE_FACTOR, listed
from twin.model.display import uncertainty_of
from twin.model.effects import Effect
from twin.numerics.curves import Basis, basis_named
from twin.reporting import plots
from twin.reporting.compensation import MACHINES
from twin.reporting.contributions import Motion
from twin.reporting.front import FrontPage, front_page
from twin.reporting.identified import PositionEstimates
from twin.reporting.result import MachineReport
from twin.reporting.scene.draw import field_html
from twin.reporting.scene.path import scale_top_um
from twin.reporting.translation import CLASSES, Translator, translator, wording
from twin.tool.uncertainty import DEFINITION

COLOURS: Final = {"well": "#e8f3ea", "wrong": "#fdf2df", "unknown": "#fbe4de"}
MARKS: Final = {"do": "✔ Do", "measure": "◎ Measure", "never": "✘ Do not", "unknown": "? Not known"}
SYMBOLS: Final = {"pass": "✔", "fail": "✘", "undecided": "?"}
ROWS: Final = 40
"""Largest number of excluded rows that are listed."""
VIEWER: Final = "<!-- the field in 3D -->"
"""Placeholder of the viewer until the rest of the page is rendered."""
DETAILS: Final = "<!-- details -->"
"""Start of the sections that are translated by sentences; the first page has a wording of its own."""
UNTRANSLATED: Final = "<!-- number of sentences without translation -->"
AT_TOOL: Final = ["at the tool, RMS [µm]", "largest [µm]", "U [µm]"]
SECTIONS: Final = (
    ("Error budget at the tool", "budget"),
    ("Error motions, axis by axis", "motions"),
    ("Squareness and location of the rotary axes", "constants"),
    ("Error over the working volume", "field"),
    ("Before and after compensation", "compensation"),
    ("Uncertainty", "known"),
    ("Not covered by this calibration", "gaps"),
    ("Sources", "sources"),
)
"""Heading and template of every section below the summary."""


def machine_html(report: MachineReport, front: FrontPage | None = None, language: Language = Language.en) -> str:
    """Return the page as self-contained HTML; needs matplotlib (extra ``plots``).

    Args:
        report: result of `twin.reporting.machine_report`.
        front: content of the first page; None for one without tolerances and facts of the test.
        language: language of the page; sentences without translation stay English and are counted.
    """

    def stops_of(name: str) -> tuple[PositionEstimates, ...]:
        return tuple(stop for comparison in report.comparisons for stop in comparison.stops.get(name, ()))

    to, own = None if language is Language.en else translator(language), wording(language)

    def error_of(name: str, reference: str = "") -> str:
        words = own.error(name, report.machine, reference)
        return words if to is None or own.knows(name) else to.text(words)

    page = render(
        "reporting/templates/report.html.j2",
        title=f"{report.machine.name}: report of the machine",
        report=report,
        front=front_page(report) if front is None else front,
        lang=language.value,
        t=own,
        error_of=error_of,
        symbols=SYMBOLS,
        to_of={constant.name: constant.to for constant in report.constants},
        over=_over(report),
        sections=SECTIONS,
        colours=COLOURS,
        marks=MARKS,
        stops_of=stops_of,
        plots=plots,
        AT_TOOL=AT_TOOL,
        CLASSES=CLASSES,
        MACHINES=MACHINES,
        DEFINITION=DEFINITION,
        ROWS=ROWS,
        VIEWER=VIEWER,
        DETAILS=DETAILS,
        UNTRANSLATED=UNTRANSLATED,
        coded=_coded,
        degree=_degree,
        embedded=embedded if to is None else partial(_embedded, to),
        numbers=_numbers,
        rows_of=_rows_of,
        scale_top_um=scale_top_um,
        tables_of=_tables_of,
    )
    # Inserted last: the page's filter ties numbers to their units, which must not change the viewer's code.
    viewer = _viewer(report, to) if VIEWER in page else ""
    return _translated(page, to).replace(VIEWER, viewer)


def _embedded(to: Translator, picture: Figure, words: str, caption: str = "", kind: str = "") -> Html:
    """Return an embedded picture with translated labels; its texts in the page are translated with the page."""
    return embedded(to.picture(picture), words, caption, kind)


def _translated(page: str, to: Translator | None) -> str:
    """Return the page with its details translated, and the number of sentences that are not."""
    front, _, details = page.partition(DETAILS)
    note = ""
    if to is not None:
        details = to.page(details)
        missing = wording(to.language)("appendix_language", count=len(to.missing))
        note = f"<p><b>{missing}</b></p>" if to.missing else ""
    return front.replace(UNTRANSLATED, note) + details


def _over(report: MachineReport) -> str:
    field = report.field
    stands = f", at {place(field.standing)}" if field.standing else ""
    return f"over {listed(list(field.spread))}{stands}"


def _viewer(report: MachineReport, to: Translator | None) -> str:
    """Return the interactive 3D field in an iframe."""
    field, rows = report.field, report.field.drawn
    inner = field_html(
        field.point_mm[rows],
        field.error_um[rows],
        title=f"Error of the tool point {_over(report)}",
        edges=field.edges(),
        illustrative=bool(report.illustrative),
    )
    title = "Error field in 3D: drag to rotate"
    if to is not None:
        inner, title = to.page(inner), to.text(title)
    return f'<iframe title="{html.escape(title)}" srcdoc="{html.escape(inner)}"></iframe>'


def _coded(text: str) -> Html:
    """Return plain text as HTML, with text in back quotes as code."""
    return Html(re.sub(r"`([^`]*)`", r"<code>\1</code>", html.escape(text)))


def _degree(report: MachineReport, motion: Motion) -> str:
    """Return the terms of a motion's curve, in its basis, those above the noise if identified, and added effects."""
    order = motion.order
    identified = report.identified
    chosen = None if identified is None or identified.others else identified.orders.get(motion.name)
    noun = basis_named(motion.basis).order_noun if motion.basis else Basis.order_noun
    text = "–" if order is None else f"{noun} {order}"
    if chosen is not None and chosen != order:
        text = f"{text}, {'nothing above the noise' if chosen == 0 else f'{noun} {chosen} above the noise'}"
    return " + ".join([text, *([", ".join(motion.added)] if motion.added else [])])


def _numbers(report: MachineReport, effect: Effect) -> str:
    """Return the parameters of an effect with their 95 % intervals."""
    known = report.calibration.covariance
    halves = [(parameter, COVERAGE_FACTOR * uncertainty_of(parameter.name, known)) for parameter in effect.parameters]
    return "; ".join(f"{one.name.rpartition('.')[2]} {with_half(one.value, half, one.unit)}" for one, half in halves)


def _rows_of(rows: Sequence[tuple[int, str]]) -> list[str]:
    """Return lines on excluded rows, with their reasons."""
    more = [f"and {len(rows) - ROWS} more, all in the JSON"] if len(rows) > ROWS else []
    return [*(f"line {line}: {reason}" for line, reason in rows[:ROWS]), *more]


def _tables_of(control: ControlSection) -> list[str]:
    return [f"{table.file.name} ({' '.join(table.classes)})" for table in control.tables]


# --- Print an HTML page to PDF through an installed browser, headless and without network ---------

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
        browser = shutil.which(named)
        if browser is None:
            raise InputError(
                f"{VARIABLE} names no program", expected="the path of Chromium, Chrome or Edge", value=named
            )
        return browser
    browser = next((path for path in map(shutil.which, BROWSERS) if path), None)
    if browser is None:
        raise InputError(
            "no PDF without a browser",
            expected=f"Chromium, Chrome or Edge (Debian: apt install chromium), or its path in {VARIABLE}; or print the HTML file",
        )
    return browser


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
