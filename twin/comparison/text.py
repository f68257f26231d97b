"""A comparison as text for the terminal."""

from __future__ import annotations

from textwrap import wrap
from typing import Final

import numpy as np

from twin.comparison.result import Changes, ErrorChange
from twin.comparison.significance import FALSE_ALARMS
from twin.comparison.tool import ToolDisplacement
from twin.comparison.words import number, place, with_sign
from twin.display import readable
from twin.uncertainty.at_tool import DEFINITION

WIDTH: Final = 120


def text_of(found: Changes) -> str:
    """Return the comparison in words and tables."""
    lines = [*_verdict(found), "", *_at_tool(found), "", *_errors(found)]
    for name, needs in found.left_out:
        lines.append(f"not included at the tool: {name} (needs {needs})")
    lines += [
        "",
        *wrap(
            f"limit: upper limit of the RMS for an unchanged machine, from the uncertainties. {DEFINITION}. Aligned: without the "
            "common shift and rotation that touching off removes. *: significant. An unchanged machine is called changed in "
            f"at most {FALSE_ALARMS * 100:.0f} of 100 comparisons.",
            WIDTH,
        ),
    ]
    for notice in found.notices:
        lines += wrap(f"note: {notice}", WIDTH, subsequent_indent="  ")
    return "\n".join(lines) + "\n"


def _verdict(found: Changes) -> list[str]:
    head = {
        "changed": "CHANGED",
        "unchanged": "UNCHANGED, where it could be tested" if found.unjudged else "UNCHANGED",
        "same": "IDENTICAL NUMBERS",
        "reworded": "DIFFERENT NUMBERS, UNCHANGED AT THE TOOL",
        "unknown": "UNKNOWN",
    }[found.verdict]
    lines = [f"{found.machine.name}: {found.second} less {found.first}", ""]
    lines += [f"{one.title} (one or both): {one.sentence}" for one in found.warnings]
    lines += ["", head] if found.warnings else [head]
    for sentence in found.meaning:
        lines += wrap(sentence, WIDTH, initial_indent="  ", subsequent_indent="    ")
    return lines


def _at_tool(found: Changes) -> list[str]:
    tool, left = found.tool, found.tool.left
    every = "all but those not included" if found.left_out else "all errors"
    lines = [
        f"at the tool, length {tool.tool_length_mm:g} mm, {tool.poses} poses over the volume, µm",
        f"  {'':<44}{'RMS':>8}{'limit':>9}{'largest':>9}{'U there':>9}   where",
        _row(f"{every}, not aligned", tool.everything),
        _row(f"{every}, aligned", tool.everything_aligned, star=not found.unjudged),
    ]
    if tool.judged is not None:
        if found.unjudged:
            lines.append(_row("those that could be tested, aligned", tool.judged, star=True))
        lines += [_row(f"  {name}", row, star=True) for name, row in tool.by_class.items()]
    if left.poses:
        lines += [
            f"{'compensating with' if found.machine.runs_programs else 'taking out'} {found.first} on the machine of {found.second}:",
            f"  {'remaining, workpiece aligned':<44}{number(left.rms_um):>8}{'':>9}{number(left.max_um):>9}{_value(left.u_max_um):>9}"
            f"   {place(left.where)}",
            f"  {'remaining, not aligned':<44}{number(left.as_it_is.rms_um):>8}{'':>9}{number(left.as_it_is.max_um):>9}",
        ]
        if left.out_of_reach:
            lines.append(
                f"  {left.out_of_reach} of {tool.poses} poses not included: compensated, they leave a travel range or a curve's domain"
            )
    return lines


def _errors(found: Changes) -> list[str]:
    lines = [
        "each error by itself; u: standard uncertainty (k = 1); band: 95 % for the whole curve; p: corrected for all errors (Holm)",
        f"  {'':<28}{'class':<7}{'RMS':>8}{'largest':>10}  {'at':<12}{'u':>8}{'band':>9}{'p':>9}   tool RMS",
    ]
    lines += [_error(found, error) for error in found.errors]
    for error in found.errors:
        notes = list(error.notes)
        if error.without_variance > 0.0:
            notes.append(
                f"up to {number(error.without_variance)} {readable(error.unit)} of the change are in directions without an uncertainty "
                "(a constant, a slope): not tested"
            )
        lines += [f"    {error.name}: {note}" for note in notes]
    if found.not_identified:
        lines += ["", "in neither calibration, because not identified"]
        lines += [f"  {one.name}: {one.why}" for one in found.not_identified]
    if found.not_compared:
        lines += ["", "not compared"]
    for one in found.not_compared:
        peak = f", up to {number(one.peak)} {readable(one.unit)}" if np.isfinite(one.peak) else ""
        file = {"first": found.first, "second": found.second, "both": ""}[one.given_by]
        lines.append(f"  {one.name}{f' (only in {file}{peak})' if file else ''}: {one.why}")
    return lines


def _row(name: str, row: ToolDisplacement, *, star: bool = False) -> str:
    beyond = "  *" if star and np.isfinite(row.limit_um) and row.rms_um > row.limit_um else ""
    return (
        f"  {name:<44}{number(row.rms_um):>8}{_value(row.limit_um):>9}{number(row.max_um):>9}{_value(row.u_max_um):>9}   "
        f"{place(row.where)}{beyond}"
    )


def _value(value: float) -> str:
    return number(value) if np.isfinite(value) else "unknown"


def _error(found: Changes, error: ErrorChange) -> str:
    own = readable(error.unit)
    at = f"{error.axis} {error.at:.0f}" if np.isfinite(error.at) else error.label
    name = f"{error.name} [{own}]" if own else error.name
    if error.status == "same":
        return f"  {name:<28}{error.iso_class:<7}{'identical numbers':>18}"
    judged = "  *" if error.significant else ""
    p = f"{error.p_adjusted:.2g}" if np.isfinite(error.p_adjusted) else "unknown"
    alone = found.tool.by_error.get(error.name)
    tool = f"{number(alone.rms_um):>8} µm" if alone else ""
    return (
        f"  {name:<27} {error.iso_class:<7}{number(error.rms):>8}{with_sign(error.largest):>10}  {at:<12}{_value(error.u):>8}"
        f"{_value(error.band):>9}{p:>9}{tool}{judged}"
    )
