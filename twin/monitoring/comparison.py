"""The result of a comparison of two calibrations, and its meaning in sentences that a technician can act on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from textwrap import wrap
from types import MappingProxyType
from typing import Any, Final, Literal, final

import numpy as np

from twin._common.messages import Message, Number, joined, say
from twin._common.provenance import ILLUSTRATIVE, SourceWarning, warning_texts, warnings_to_json
from twin._common.records import json_form
from twin.display import finite_or_none, first_rows, measured, note, readable, render, table
from twin.display.numbers import COVERAGE_FACTOR, UNKNOWN, capital
from twin.display.results import Display, DisplayedResult
from twin.display.sheet import Sheet
from twin.machine.machine import Machine
from twin.model.effects import split_name
from twin.model.effects.base import motion_in_words
from twin.monitoring.pairs import FALSE_ALARMS, FALSE_ALARMS_OF_A_TEST, ErrorChange, NotCompared
from twin.monitoring.tool import ToolChange, ToolDisplacement
from twin.tool.uncertainty import DEFINITION

SCHEMA: Final = "twin.monitoring/1"
Verdict = Literal["same", "unchanged", "changed", "reworded", "unknown"]
AT_TOOL: Final = MappingProxyType(
    {
        "judged": "judged_aligned",
        "by_class": "by_class_aligned",
        "by_cause": "fewest_alone_aligned",
        "by_error": "by_error_aligned",
    }
)
"""Keys in JSON of results after aligning the workpiece."""
CANCELLED_RATIO: Final = 0.05
"""Ratio of the joint effect of changes at the tool to their single effects below which they cancel."""


@final
@dataclass(frozen=True)
class Culprits:
    """The smallest set of errors that explains the change, all others taken as unchanged."""

    errors: tuple[ErrorChange, ...]  # strongest first; ``p_adjusted`` is corrected for all sets tried
    alternatives: tuple[tuple[str, ...], ...]  # for each, the errors that would explain the change equally well
    trends: tuple[str, ...]  # ``constant``, ``line``, ``bow``, ``turn`` (one wave per turn), or empty
    left_p_value: float  # p-value of the change they do not explain; NaN if nothing could be tested
    shows_from: tuple[tuple[str, float, str], ...] = ()  # (name, size, unit) found in 19 of 20 comparisons


@final
@dataclass(frozen=True, repr=False)
class Changes(DisplayedResult):
    """The changes between two calibrations of one machine."""

    machine: Machine
    first: str  # names of the two (their files)
    second: str
    errors: tuple[ErrorChange, ...]  # change of each error that both contain, tested by itself
    not_compared: tuple[NotCompared, ...]  # errors that could not be compared, with the reason
    not_identified: tuple[NotCompared, ...]  # in neither; U of the rest includes their plausible size
    joint_p_value: float  # of the χ² of all known changes together; NaN and 0 if none is known
    joint_dof: int
    culprits: Culprits
    tool: ToolChange
    tolerance_mm: float | None  # largest error at the tool that the older calibration may leave; None if not given
    left_out: tuple[tuple[str, str], ...]  # effects not included at the tool, with the channels they need
    notices: tuple[Message, ...]  # assumptions and limits
    meaning: tuple[str, ...] = ()  # in sentences
    warnings: tuple[SourceWarning, ...] = ()  # on the origin of the numbers of either

    @property
    def illustrative(self) -> bool:
        """Return whether either has illustrative curves, not measured ones."""
        return ILLUSTRATIVE in self.warnings

    @cached_property
    def seen_by(self) -> tuple[str, ...]:
        """Return which of the four tests detect a change: ``all together``, ``error by error``, ``fewest errors``, ``tool``."""
        seen = []
        if self.joint_p_value <= FALSE_ALARMS_OF_A_TEST:
            seen.append("all together")
        if any(error.significant for error in self.errors):
            seen.append("error by error")
        if self.culprits.errors:
            seen.append("fewest errors")
        if self.tool.judged is not None:
            rows = (self.tool.judged, *self.tool.by_class.values())
            if any(row.rms_um > row.limit_um for row in rows):
                seen.append("tool")
        return tuple(seen)

    @property
    def verdict(self) -> Verdict:
        """Return the verdict.

        ``changed`` if any of the four tests is significant; ``unchanged``; ``unknown`` if nothing could be tested; ``same`` for
        identical numbers; ``reworded`` if the numbers changed but their effects cancel at the tool, for example if a constant is
        attributed to a different error.
        """
        if self.seen_by:
            return "reworded" if self._cancelled else "changed"
        if not self.not_compared and all(error.status == "same" for error in self.errors):
            return "same"
        return "unchanged" if any(error.status == "known" for error in self.errors) else "unknown"

    @cached_property
    def _cancelled(self) -> bool:
        tool = self.tool
        if tool.judged is None or self.unjudged or tool.judged.rms_um > tool.judged.limit_um:
            return False
        names = {error.name for error in (*self.errors, *self.culprits.errors) if error.significant}
        alone = np.sqrt(sum(tool.by_error[name].rms_um ** 2 for name in names))
        return len(names) > 1 and bool(tool.judged.rms_um <= CANCELLED_RATIO * alone)

    @cached_property
    def stated(self) -> tuple[ErrorChange, ...]:
        """Return one statement on each error: that of the smallest set for its errors, the test by itself for all others.

        Beside a set that explains the change, the others are not significant: what each of them shows by itself is that change again.
        """
        named = {error.name: error for error in self.culprits.errors}
        return tuple(
            named.get(error.name, replace(error, p_adjusted=1.0) if self._explained and error.significant else error)
            for error in self.errors
        )

    @property
    def _explained(self) -> bool:
        return bool(self.culprits.errors) and self.culprits.left_p_value > FALSE_ALARMS_OF_A_TEST

    @property
    def unjudged(self) -> tuple[str, ...]:
        """Return the names of errors that could not be compared or tested (exit status 3 on the command line)."""
        return (
            *(one.name for one in self.not_compared),
            *(error.name for error in self.errors if error.status == "unknown" or error.without_variance > 0.0),
            *(name for name, _ in self.left_out),
        )

    @property
    def good_enough(self) -> bool | None:
        """Return whether the older calibration leaves less than the tolerance on the machine of the newer; None if undecided."""
        return None if self.tolerance_mm is None else self.tool.left.enough(self.tolerance_mm * 1e3)

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON (``schema: twin.monitoring/1``); null for unknown values."""
        culprits = self.culprits
        return {
            "schema": SCHEMA,
            "machine": self.machine.name,
            "first": self.first,
            "second": self.second,
            "illustrative": self.illustrative,
            "warnings": warnings_to_json(self.warnings),
            "verdict": self.verdict,
            "seen_by": list(self.seen_by),
            "false_alarms": {"of_all": FALSE_ALARMS, "of_each_look": FALSE_ALARMS_OF_A_TEST},
            "joint": {"p_value": finite_or_none(self.joint_p_value), "dof": self.joint_dof},
            "meaning": list(self.meaning),
            "errors": [error.to_dict() for error in self.errors],
            "fewest": {
                "errors": [
                    {**error.to_dict(), "alternatives": list(others), "trend": trend or None}
                    for error, others, trend in zip(
                        culprits.errors, culprits.alternatives, culprits.trends, strict=True
                    )
                ],
                "left_p_value": finite_or_none(culprits.left_p_value),
                "shows_from": [{"error": name, "size": size, "unit": unit} for name, size, unit in culprits.shows_from],
            },
            "not_compared": [json_form(one, rename={"name": "error"}) for one in self.not_compared],
            "not_identified": [{"error": one.name, "why": one.why} for one in self.not_identified],
            "left_out_at_tool": [{"effect": name, "needs": needs} for name, needs in self.left_out],
            "tool": json_form(self.tool, rename=AT_TOOL, leave_out=("left",)),
            "first_compensating_second": {
                **json_form(self.tool.left),
                "tolerance_mm": self.tolerance_mm,
                "good_enough": self.good_enough,
            },
            "unjudged": list(self.unjudged),
            "notices": list(self.notices),
        }

    @property
    def brief(self) -> str:
        """Verdict and change at the tool."""
        return f"{self.second} less {self.first}: {self.verdict}; at the tool {self._at_tool}"

    @property
    def _at_tool(self) -> str:
        whole = self.tool.everything_aligned
        return f"{whole.rms_um:.3g} µm RMS, {whole.max_um:.3g} µm largest"

    def to_text(self) -> str:
        """Return the text report."""
        return comparison_text(self)

    def to_html(self, sheet: Sheet | None = None) -> str:
        """Return one self-contained HTML page; ``sheet``: facts of the test, for a page that is handed over."""
        other = sorted((one for one in self.stated if one.status != "same"), key=lambda one: not one.significant)
        return render(
            "monitoring/templates/comparison.html.j2",
            title=joined("", [f"{self.machine.name}: ", VERDICTS[self.verdict]]),
            sheet=sheet,
            heading=Message("Comparison of two calibrations"),
            machine_name=self.machine.name,
            found=self,
            verdict=VERDICTS[self.verdict],
            badges=warning_texts(self.warnings),
            rows=[
                (
                    joined(", ", [capital(motion_in_words(error.name)), error.name])
                    if error.name.startswith("E_")
                    else error.name,
                    error.iso_class,
                    Number(_stated(error)),
                    answer(error.significant),
                    Number(number(self._alone_um(error))),
                )
                for error in other
            ],
            colour="#e8f3ea" if self.verdict in ("same", "unchanged", "reworded") else "#fdf2df",
        )

    def display(self) -> Display:
        """Return the meaning and the errors, the significant ones first."""
        other = [error for error in self.stated if error.status != "same"]
        other.sort(key=lambda error: (not error.significant, -self._alone_um(error)))
        shown, more = first_rows(len(other), lambda i: self._cells(other[i]))
        headers = (
            Message("error"),
            Message("class"),
            Message("largest change"),
            Message("significant"),
            Message("at the tool, µm RMS"),
        )
        rows = [
            (Message("at the tool, workpiece aligned"), self._at_tool),
            (Message("could not be compared or tested"), ", ".join(self.unjudged)),
        ]
        return Display(
            VERDICTS[self.verdict],
            rows,
            above=[note(sentence) for sentence in self.meaning],
            below=(table(headers, shown, right=(4,)), more),
            small=f"{self.second} less {self.first}",
            illustrative=self.illustrative,
            wrong=bool(self.unjudged),
        )

    def _cells(self, error: ErrorChange) -> tuple[str, ...]:
        return (
            error.name,
            error.iso_class,
            measured(error.largest, error.u, readable(error.unit)),
            answer(error.significant),
            f"{self._alone_um(error):.3g}" if error.name in self.tool.by_error else "",
        )

    def _alone_um(self, error: ErrorChange) -> float:
        """Return the RMS at the tool of the stated change of one error alone; zero if it was not tested."""
        found = self.tool.by_cause.get(error.name) or self.tool.by_error.get(error.name)
        return 0.0 if found is None else found.rms_um


VERDICTS: Final[Mapping[Verdict, Message]] = MappingProxyType(
    {
        "changed": Message("CHANGED"),
        "unchanged": Message("UNCHANGED"),
        "same": Message("IDENTICAL NUMBERS"),
        "reworded": Message("DIFFERENT NUMBERS, UNCHANGED AT THE TOOL"),
        "unknown": Message("UNKNOWN"),
    }
)
LOOKS: Final[Mapping[str, Message]] = MappingProxyType(
    {
        "all together": Message("all together"),
        "error by error": Message("error by error"),
        "fewest errors": Message("fewest errors"),
        "tool": Message("tool"),
    }
)
_ANSWERS: Final = (Message("no"), Message("yes"), Message("unknown"))


def answer(value: bool | None) -> Message:
    """Return yes, no or unknown."""
    return _ANSWERS[2 if value is None else value]


def _stated(error: ErrorChange) -> str:
    half = error.band if error.kind == "curve" else COVERAGE_FACTOR * error.u
    return f"{plus_minus(error.largest, half)} {readable(error.unit)}".replace("-", "−")


def number(value: float) -> str:
    """Return a number with three significant digits, without an exponent."""
    if value == 0.0 or not np.isfinite(value):
        return Number(f"{value:g}")
    digits = max(0, 2 - int(np.floor(np.log10(abs(value)))))
    return Number(f"{value:.{min(digits, 4)}f}")


def with_sign(value: float) -> str:
    """Return a number with three significant digits and its sign."""
    return Number(("+" if value > 0.0 else "") + number(value))


def plus_minus(value: float, half: float) -> str:
    """Return a change with half its 95 % interval, to two digits of that."""
    if not np.isfinite(half) or half <= 0.0:
        return with_sign(value)
    digits = min(max(0, 1 - int(np.floor(np.log10(half)))), 4)
    return Number(f"{value:+.{digits}f} ± {half:.{digits}f}")


def place(where: Mapping[str, float]) -> str:
    """Return positions by axis, in whole mm and degrees."""
    return ", ".join(f"{name} {value:.0f}" for name, value in where.items())


def some_of(names: Sequence[str], most: int) -> str:
    """Return the first names and the number of the others."""
    shown = joined(", ", names[:most])
    return shown if len(names) <= most else Message("{names} and {count} more", names=shown, count=len(names) - most)


def changed_in_words(found: Changes, error: ErrorChange, others: Sequence[str], trend: str, only: str) -> str:
    """Return one error of the smallest set, its change, its effect at the tool and its alternatives in a sentence."""
    half = error.band if error.kind == "curve" else COVERAGE_FACTOR * error.u
    axis = found.machine.by_name[error.axis]
    size = Number(f"{plus_minus(error.largest, half)} {readable(error.unit)}")
    named = joined(" ", [_error_in_words(error, found.machine), error.name])
    what = named if only else capital(named)
    if error.kind == "curve":
        shape = {
            "constant": Message(", the same all along {axis}", axis=error.axis),
            "line": Message(", linear along {axis}", axis=error.axis),
            "bow": Message(", parabolic along {axis}", axis=error.axis),
            "turn": Message(", with one wave per turn of {axis}", axis=error.axis),
        }.get(trend, "")
        text = Message(
            "{only}{what} changed, by up to {size} (95 %) at {axis} {at:.0f} {unit}{shape}",
            only=only,
            what=what,
            size=size,
            axis=error.axis,
            at=error.at,
            unit=axis.unit,
            shape=shape,
        )
    elif error.kind == "number":
        text = Message("{only}{what} changed, by {size} (95 %)", only=only, what=what, size=size)
    else:
        text = Message(
            "{only}{what} changed: {label} by {size} (95 %)", only=only, what=what, label=error.label, size=size
        )
    row = found.tool.by_cause.get(error.name)
    if row is not None:
        text += Message(
            ": {largest} µm at the tool at {where}, {rms} µm RMS over the volume",
            largest=number(row.max_um),
            where=place(row.where),
            rms=number(row.rms_um),
        )
    if others:
        text += Message("; a change of {others} instead would explain it about equally well", others=some_of(others, 3))
    return text + "."


def _error_in_words(error: ErrorChange, machine: Machine) -> str:
    if not error.name.startswith("E_"):
        return Message("the effect")
    component, average, axis = split_name(error.name)
    if average:
        if machine.by_name[axis].linear:
            return Message("the squareness")
        return (
            Message("the position of the average line of {axis},", axis=axis)
            if component < 3
            else Message("the orientation of the average line of {axis},", axis=axis)
        )
    return {
        "L-POS": Message("the positioning error"),
        "R-POS": Message("the positioning error"),
        "L-STR": Message("the straightness"),
        "R-RAX": Message("the axial or radial error motion"),
    }.get(error.iso_class, Message("the angular error motion"))


def common_pattern(found: Changes) -> list[str]:
    """Return what the changed errors have in common, and what to do, as at most one sentence or two."""
    errors, machine = found.culprits.errors, found.machine
    if any(found.culprits.alternatives):
        return [
            Message(
                "Measure again, with other poses, before adjusting anything: the changed error is not identified "
                "uniquely."
            )
        ]
    axes = list(dict.fromkeys(error.axis for error in errors))
    classes = {error.iso_class for error in errors}
    scales = [error for error in errors if error.iso_class == "L-POS" and error.kind == "curve"]
    lines = all(trend == "line" for trend in found.culprits.trends)
    if len(errors) == 1:
        return [_remedy(errors[0], found.culprits.trends[0], machine)]
    if len(scales) == len(errors) and lines and _same_slope(scales, machine):
        rates = Number(", ".join(f"{e.axis} {{:+.1f}} ± {{:.1f}} µm/m".format(*_rate(e, machine)) for e in scales))
        return [
            Message(
                "All scales changed alike ({rates}). Likely causes are an uncorrected temperature or the scale of "
                "the instrument (wavelength, refractive index). Check these before the machine.",
                rates=rates,
            )
        ]
    if len(axes) == 1:
        at = axes[0]
        if classes <= {"R-POR"}:
            return [
                Message(
                    "Only the location of {at} changed: the rotary table has moved as a whole or was set up again. "
                    "Check its mounting first.",
                    at=at,
                )
            ]
        return [
            Message(
                "All changes are at one axis, {at}. Likely causes are a collision, a loose part or wear of its "
                "guide, bearing or joint. Look there first; the numbers do not distinguish between these.",
                at=at,
            )
        ]
    if classes <= {"L-SQU"}:
        return [
            Message(
                "Only squareness changed: the axes have moved relative to each other, as after moving or levelling "
                "the machine."
            )
        ]
    return [
        Message(
            "Changes at several axes ({names}), as after a collision, after moving or levelling the machine, or if "
            "the two measurements were made under different conditions. Check temperature and set-up before working "
            "on the machine.",
            names=", ".join(axes),
        )
    ]


def _remedy(error: ErrorChange, trend: str, machine: Machine) -> str:
    newer = (
        Message("compensate with the newer calibration")
        if machine.runs_programs
        else Message("use the newer calibration")
    )
    _, average, axis = split_name(error.name) if error.name.startswith("E_") else (0, False, error.axis)
    if error.iso_class == "L-SQU":
        return Message("Re-align {axis}, or {newer}.", axis=axis, newer=newer)
    if error.name.startswith("reversal"):
        return Message(
            "The backlash of {axis} changed: check its drive (preload, bearing, belt), or {newer}.",
            axis=axis,
            newer=newer,
        )
    if average:
        return Message(
            "Re-measure the location of {axis} and enter it in the control, or {newer}.", axis=axis, newer=newer
        )
    if trend == "constant":
        return Message(
            "A constant change is a shift of {axis}'s zero or of the origin of the measurement: first check the "
            "reference run, and whether both measurements were touched off alike.",
            axis=axis,
        )
    if error.iso_class == "L-POS":
        return Message(
            "Check the temperature at which {axis}'s scale was measured; if it was right, {newer}.",
            axis=axis,
            newer=newer,
        )
    return Message("Check {axis}'s guide or bearing, or {newer}.", axis=axis, newer=newer)


def _rate(error: ErrorChange, machine: Machine) -> tuple[float, float]:
    """Return the slope of a linear change that is zero at mid-range, and its U (95 %), µm/m."""
    lo, hi = machine.by_name[error.axis].domain
    lever_mm = error.at - (lo + hi) / 2.0 or 1.0
    return error.largest / lever_mm * 1e3, abs(COVERAGE_FACTOR * error.u / lever_mm) * 1e3


def _same_slope(scales: Sequence[ErrorChange], machine: Machine) -> bool:
    rates, u = np.array([_rate(error, machine) for error in scales]).T
    if len(rates) < 2 or np.any(u <= 0.0):
        return False
    weight = u**-2
    mean = float(np.sum(weight * rates) / np.sum(weight))
    return bool(np.all(np.abs(rates - mean) <= 1.5 * u))


# --- A comparison as text for the terminal --------------------------------------------------------

WIDTH: Final = 120


def comparison_text(found: Changes) -> str:
    """Return the comparison in words and tables."""
    lines = [*_verdict(found), "", *_at_tool(found), "", *_errors(found)]
    for name, needs in found.left_out:
        lines.append(say("not included at the tool: {name} (needs {needs})", name=name, needs=needs))
    lines += [
        "",
        *wrap(
            say(
                "limit: upper limit of the RMS for an unchanged machine, from the uncertainties. {definition}. "
                "Aligned: without the common shift and rotation that touching off removes. *: significant. An "
                "unchanged machine is called changed in at most {count:.0f} of 100 comparisons.",
                definition=DEFINITION,
                count=FALSE_ALARMS * 100,
            ),
            WIDTH,
        ),
    ]
    for notice in found.notices:
        lines += wrap(say("note: {notice}", notice=notice), WIDTH, subsequent_indent="  ")
    return "\n".join(lines) + "\n"


def _verdict(found: Changes) -> list[str]:
    head = VERDICTS[found.verdict]
    if found.verdict == "unchanged" and found.unjudged:
        head = Message("UNCHANGED, where it could be tested")
    lines = [say("{name}: {second} less {first}", name=found.machine.name, second=found.second, first=found.first), ""]
    lines += [
        say("{title} (one or both): {sentence}", title=warning.title, sentence=warning.sentence)
        for warning in found.warnings
    ]
    lines += ["", say(head)] if found.warnings else [say(head)]
    for sentence in found.meaning:
        lines += wrap(say(sentence), WIDTH, initial_indent="  ", subsequent_indent="    ")
    return lines


def _at_tool(found: Changes) -> list[str]:
    tool, left = found.tool, found.tool.left
    every = Message("all but those not included") if found.left_out else Message("all errors")
    lines = [
        say(
            "at the tool, length {length:g} mm, {poses} poses over the volume, µm",
            length=tool.tool_length_mm,
            poses=tool.poses,
        ),
        f"  {'':<44}{'RMS':>8}{say('limit'):>9}{say('largest'):>9}{say('U there'):>9}   {say('where')}",
        _row(Message("{every}, not aligned", every=every), tool.everything),
        _row(Message("{every}, aligned", every=every), tool.everything_aligned, star=not found.unjudged),
    ]
    if tool.judged is not None:
        if found.unjudged:
            lines.append(_row(Message("those that could be tested, aligned"), tool.judged, star=True))
        lines += [_row(f"  {name}", row, star=True) for name, row in tool.by_class.items()]
    if left.poses:
        lines += [
            say("compensating with {first} on the machine of {second}:", first=found.first, second=found.second)
            if found.machine.runs_programs
            else say("taking out {first} on the machine of {second}:", first=found.first, second=found.second),
            f"  {say('remaining, workpiece aligned'):<44}{_value(left.rms_um):>8}{'':>9}{_value(left.max_um):>9}"
            f"{_value(left.u_max_um):>9}   {place(left.where)}",
            f"  {say('remaining, not aligned'):<44}{_value(left.as_it_is.rms_um):>8}{'':>9}{_value(left.as_it_is.max_um):>9}",
        ]
        if left.out_of_reach:
            lines.append(
                "  "
                + say(
                    "{count} of {poses} poses not included: compensated, they leave a travel range or a curve's domain",
                    count=left.out_of_reach,
                    poses=tool.poses,
                )
            )
    return lines


def _errors(found: Changes) -> list[str]:
    lines = [
        say(
            "each error; those named above as estimated there, all others by themselves; u: standard uncertainty (k "
            "= 1); band: 95 % for the whole curve; p: corrected for all tests"
        ),
        f"  {'':<28}{say('class'):<7}{'RMS':>8}{say('largest'):>10}  {say('at'):<12}{'u':>8}{say('band'):>9}{'p':>9}"
        f"   {say('tool RMS')}",
    ]
    lines += [_error(found, error) for error in found.stated]
    for error in found.errors:
        notes = list(error.notes)
        if error.without_variance > 0.0:
            notes.append(
                Message(
                    "up to {size} {unit} of the change are in directions without an uncertainty (a constant, a "
                    "slope): not tested",
                    size=number(error.without_variance),
                    unit=readable(error.unit),
                )
            )
        lines += [f"    {error.name}: {say(note)}" for note in notes]
    if found.not_identified:
        lines += ["", say("in neither calibration, because not identified")]
        lines += [f"  {one.name}: {say(one.why)}" for one in found.not_identified]
    if found.not_compared:
        lines += ["", say("not compared")]
    for one in found.not_compared:
        peak = (
            Message(", up to {peak} {unit}", peak=number(one.peak), unit=readable(one.unit))
            if np.isfinite(one.peak)
            else ""
        )
        file = {"first": found.first, "second": found.second, "both": ""}[one.given_by]
        only = say(" (only in {file}{peak})", file=file, peak=peak) if file else ""
        lines.append(f"  {one.name}{only}: {say(one.why)}")
    return lines


def _row(name: str, row: ToolDisplacement, *, star: bool = False) -> str:
    beyond = "  *" if star and np.isfinite(row.limit_um) and row.rms_um > row.limit_um else ""
    return (
        f"  {say(name):<44}{_value(row.rms_um):>8}{_value(row.limit_um):>9}{_value(row.max_um):>9}{_value(row.u_max_um):>9}   "
        f"{place(row.where)}{beyond}"
    )


def _value(value: float) -> str:
    return say(number(value) if np.isfinite(value) else UNKNOWN)


def _error(found: Changes, error: ErrorChange) -> str:
    own = readable(error.unit)
    at = f"{error.axis} {error.at:.0f}" if np.isfinite(error.at) else error.label
    name = f"{error.name} [{own}]" if own else error.name
    if error.status == "same":
        return f"  {name:<28}{error.iso_class:<7}{say('identical numbers'):>18}"
    judged = "  *" if error.significant else ""
    p = say(Number(f"{error.p_adjusted:.2g}") if np.isfinite(error.p_adjusted) else UNKNOWN)
    alone = found.tool.by_cause.get(error.name) or found.tool.by_error.get(error.name)
    tool = f"{_value(alone.rms_um):>8} µm" if alone else ""
    return (
        f"  {name:<27} {error.iso_class:<7}{_value(error.rms):>8}{say(with_sign(error.largest)):>10}  {at:<12}{_value(error.u):>8}"
        f"{_value(error.band):>9}{p:>9}{tool}{judged}"
    )
