"""Pages that a command hands over: options for job, logo, language and PDF, and how the page is written. One mechanism for all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, final

import typer

from twin._common.errors import InputError
from twin._common.families import Language
from twin._common.files import write_atomic
from twin.cli.shared import options
from twin.cli.shared.command import XML, Output

if TYPE_CHECKING:
    from twin.display.sheet import Job, Sheet

JobOption = Annotated[
    Path | None,
    typer.Option(
        "--job",
        help="YAML file (schema: twin.job/1) with the facts of the test: report_number, machine, serial_number, operator, customer, "
        "place, date, instrument, instrument_serial, certificate, temperature; all optional text; dcc: facts of a certificate.",
    ),
]
LogoOption = Annotated[Path | None, typer.Option("--logo", help="PNG or SVG picture for the page, up to 512 KiB.")]
LangOption = Annotated[Language, typer.Option("--lang", help="Language of the page and of the printed text.")]
PrintedOption = Annotated[Language, typer.Option("--lang", help="Language of the printed text.")]
PdfOption = Annotated[
    Path | None,
    typer.Option("--pdf", help="Print the page to this PDF file, through Chromium, Chrome or Edge (or TWIN_BROWSER)."),
    Output((".pdf",)),
]
DccOption = Annotated[
    Path | None,
    typer.Option(
        "--dcc",
        help="Also write a digital calibration certificate (DCC 3.1.2, XML) to this file; its facts come from --job "
        "(twin doc certificates). It is not signed.",
    ),
    XML,
]
UNSIGNED: Final = "the certificate is not signed: a file is no signature"
PICTURES: Final = "the HTML report"


@final
@dataclass(frozen=True)
class Paper:
    """Files of a page, and the facts on it."""

    html: Path | None
    pdf: Path | None
    browser: str | None
    job: Job | None
    logo: str
    language: Language
    formal: bool  # whether the page has a heading with facts, and a line to sign

    @property
    def wanted(self) -> bool:
        """Whether any page is to be written."""
        return self.html is not None or self.pdf is not None

    def write(self, make: Callable[[Sheet | None], str], files: Sequence[Path]) -> Sheet | None:
        """Make the page from its sheet, write HTML and PDF, and return the sheet; ``files``: from which the result was computed."""
        if not self.wanted:
            return None
        from twin._common.messages import translated
        from twin.compute.parallel import versions
        from twin.display.sheet import Sheet, translation_of

        sheet = None
        if self.formal:
            sheet = Sheet.of(
                files,
                self.job,
                made=datetime.now().astimezone(),
                version=versions()["twin"],
                logo=self.logo,
                language=self.language,
            )
        with translated(translation_of(self.language)):
            self.put(make(sheet))
        return sheet

    def put(self, page: str) -> None:
        """Write a page as HTML and PDF."""
        from twin.display.sheet import page_to_pdf

        printed = None if self.browser is None else page_to_pdf(page, self.browser)
        if self.html is not None:
            write_atomic(self.html, page)
        if self.pdf is not None and printed is not None:
            write_atomic(self.pdf, printed)


def paper(
    html: Path | None, pdf: Path | None, job: Path | None, logo: Path | None, language: Language, *, drawn: bool = True
) -> Paper:
    """Return the paper of a command, checked before anything is computed; ``drawn``: whether the page has pictures.

    Raises:
        InputError: an invalid job or logo; no browser for the PDF; matplotlib is missing.
    """
    from twin.display.sheet import find_browser, load_job, logo_uri

    if job is not None and not job.exists():
        expected = "a YAML file (twin doc certificates): schema: twin.job/1, report_number: 26-14, customer: …, serial_number: …"
        raise InputError("no such file of the job", expected=expected, file=job)
    if drawn and (html is not None or pdf is not None):
        options.need_pictures(PICTURES)
    return Paper(
        html,
        pdf,
        None if pdf is None else find_browser(),
        None if job is None else load_job(job),
        "" if logo is None else logo_uri(logo),
        language,
        any(one is not None for one in (pdf, job, logo)),
    )
