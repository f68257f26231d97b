"""Facts of a test that no measurement gives: serial number, operator, instrument; and the logo of the page."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Annotated, Final, Literal
from xml.etree import ElementTree

from pydantic import BaseModel, ConfigDict, Field

from twin._common.errors import InputError
from twin._common.files import read_bytes
from twin._common.yaml_files import load_yaml

SCHEMA: Final = "twin.job/1"
LOGO_BYTES: Final = 512 * 1024
"""Largest size of a logo."""
PNG: Final = b"\x89PNG\r\n\x1a\n"
EXPECTED: Final = "a PNG or an SVG picture"
Line = Annotated[str, Field(max_length=80)]


class Job(BaseModel):
    """Facts of a test; every entry is optional, and what is missing is filled in by hand on paper."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    schema_: Literal["twin.job/1"] = Field(default="twin.job/1", alias="schema")
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


def load_job(path: Path) -> Job:
    """Read a job file (``schema: twin.job/1``).

    Raises:
        InputError: an unknown key, or a value that is not text of at most 80 characters; put numbers into quotes.
    """
    return load_yaml(path, Job, SCHEMA)[0]


def logo_uri(path: Path) -> str:
    """Return a PNG or SVG picture as a data URI, to be embedded in a page.

    Raises:
        InputError: the file is larger than 512 KiB, or not such a picture.
    """
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
