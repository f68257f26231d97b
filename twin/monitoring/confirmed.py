"""The verdict of a confirmation (`twin.monitoring.confirmation`): what took effect, what moved, in words, as JSON and as a page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, final

import numpy as np

from twin._common.messages import Message, Number, joined, say
from twin._common.provenance import SourceWarning, warning_texts, warnings_to_json
from twin.display import readable, render
from twin.display.numbers import listed
from twin.display.results import Result
from twin.display.sheet import Sheet
from twin.machine.machine import Machine

SCHEMA: Final = "twin.confirmation/1"
MOST_EXPANDED: Final = 10.0  # U of a factor from which nothing of it is seen
MOST_ALTERNATIVES: Final = 8
HEADS: Final = (
    Message("written value"),
    Message("effect at the tool, µm RMS"),
    Message("acts … times (U 95 %)"),
    Message("these readings say"),
)
SAYS: Final[Mapping[str, Message]] = {
    text: text
    for text in (
        Message("as written"),
        Message("absent"),
        Message("reversed"),
        Message("otherwise"),
        Message("not shown"),
    )
}
Verdict = Literal["confirmed", "undecided", "not in effect", "wrong", "changed otherwise", "unchanged", "moved"]
VERDICTS: Final = {
    "confirmed": Message("confirmed"),
    "undecided": Message("undecided"),
    "not in effect": Message("not in effect"),
    "wrong": Message("wrong"),
    "changed otherwise": Message("changed otherwise"),
    "unchanged": Message("unchanged"),
    "moved": Message("moved"),
}


@final
@dataclass(frozen=True)
class ConfirmedValue:
    """One written value and what the readings say of it.

    Attributes:
        effect_um: its effect at the tool point, RMS over the volume.
        factor: how many times it acts: 1 as written, 0 not, −1 reversed.
        expanded: U of the factor (95 %), the other values free.
        matters: whether its effect is large enough to count.
        says: ``as written``, ``absent``, ``reversed``, ``otherwise``; ``not shown`` where these readings do not exclude that it is
            absent or reversed by one mistake, alone or with a second one.
    """

    name: str
    effect_um: float
    factor: float
    expanded: float
    matters: bool
    says: str


@final
@dataclass(frozen=True)
class MovedError:
    """A constant error that changed.

    Attributes:
        size: change with ``expanded`` (95 %), in ``unit``.
        tool_um: largest displacement of the tool point by it over the volume.
        words: the error in words.
        look: where to look.
    """

    name: str
    size: float
    expanded: float
    unit: str
    tool_um: float
    words: str
    look: str


@final
@dataclass(frozen=True)
class MotionBound:
    """Upper bound, 95 %, of how far scales, squareness and locations moved the tool point, µm.

    Attributes:
        box_um: over the positions that the readings span.
        volume_um: over the whole volume.
        unseen: names of the errors whose change these readings do not show.
    """

    box_um: float
    volume_um: float
    box: Mapping[str, tuple[float, float]]
    unseen: tuple[str, ...]


@final
@dataclass(frozen=True, repr=False)
class Confirmation(Result):
    """Verdict on what was written into a machine, or on what a crash moved.

    Attributes:
        findings: what is not as written, one sentence each, the verdict's reason.
        alternatives: what the readings do not distinguish from it.
        before_um, expected_um, expanded_um, measured_um: RMS error of the tool point over the volume: before, expected afterwards
            with U (95 %), and as measured; without the errors that no reading determines. NaN without
            written values or their uncertainty.
        tool_length_mm: length of the tool.
        p_value: of χ² of the residuals that remain.
        noise: standard deviation of the readings, in units of the stated one.
    """

    machine: Machine
    verdict: Verdict
    findings: tuple[str, ...]
    alternatives: tuple[str, ...]
    values: tuple[ConfirmedValue, ...]
    moved: tuple[MovedError, ...]
    tool_length_mm: float
    before_um: float
    expected_um: float
    expanded_um: float
    measured_um: float
    bound: MotionBound
    p_value: float
    noise: float
    readings: int
    notices: tuple[Message, ...]
    warnings: tuple[SourceWarning, ...]

    @property
    def met(self) -> bool:
        """Whether everything is confirmed, or nothing moved."""
        return self.verdict in ("confirmed", "unchanged")

    @property
    def headline(self) -> str:
        """The verdict in one line."""
        if self.verdict == "unchanged":
            return Message("nothing moved the tool by more than {size} µm", size=_figure(self.bound.box_um))
        said = joined("; ", self.findings) if self.findings else VERDICTS[self.verdict]
        if not np.isfinite(self.measured_um):
            return said
        before, expected, measured = map(_figure, (self.before_um, self.expected_um, self.measured_um))
        half = f"{self.expanded_um:.{0 if min(self.expected_um / 9.95, self.expanded_um) >= 1.0 else 1}f}"
        return Message(
            "before {before}, expected {expected} ± {half}, measured {measured} µm: {said}",
            before=before,
            expected=expected,
            half=Number(half),
            measured=measured,
            said=said,
        )

    @property
    def brief(self) -> str:
        """Machine and headline."""
        return Message("{machine}: {text}", machine=self.machine.name, text=self.headline)

    @property
    def to_measure(self) -> tuple[str, ...]:
        """Names of the written values that matter and that these readings do not show."""
        if self.verdict != "undecided":
            return ()
        return tuple(value.name for value in self.values if value.matters and value.says == "not shown")

    def table(self) -> list[tuple[str, str, str, str]]:
        """Return every written value: name, effect at the tool, factor, what the readings say."""
        return [
            (
                value.name,
                f"{value.effect_um:.1f}",
                f"{value.factor:.2f} ± {value.expanded:.2f}" if value.expanded < MOST_EXPANDED else Message("not seen"),
                SAYS[value.says]
                if value.matters or value.says != "not shown"
                else Message("not shown, too small to matter"),
            )
            for value in self.values
        ]

    def sentences(self) -> list[Message]:
        """Return what belongs to the headline: what is not excluded, what moved and where to look, the bound, what to measure."""
        said = [
            Message("these readings do not exclude: {text}", text=text)
            for text in self.alternatives[:MOST_ALTERNATIVES]
        ]
        said += [
            Message(
                "{words} ({name}) changed by {size} ± {half} {unit}, up to {tool} µm at the tool. {look}",
                words=one.words,
                name=one.name,
                size=Number(f"{one.size:+.3g}"),
                half=Number(f"{one.expanded:.2g}"),
                unit=readable(one.unit),
                tool=_figure(one.tool_um),
                look=one.look,
            )
            for one in self.moved
        ]
        bound = self.bound
        if not self.values:
            where = ", ".join(f"{name} {low:.0f} … {high:.0f}" for name, (low, high) in bound.box.items())
            text = Message(
                "scales, squareness and locations moved the tool by at most {box} µm (95 %) where the readings are ({where}), "
                "{volume} µm over the volume",
                box=_figure(bound.box_um),
                where=where,
                volume=_figure(bound.volume_um),
            )
            said.append(Message("besides, {text}", text=text) if self.moved else text)
        if bound.unseen:
            said.append(
                Message(
                    "a change of {names} is not seen by these readings: stations and targets set up anew hide it, or its axis rests",
                    names=", ".join(bound.unseen),
                )
            )
        if self.to_measure:
            said.append(
                Message(
                    "to decide, measure what shows {names}: twin plan --confirm makes the shortest measurement",
                    names=listed(list(self.to_measure)),
                )
            )
        return said

    def to_text(self) -> str:
        """Return the text report."""
        lines = [say(self.brief), *map(say, warning_texts(self.warnings)), ""]
        if self.values:
            figures = Message(
                "figures: RMS error of the tool point over the volume, tool length {length:g} mm, from the calibration and {count:,} "
                "readings; ± U (95 %), without what no reading determines. As written: neither one mistake nor two explain the "
                "readings; acts … times: with all other values free, too",
                length=self.tool_length_mm,
                count=self.readings,
            )
            name, effect, acts, says = map(say, HEADS)
            lines += [say(figures), "", f"{name:<38}{effect:>26}{acts:>24}   {says}"]
            lines += [f"  {a:<36}{b:>26}{say(c):>24}   {say(d)}" for a, b, c, d in self.table()]
            lines.append("")
        lines += [*map(say, self.sentences()), *(f"{say('note')}: {say(text)}" for text in self.notices)]
        return "\n".join(lines) + "\n"

    def to_html(self, sheet: Sheet | None = None) -> str:
        """Return one self-contained HTML page; ``sheet``: facts of the test, for a page that is handed over."""
        return render(
            "monitoring/templates/confirmation.html.j2",
            title=self.brief,
            found=self,
            sheet=sheet,
            heading=Message("Confirmation of a correction") if self.values else Message("Check of a machine tool"),
            machine_name=self.machine.name,
            badges=warning_texts(self.warnings),
            heads=HEADS,
            colour="#e8f3ea" if self.met else "#fdf2df" if self.verdict == "undecided" else "#fbe4de",
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object (``schema: twin.confirmation/1``); unknown numbers are null."""
        figures = {
            name: getattr(self, name)
            for name in ("before_um", "expected_um", "expanded_um", "measured_um", "p_value", "noise")
        }
        return {
            "schema": SCHEMA,
            "machine": self.machine.name,
            "verdict": self.verdict.replace(" ", "_"),
            "headline": self.headline,
            "findings": list(self.findings),
            "not_excluded": list(self.alternatives),
            **{name: value if np.isfinite(value) else None for name, value in figures.items()},
            "tool_length_mm": self.tool_length_mm,
            "readings": self.readings,
            "written": [vars(value) for value in self.values],
            "to_measure": list(self.to_measure),
            "moved": [vars(one) for one in self.moved],
            "bound": {**vars(self.bound), "box": {name: list(ends) for name, ends in self.bound.box.items()}},
            "notices": list(self.notices),
            "warnings": warnings_to_json(self.warnings),
        }


def _figure(value: float) -> str:
    return Number(f"{value:.0f}" if not abs(value) < 9.95 else f"{value:.1f}")
