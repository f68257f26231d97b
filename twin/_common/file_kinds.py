"""Kinds of files, recognised by their beginning, to name a file that was given in place of another."""

from __future__ import annotations

import re
from typing import Final

_BEGINNING: Final = 4000
"""Number of characters that are looked at."""

_MOTION: Final = r"(?:N\d+\s|(?:N\d+)?(?:G\d+|M\d+|T\d+|O\d{2,}|[XYZ][-+.\d]+)(?!\w*\s*[:,;]))"

_KINDS: Final = (
    (re.compile(r"\s*PK\x03\x04"), "a spreadsheet or zip file"),
    (re.compile(r"\s*(<!doctype html|<html)", re.IGNORECASE), "an HTML page"),
    (re.compile(r"\s*(<\?xml[^>]*>\s*)?(<!--.*?-->\s*)*<robot\b", re.DOTALL), "a URDF"),
    (re.compile(r"(.*\n)*?schema: twin\.calibration/"), "a calibration"),
    (re.compile(r"(.*\n)*?schema: twin\.machine/"), "a machine file"),
    (re.compile(r"(.*\n)*?schema: twin\.[\w-]+/"), "another file of twin"),
    (re.compile(r'\s*\{\s*"'), "a JSON file"),
    (re.compile(r"(\s*#.*\n)*.*\btarget\b.*\bcarrier\b.*\bx_mm\b"), "a measurement table"),
    (re.compile(r"(\s*#.*\n)*.*\btarget\b.*\bcarrier\b"), "a plan"),
    (re.compile(r"\s*\d*\s*BEGIN\s+PGM\s", re.IGNORECASE), "an NC program"),
    (re.compile(r"(\$\$.*\n|\s*\n)*\s*(PARTNO|GOTO|UNITS|MULTAX)\b", re.IGNORECASE), "an NC program"),
    (re.compile(rf"\s*(%[^\n]*\n)?(\s*[(;][^\n]*\n|\s*\n)*\s*{_MOTION}"), "an NC program"),
)


def kind_of_text(text: str) -> str | None:
    """Return the kind of file that a text is, with its article (``an NC program``); None if it is not recognised.

    Args:
        text: the text, or its beginning.
    """
    beginning = text[:_BEGINNING].removeprefix("\ufeff")
    return next((kind for pattern, kind in _KINDS if pattern.match(beginning)), None)


def other_kind(text: str, *allowed: str) -> str | None:
    """Return the kind of file that a text is, unless it is one of those allowed or not recognised."""
    kind = kind_of_text(text)
    return None if kind in allowed else kind
