"""Compensated programs without the comments of twin at their head (see `tests.cli.test_warnings_travel`)."""

from __future__ import annotations

from textwrap import wrap

from twin.compensation import Compensation


def body(result: Compensation) -> str:
    """Return the program without these comments; block numbers are kept."""
    head = {line.casefold() for one in result.report.warnings for line in wrap(f"twin: {one.text}", 72)}
    kept = []
    for line in result.text.splitlines(keepends=True):
        bare = line.lstrip("0123456789 ;$(").rstrip(")\r\n").casefold()
        if bare not in head and not bare.startswith("twin: only for "):
            kept.append(line)
    return "".join(kept)
