"""A page as a document to be handed over: facts of the test, report number, sources, language, and print to PDF.

Every page that twin writes takes a `Sheet` (`twin/display/templates/page.html.j2`): heading and facts stand above it, sources and the
line to sign below it, and number and page n of m at the foot of every printed page.
"""

from __future__ import annotations

import base64
import hashlib
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import date, datetime
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Final, Literal, final
from xml.etree import ElementTree

import yaml
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field
from pydantic_core import PydanticCustomError

from twin._common.errors import InputError
from twin._common.families import Language
from twin._common.files import read_bytes
from twin._common.messages import Translation
from twin._common.yaml_files import load_yaml

SCHEMA: Final = "twin.job/1"
LOGO_BYTES: Final = 512 * 1024
"""Largest size of a logo."""
PNG: Final = b"\x89PNG\r\n\x1a\n"
EXPECTED: Final = "a PNG or an SVG picture"
Line = Annotated[str, Field(max_length=80)]


def _country(value: object) -> object:
    """Return a country code of ISO 3166-1; raise an error for anything else, such as NO without quotes, which YAML reads as false."""
    if isinstance(value, str) and re.fullmatch("[A-Z]{2}", value):
        return value
    expected = 'two capital letters of ISO 3166-1, in quotes: "NO"'
    raise PydanticCustomError("country", "Input should be {expected}", {"expected": expected})


Country = Annotated[str, BeforeValidator(_country)]
Name = Annotated[str, Field(min_length=1, max_length=120)]


def _ascending(span: tuple[float, float]) -> tuple[float, float]:
    """Return a span; raise an error unless its numbers are finite and in order."""
    if not -1e6 < span[0] <= span[1] < 1e6:
        raise PydanticCustomError("span", "Input should be the lowest and the highest value: [19.8, 20.4]")
    return span


class Contact(BaseModel):
    """Name and address of a laboratory or customer."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    name: Name
    email: Name
    city: Name
    street: str = ""
    post_code: str = ""
    country: Country | None = None


class Person(BaseModel):
    """A person responsible for the certificate."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    name: Name
    role: str = ""


Span = Annotated[tuple[float, float], AfterValidator(_ascending)]


class AmbientConditions(BaseModel):
    """Lowest and highest value of each condition during the measurement."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    air_temperature_degC: Span | None = None
    machine_temperature_degC: Span | None = None
    humidity_percent: Span | None = None
    pressure_hPa: Span | None = None


class CertificateFacts(BaseModel):
    """Facts that a certificate must state and twin cannot know: entry ``dcc`` of a job file."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    number: Name
    country: Country
    begin: date
    end: date
    performed_at: Literal["laboratory", "customer", "laboratoryBranch", "customerBranch", "other"]
    manufacturer: Name
    laboratory: Contact
    customer: Contact
    responsible: Annotated[tuple[Person, ...], Field(min_length=1)]
    model: str = ""  # of the machine
    inventory_number: str = ""  # that the customer gave the machine
    order_number: str = ""
    received: date | None = None
    accreditation: str = ""  # number of the laboratory's accreditation by ISO/IEC 17025
    traceability: str = ""  # to which standards, and through whose certificate
    conditions: AmbientConditions = AmbientConditions()


class Job(BaseModel):
    """Facts of a test; every entry is optional, and what is missing is filled in by hand on paper."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    schema_: Literal["twin.job/1"] = Field(default="twin.job/1", alias="schema")
    report_number: Annotated[str, Field(max_length=40, pattern=r"^[\w ./#-]*$")] = (
        ""  # it stands in a style sheet, so no quotes
    )
    machine: Line = ""
    serial_number: Line = ""
    operator: Line = ""
    customer: Line = ""
    place: Line = ""
    date: Line = ""
    instrument: Line = ""
    instrument_serial: Line = ""
    certificate: Line = ""
    temperature: Line = ""
    dcc: CertificateFacts | None = None


def load_job(path: Path) -> Job:
    """Read a job file (``schema: twin.job/1``); `InputError` for an unknown key, or a value that is not text of 80 characters."""
    return load_yaml(path, Job, SCHEMA)[0]


def logo_uri(path: Path) -> str:
    """Return a PNG or SVG picture as a data URI; raise `InputError` if the file is larger than 512 KiB, or not such a picture."""
    content = read_bytes(path, most_bytes=LOGO_BYTES)
    if content.startswith(PNG):
        return _uri("png", content)
    if b"<!ENTITY" in content or not content.strip():
        raise InputError("not a logo", expected=EXPECTED, file=path)
    try:
        root = ElementTree.fromstring(content)
    except ElementTree.ParseError:
        raise InputError("not a logo", expected=EXPECTED, file=path) from None
    if root.tag != "{http://www.w3.org/2000/svg}svg":
        raise InputError("not a logo", expected=EXPECTED, file=path)
    return _uri("svg+xml", content)


def _uri(kind: str, content: bytes) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


@final
@dataclass(frozen=True)
class Sheet:
    """Facts that belong to a page and not to the result on it."""

    job: Job
    made: datetime
    files: tuple[tuple[str, str], ...]  # name and SHA-256 of the files from which the page was made
    version: str  # of twin
    language: Language = Language.en
    logo: str = field(default="", repr=False)  # data URI of `logo_uri`; or empty

    @classmethod
    def of(
        cls,
        files: Sequence[Path],
        job: Job | None = None,
        *,
        made: datetime,
        version: str,
        logo: str = "",
        language: Language = Language.en,
    ) -> Sheet:
        """Return the sheet of a page made from some files; `InputError` if one cannot be read."""
        digests = tuple((path.name, hashlib.sha256(read_bytes(path)).hexdigest()) for path in dict.fromkeys(files))
        return cls(Job() if job is None else job, made, digests, version, language, logo)

    @property
    def number(self) -> str:
        """Report number: that of the job, else the date and the first digits of the digest of the files."""
        digest = hashlib.sha256("".join(sha256 for _, sha256 in self.files).encode()).hexdigest()
        return self.job.report_number or f"{self.made:%Y%m%d-%H%M}-{digest[:6]}"

    def to_dict(self) -> dict[str, Any]:
        """Return the content for JSON."""
        job = {name: text for name, text in self.job.model_dump().items() if text and name not in ("schema_", "dcc")}
        return {"report_number": self.number, "job": job}


def catalogue(language: Language) -> dict[str, str]:
    """Return the format strings of a language other than English, by identifier."""
    text = (resources.files("twin.display") / "wording" / f"{language.value}.yaml").read_text(encoding="utf-8")
    return dict(yaml.safe_load(text))


def translation_of(language: Language) -> Translation | None:
    """Return the translation into a language; None for English."""
    return None if language is Language.en else Translation(catalogue(language))


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
