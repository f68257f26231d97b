"""The forecast of a part: tolerances with their probability in words, the blocks, the actions, as text, JSON and a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from twin._common.messages import Message, Number, joined, say
from twin._common.provenance import SourceWarning, warning_texts
from twin._common.records import json_form
from twin._common.units import MM, UM, count_with_noun
from twin.display import render
from twin.display.numbers import capital, listed
from twin.display.results import Result
from twin.display.sheet import Sheet
from twin.part.features import Tolerance
from twin.part.improvements import CERTAIN, SETUP, BetterPlace, Remeasured
from twin.part.made import TEMPERATURE, MadeFeature

SCHEMA: Final = "twin.forecast/1"
CONFORMS, FAILS = CERTAIN, 0.05
NOT_CONTAINED: Final = Message(
    "Not contained: deflection, wear, size and run-out of the tool, clamping, cutting forces, vibration, dynamics of the control, and "
    "errors that the calibration does not know."
)
SMALLEST_SHARE: Final = 0.02
"""Share of a value below which an error's part in it is not printed."""
COLOURS: Final = {"held": "#009e73", "open": "#e69f00", "exceeded": "#d55e00"}
GREY: Final = "#b5b5b5"
"""Colour of a feature that no tolerance names."""
PALE: Final = {"held": "#e8f3ea", "open": "#fdf2df", "exceeded": "#fbe4de"}
UNCERTAIN: Final = {
    SETUP: Message("the part's place on the table"),
    TEMPERATURE: Message("temperature of the part"),
}
KINDS: Final = {
    str(name): name
    for name in (
        Message("position"),
        Message("flatness"),
        Message("roundness"),
        Message("perpendicularity"),
        Message("parallelism"),
        Message("angularity"),
        Message("coaxiality"),
        Message("profile"),
    )
}


@final
@dataclass(frozen=True)
class Conformity:
    """A tolerance's value on the machines that the calibration allows.

    Attributes:
        value_um: on the machine as calibrated.
        upper_um: value that 95 % of the machines do not exceed.
        probability: share of the machines on which the tolerance is held.

    ``upper_um`` and ``probability`` are NaN if the calibration gives no uncertainty.
    """

    value_um: float
    upper_um: float
    probability: float

    @property
    def verdict(self) -> str:
        """``held``, ``exceeded`` or ``open``."""
        if np.isnan(self.probability):
            return "open"
        return "held" if self.probability >= CONFORMS else "exceeded" if self.probability <= FAILS else "open"

    def words(self, zone_um: float) -> Message:
        """Return the verdict with its probability in words."""
        p = self.probability
        if np.isnan(p):
            within = self.value_um <= zone_um
            return (
                Message("open: the value is within the zone, its uncertainty is not known")
                if within
                else Message("open: the value exceeds the zone, its uncertainty is not known")
            )
        share = Number(">99" if p > 0.99 else "<1" if p < 0.01 else f"{100.0 * p:.0f}")
        if p > 0.99:
            return Message("held, practically certain ({share} %)", share=share)
        if p >= CONFORMS:
            return Message("held, very likely ({share} %)", share=share)
        if p < 0.01:
            return Message("not held, practically certain ({share} %)", share=share)
        if p <= FAILS:
            return Message("not held, very likely ({share} %)", share=share)
        if p >= 0.5:
            return Message("open, rather held ({share} %)", share=share)
        return Message("open, rather not held ({share} %)", share=share)

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object; unknown numbers are null."""
        known = not np.isnan(self.probability)
        return {
            "value_um": self.value_um,
            "upper_um": self.upper_um if known else None,
            "probability": self.probability if known else None,
            "verdict": self.verdict,
        }


@final
@dataclass(frozen=True)
class ForecastTolerance:
    """The forecast of one tolerance.

    Attributes:
        tolerance: as in the part's file.
        before: with the program as it is.
        after: with the compensated program; None if the program cannot be compensated.
        by_error: what each error of the machine adds to the value before, µm: largest first.
        worst: the feature of a pattern that decides.
        remeasured: of the better program, if it is open: what measuring errors again would give.
    """

    tolerance: Tolerance
    before: Conformity
    after: Conformity | None
    by_error: tuple[tuple[str, float], ...]
    worst: str
    remeasured: Remeasured | None = None

    @property
    def title(self) -> str:
        """Name, or kind, zone and features in the language of the page."""
        one = self.tolerance
        if one.name:
            return one.name
        datums = f" | {' | '.join(one.datums)}" if one.datums else ""
        return (
            Message(
                "{kind} {zone} of {features}",
                kind=KINDS[one.kind],
                zone=Number(f"{one.zone:g}"),
                features=listed([*one.features], most=5),
            )
            + datums
        )

    @property
    def zone_um(self) -> float:
        """Width or diameter of the zone, µm."""
        return self.tolerance.zone * MM / UM

    @property
    def verdict(self) -> str:
        """The better verdict of both programs."""
        both = {self.before.verdict, *(() if self.after is None else (self.after.verdict,))}
        return next(one for one in ("held", "open", "exceeded") if one in both)

    @property
    def largest(self) -> str:
        """Errors that contribute most, with what the value loses without each, µm; empty if none does."""
        return joined(
            ", ",
            [
                Message("{name} {size} µm", name=UNCERTAIN.get(name, name), size=Number(f"{value:.1f}"))
                for name, value in self.by_error[:3]
                if value > SMALLEST_SHARE * self.before.value_um
            ],
        )

    @property
    def action(self) -> str:
        """The action, in words."""
        if self.before.verdict == "held":
            return Message("none")
        if self.after is not None and self.after.verdict == "held":
            return Message("run the compensated program")
        said: list[str] = []
        if self.after is not None and self.after.value_um < self.before.value_um:
            said.append(Message("run the compensated program"))
        if self.remeasured is not None:
            errors = [UNCERTAIN.get(one, one) for one in self.remeasured.errors]
            said.append(
                Message(
                    "measure {errors} again: known exactly, up to {upper} µm (95 %), {share} % held",
                    errors=joined(", ", errors),
                    upper=Number(f"{self.remeasured.upper_um:.1f}"),
                    share=Number(f"{100.0 * self.remeasured.probability:.0f}"),
                )
            )
        elif np.isnan(self.before.probability):
            said.append(Message("give the calibration its uncertainty: identify it from readings"))
        elif self.verdict == "exceeded" and self.largest:
            said.append(
                Message(
                    "adjust the machine or use another one; without each of these it is less: {errors}",
                    errors=self.largest,
                )
            )
        return joined("; ", said) if said else Message("use another machine or a wider zone")

    def row(self) -> list[str]:
        """Return the two lines of text: values and verdicts, before and after."""
        rows = []
        for what, found in ((Message("as programmed"), self.before), (Message("compensated"), self.after)):
            if found is not None:
                rows.append(f"  {say(what):<17} {say(_figures(found, self.zone_um))}: {say(found.words(self.zone_um))}")
        return rows


def _figures(found: Conformity, zone_um: float) -> Message:
    value, zone = Number(f"{found.value_um:.1f}"), Number(f"{zone_um:g}")
    if np.isnan(found.probability):
        return Message("{value} of {zone} µm", value=value, zone=zone)
    upper = Number(f"{found.upper_um:.1f}")
    return Message("{value} of {zone} µm, up to {upper} µm (95 %)", value=value, zone=zone, upper=upper)


@final
@dataclass(frozen=True, eq=False, repr=False)
class PartForecast(Result):
    """Forecast of the tolerances of a part, for a program on a machine with the errors of a calibration.

    Attributes:
        part, program, machine: names.
        tolerances: the forecast of each, as in the part's file.
        features: the points of each feature that the program cuts.
        omitted: parts of the program that could not be executed, in words.
        compensated: why there is no compensated program, in words; empty if there is one.
        machines: number of machines drawn.
        warnings: of the calibration.
        without_uncertainty: errors whose uncertainty is not known: probabilities do not contain it.
        better_place: of the part; None if none was searched or found.
        searched: whether a better place was searched.
        points_mm: (n, 3) points of each feature in the part's frame, for pictures.
        zero_mm: (3,) place of the part's zero in the work frame.
    """

    part: str
    program: str
    machine: str
    tolerances: tuple[ForecastTolerance, ...]
    features: Mapping[str, MadeFeature]
    omitted: str
    compensated: str
    machines: int
    warnings: tuple[SourceWarning, ...]
    without_uncertainty: tuple[str, ...]
    better_place: BetterPlace | None = None
    searched: bool = False
    points_mm: Mapping[str, np.ndarray] | None = None
    zero_mm: np.ndarray | None = None

    def in_work_frame(self) -> list[tuple[np.ndarray, float]]:
        """Return the points (n, 3) of each judged feature in the work frame, mm, and its smallest probability, for `twin.scene`.

        The probability of conformity is that of the program as it is; NaN if unknown.
        """
        if self.points_mm is None or self.zero_mm is None:
            return []
        found: dict[str, float] = {}
        for one in self.tolerances:
            for name in one.tolerance.features:
                found[name] = float(np.minimum(one.before.probability, found.get(name, 1.0)))
        return [(self.points_mm[name] + self.zero_mm, p) for name, p in found.items()]

    @property
    def headline(self) -> Message:
        """Number of tolerances that are held, in words."""
        count, held, best = len(self.tolerances), self._held("before"), self._held("verdict")
        if held == count:
            return Message("The program holds all {count} tolerances as it is", count=count)
        if best == count:
            return Message(
                "Compensated, the program holds all {count} tolerances; as it is, {held}", count=count, held=held
            )
        if any(one.verdict == "exceeded" for one in self.tolerances):
            return Message(
                "The program does not hold {bad} of {count} tolerances",
                count=count,
                bad=sum(one.verdict == "exceeded" for one in self.tolerances),
            )
        return Message("{open} of {count} tolerances are open", open=count - best, count=count)

    def _held(self, which: str) -> int:
        return sum((one.before.verdict if which == "before" else one.verdict) == "held" for one in self.tolerances)

    def place_words(self) -> list[str]:
        """Return what another place of the part would give, in words; empty if none was searched."""
        if self.better_place is None:
            return (
                [Message("no place within the axis ranges makes the worst tolerance a tenth smaller")]
                if self.searched
                else []
            )
        one = self.better_place
        shift = ", ".join(f"{name} {value:+.0f} mm" for name, value in zip("xyz", one.shift_mm, strict=True))
        words: list[str] = [
            Message("clamp the part at {shift} from where it is, axes of the table", shift=Number(shift))
        ]
        if one.turn_deg:
            by = (
                Message("axis {axis} turned with it", axis=one.axis)
                if one.axis
                else Message("the program turned with it")
            )
            words.append(Message("turned by {angle:.0f}° about the table's z ({how})", angle=one.turn_deg, how=by))
        found: list[str] = [joined(", ", words)]
        for tolerance, gain in zip(self.tolerances, one.gains, strict=True):
            low, high = gain.gain_um
            text = Message(
                "{title}: {here} becomes {there} µm",
                title=tolerance.title, here=Number(f"{gain.here_um:.1f}"), there=Number(f"{gain.there_um:.1f}"),
            )  # fmt: skip
            found.append(
                text + Message(" (gain not certain: the calibration gives no uncertainty)")
                if np.isnan(low)
                else text
                + Message(
                    " (gain {low} to {high} µm, 95 %; probability {before} becomes {after} %)",
                    low=Number(f"{low:.1f}"),
                    high=Number(f"{high:.1f}"),
                    before=Number(f"{100.0 * gain.probabilities[0]:.0f}"),
                    after=Number(f"{100.0 * gain.probabilities[1]:.0f}"),
                )
            )
        return found

    def blocks(self) -> Sequence[tuple[str, str, str, str, str]]:
        """Return what makes each feature: name, tool, lines, how, distance of the program itself from the surface."""
        rows = []
        for name, made in self.features.items():
            first, last = made.lines
            lines = f"{first}" if first == last else f"{first} – {last}"
            how = Message("tip of the tool") if made.drilled else Message("shape of the tool")
            rows.append((name, made.tool, lines, how, Number(f"{made.program_um:.1f}")))
        return rows

    def to_text(self) -> str:
        """Return the forecast in words."""
        drawn = Message("{count:,} machines drawn from the calibration's covariance", count=self.machines)
        title = Message(
            "Forecast of {part}: {program} on {machine}", part=self.part, program=self.program, machine=self.machine
        )
        lines = [say(title) + (f", {say(drawn)}" if self.machines > 1 else ""), *map(say, warning_texts(self.warnings))]
        lines += [say(text) for text in self.notes()[:1] if self.without_uncertainty and self.machines > 1]
        for one in self.tolerances:
            lines += ["", say(one.title), *one.row()]
            if one.largest:
                lines.append(f"  {say('without'):<17} {say(Message('{errors} less', errors=one.largest))}")
            if len(one.tolerance.features) > 1:
                lines.append(f"  {say('decided by'):<17} {one.worst}")
            lines.append(f"  {say('action'):<17} {say(one.action)}")
        lines += ["", *(capital(say(text)) for text in self.place_words()), ""]
        for name, tool, blocks, how, off in self.blocks():
            own = Message(", the program itself up to {size} µm away", size=off)
            made = Message(
                "{points} points by the {how}, tool {tool}, lines {lines}",
                points=self.features[name].points,
                how=how,
                tool=tool,
                lines=blocks,
            )
            lines.append(f"{name}: {say(made)}" + (say(own) if self.features[name].program_um >= 0.05 else ""))
        rest = self.notes()[1 if self.without_uncertainty and self.machines > 1 else 0 :]
        return "\n".join([*lines, *map(say, rest), say(NOT_CONTAINED), ""])

    def notes(self) -> list[str]:
        """Return what limits the forecast."""
        found: list[str] = []
        if self.without_uncertainty and self.machines > 1:
            names = listed([*self.without_uncertainty], most=6)
            found.append(Message("without uncertainty, so that probabilities are too certain: {names}", names=names))
        if self.omitted:
            found.append(Message("not executed, and not part of the forecast: {text}", text=self.omitted))
        if self.compensated:
            found.append(Message("no compensated program: {text}", text=self.compensated))
        return found

    def to_html(self, sheet: Sheet | None = None) -> str:
        """Return one self-contained HTML page; ``sheet``: facts of the test, for a page that is handed over."""
        worst = min((one.verdict for one in self.tolerances), key=("exceeded", "open", "held").index)
        return render(
            "part/templates/forecast.html.j2",
            title=Message(
                "Forecast of {part}: {program} on {machine}", part=self.part, program=self.program, machine=self.machine
            ),
            heading=Message("Forecast of a part's tolerances"),
            found=self,
            sheet=sheet,
            machine_name=self.machine,
            badges=warning_texts(self.warnings),
            colour=PALE[worst],
            colours=COLOURS,
            picture=self._picture(),
            not_contained=NOT_CONTAINED,
            strip=strip,
            figures=_figures,
        )

    def _picture(self) -> dict[str, Any]:
        """Return the part seen obliquely: features as points in the colour of their verdict, in a box of 100 units' width."""
        verdicts = self.verdicts()
        points = {name: np.asarray(one) for name, one in (self.points_mm or {}).items()}
        if not points:
            return {}
        turn, tilt = np.radians(-30.0), np.radians(35.0)
        right = np.array([np.cos(turn), -np.sin(turn), 0.0])
        up = np.array([np.sin(tilt) * np.sin(turn), np.sin(tilt) * np.cos(turn), np.cos(tilt)])
        flat = {name: np.column_stack([one @ right, -(one @ up)]) for name, one in points.items()}
        every = np.concatenate([*flat.values()])
        low, size = every.min(axis=0), max(float(np.ptp(every, axis=0).max()), 1e-9)
        drawn = {name: (one - low) / size * 92.0 + 4.0 for name, one in flat.items()}
        height = float(np.ptp(every[:, 1])) / size * 92.0 + 8.0
        labels: dict[str, np.ndarray] = {}
        for name, one in sorted(
            ((name, drawn[name]) for name in verdicts if name in drawn), key=lambda item: len(item[1])
        ):
            free = [
                p
                for p in one[:: max(1, len(one) // 40)]
                if all(np.abs(p - q) @ [0.5, 1.0] > 6.0 for q in labels.values())
            ]
            labels[name] = min(free or [one[0]], key=lambda p: float(np.linalg.norm(p - one.mean(axis=0))))
        return {
            "height": round(height, 1),
            "features": [
                {
                    "name": name,
                    "colour": COLOURS[verdicts[name]] if name in verdicts else GREY,
                    "dots": [(round(float(x), 1), round(float(y), 1)) for x, y in np.unique(one.round(1), axis=0)],
                    "at": [round(float(v), 1) for v in labels[name]] if name in labels else None,
                }
                for name, one in sorted(drawn.items(), key=lambda item: item[0] in verdicts)
            ],
        }

    def verdicts(self) -> dict[str, str]:
        """Return the worst verdict of each feature, with the better program."""
        order = ("exceeded", "open", "held")
        found: dict[str, str] = {}
        for one in self.tolerances:
            for name in one.tolerance.features:
                found[name] = min(one.verdict, found.get(name, "held"), key=order.index)
        return found

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object; unknown numbers are null."""
        return {
            "schema": SCHEMA,
            "part": self.part,
            "program": self.program,
            "machine": self.machine,
            "machines": self.machines,
            "headline": self.headline,
            "tolerances": [
                {
                    "title": one.tolerance.title,
                    "kind": one.tolerance.kind,
                    "zone_um": one.zone_um,
                    "before": one.before.to_dict(),
                    "after": None if one.after is None else one.after.to_dict(),
                    "worst": one.worst,
                    "by_error_um": dict(one.by_error),
                    "remeasured": None if one.remeasured is None else json_form(one.remeasured),
                    "action": one.action,
                }
                for one in self.tolerances
            ],
            "features": {name: json_form(made) for name, made in self.features.items()},
            "better_place": None if self.better_place is None else json_form(self.better_place),
            "without_uncertainty": list(self.without_uncertainty),
            "omitted": self.omitted or None,
            "not_compensated": self.compensated or None,
            "not_contained": NOT_CONTAINED,
            "warnings": warning_texts(self.warnings),
        }

    @property
    def met(self) -> bool:
        """Whether every tolerance is held by one of the programs."""
        return all(one.verdict == "held" for one in self.tolerances)

    @property
    def brief(self) -> str:
        """Number of tolerances that are held, before and after."""
        after = [one.after for one in self.tolerances if one.after is not None]
        text = f"{self._held('before')} of {count_with_noun(len(self.tolerances), 'tolerance')} held"
        return f"{text}; compensated: {sum(one.verdict == 'held' for one in after)}" if after else text


def strip(one: ForecastTolerance) -> dict[str, Any]:
    """Return places, in per cent of a strip's width, of the zone's end, and of value and upper limit before and after."""
    found = [part for part in (one.before, one.after) if part is not None]
    scale = 94.0 / np.nanmax([1.15 * one.zone_um, *(v for part in found for v in (part.value_um, part.upper_um))])
    rows = [
        (scale * part.value_um, scale * np.fmax(part.upper_um, part.value_um), COLOURS[part.verdict]) for part in found
    ]
    return {
        "zone": round(scale * one.zone_um, 1),
        "rows": [(round(value, 1), round(upper, 1), colour) for value, upper, colour in rows],
    }
