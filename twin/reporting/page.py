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
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import yaml
from matplotlib.figure import Figure

from twin._common.errors import InputError
from twin._common.families import Language
from twin._common.messages import Message, Number, Translation, joined, say, say_html, translated
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
from twin.reporting.names import CLASSES, item_named
from twin.reporting.result import MachineReport
from twin.reporting.scene.draw import field_html
from twin.reporting.scene.path import scale_top_um
from twin.tool.uncertainty import DEFINITION

COLOURS: Final = {"well": "#e8f3ea", "wrong": "#fdf2df", "unknown": "#fbe4de"}
MARKS: Final = {
    "do": Message("✔ Do"),
    "measure": Message("◎ Measure"),
    "never": Message("✘ Do not"),
    "unknown": Message("? Not known"),
}
SYMBOLS: Final = {"pass": "✔", "fail": "✘", "undecided": "?"}
ROWS: Final = 40
"""Largest number of excluded rows that are listed."""
VIEWER: Final = "<!-- the field in 3D -->"
"""Placeholder of the viewer until the rest of the page is rendered."""
PARAMETERS: Final = MappingProxyType(
    {
        "size": Message("size"),
        "offset": Message("offset"),
        "amplitude": Message("amplitude"),
        "period": Message("period"),
        "phase": Message("phase"),
        "coefficient": Message("coefficient"),
        "order": Message("order"),
        "time_constant": Message("time_constant"),
        "exponent": Message("exponent"),
        "highest_rpm": Message("highest_rpm"),
        "tilt": Message("tilt"),
        "compliance": Message("compliance"),
        "mass": Message("mass"),
        "mass_ratio": Message("mass_ratio"),
    }
)
"""Names of the parameters of effects, in words where a language has them."""
AT_TOOL: Final[list[str]] = [Message("at the tool, RMS [µm]"), Message("largest [µm]"), "U [µm]"]
SECTIONS: Final = (
    (Message("Error budget at the tool"), "budget"),
    (Message("Error motions, axis by axis"), "motions"),
    (Message("Squareness and location of the rotary axes"), "constants"),
    (Message("Error over the working volume"), "field"),
    (Message("Before and after compensation"), "compensation"),
    (Message("Uncertainty"), "known"),
    (Message("Not covered by this calibration"), "gaps"),
    (Message("Sources"), "sources"),
)
"""Heading and template of every section below the summary."""


def machine_html(report: MachineReport, front: FrontPage | None = None, language: Language = Language.en) -> str:
    """Return the page as self-contained HTML; sentences without translation stay English and are counted."""

    def stops_of(name: str) -> tuple[PositionEstimates, ...]:
        return tuple(stop for comparison in report.comparisons for stop in comparison.stops.get(name, ()))

    def words_of(name: str) -> str:
        return item_named(name, report.machine, references.get(name, ""))

    references = {constant.name: constant.to for constant in report.constants}
    translation = None if language is Language.en else Translation(catalogue(language))
    with translated(translation):
        page = render(
            "reporting/templates/report.html.j2",
            title=f"{report.machine.name}: report of the machine",
            report=report,
            front=front_page(report) if front is None else front,
            lang=language.value,
            translation=translation,
            item_named=item_named,
            words_of=words_of,
            symbols=SYMBOLS,
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
            coded=_coded,
            degree=_degree,
            embedded=_embedded,
            numbers=_numbers,
            rows_of=_rows_of,
            say=say,
            scale_top_um=scale_top_um,
            spacing=_spacing,
            tables_of=_tables_of,
        )
        # Inserted last: the page's filter ties numbers to their units, which must not change the viewer's code.
        return page.replace(VIEWER, _viewer(report)) if VIEWER in page else page


def catalogue(language: Language) -> dict[str, str]:
    """Return the format strings of a language other than English, by identifier."""
    text = (resources.files("twin.reporting") / "wording" / f"{language.value}.yaml").read_text(encoding="utf-8")
    return dict(yaml.safe_load(text))


def _embedded(picture: Figure, words: str, caption: str = "", kind: str = "") -> Html:
    """Return an embedded picture with the numbers of its axes in the language of the page."""
    for plot in picture.axes:
        for axis in (plot.xaxis, plot.yaxis):
            formatter = axis.get_major_formatter()
            formatter.format_ticks = partial(_ticks, formatter.format_ticks)  # type: ignore[method-assign]
    return embedded(picture, say(words), caption, kind)


def _ticks(format_ticks: Callable[[Any], list[str]], values: Any) -> list[str]:
    return [say(Number(text)) for text in format_ticks(values)]


def _over(report: MachineReport) -> Message:
    field = report.field
    axes = listed(list(field.spread))
    if not field.standing:
        return Message("over {axes}", axes=axes)
    return Message("over {axes}, at {place}", axes=axes, place=place(field.standing))


def _spacing(steps_mm: Mapping[str, float]) -> Number:
    return Number(", ".join(f"{name} {step:.3g} mm" for name, step in steps_mm.items()))


def _viewer(report: MachineReport) -> str:
    field, rows = report.field, report.field.drawn
    inner = field_html(
        field.point_mm[rows],
        field.error_um[rows],
        title=say("Error of the tool point {over}", over=_over(report)),
        edges=field.edges(),
        illustrative=bool(report.illustrative),
    )
    title = say("Error field in 3D: drag to rotate")
    return f'<iframe title="{html.escape(title)}" srcdoc="{html.escape(inner)}"></iframe>'


def _coded(text: str) -> Html:
    """Return plain text as HTML, with text in back quotes as code."""
    return Html(re.sub(r"`([^`]*)`", r"<code>\1</code>", say_html(text)))


def _degree(report: MachineReport, motion: Motion) -> str:
    """Return the terms of a motion's curve, in its basis, those above the noise if identified, and added effects."""
    order = motion.order
    identified = report.identified
    chosen = None if identified is None or identified.others else identified.orders.get(motion.name)
    noun = basis_named(motion.basis).order_noun if motion.basis else Basis.order_noun
    text: str = "–" if order is None else Message("{noun} {order}", noun=noun, order=order)
    if chosen == 0 and chosen != order:
        text = Message("{terms}, nothing above the noise", terms=text)
    elif chosen is not None and chosen != order:
        text = Message("{terms}, {noun} {order} above the noise", terms=text, noun=noun, order=chosen)
    return joined(" + ", [text, *([", ".join(motion.added)] if motion.added else [])])


def _numbers(report: MachineReport, effect: Effect) -> str:
    known = report.calibration.covariance
    texts = []
    for one in effect.parameters:
        name = one.name.rpartition(".")[2]
        half = COVERAGE_FACTOR * uncertainty_of(one.name, known)
        texts.append(joined(" ", [PARAMETERS.get(name, name), with_half(one.value, half, one.unit)]))
    return joined("; ", texts)


def _rows_of(rows: Sequence[tuple[int, str]]) -> list[str]:
    texts: list[str] = [Message("line {line}: {reason}", line=line, reason=reason) for line, reason in rows[:ROWS]]
    more = len(rows) - ROWS
    return [*texts, Message("and {count} more, all in the JSON", count=more)] if more > 0 else texts


def _tables_of(control: ControlSection) -> list[str]:
    others = [f"{entry.file.name} ({entry.format})" for entry in (*control.kinematics, *control.live)]
    return [*(f"{table.file.name} ({' '.join(table.classes)})" for table in control.tables), *others]


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
    """Return the path of a browser of the Chromium family; `InputError` if there is none, or ``TWIN_BROWSER`` names no program."""
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
    """Return self-contained HTML as PDF; raise `InputError` if the browser failed or took longer than `TIMEOUT_S`."""
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
                "the browser did not print the page", expected=WORKING, value=type(error).__name__, file=browser
            ) from error
        if done.returncode or not target.is_file() or not target.read_bytes().startswith(b"%PDF"):
            raise InputError(
                "the browser did not print the page",
                expected=WORKING,
                value=f"exit status {done.returncode}",
                file=browser,
            )
        return target.read_bytes()
