"""Compensated programs without the warning comments at their head (see `tests.cli.test_warnings_travel`)."""

from __future__ import annotations

from textwrap import wrap

from twin.compensation import Compensation


def body(result: Compensation) -> str:
    """Return the program without these comments; block numbers are kept."""
    head = {line.casefold() for one in result.report.warnings for line in wrap(f"twin: {one.text}", 72)}
    lines = result.text.splitlines(keepends=True)
    return "".join(line for line in lines if line.lstrip("0123456789 ;$(").rstrip(")\r\n").casefold() not in head)
