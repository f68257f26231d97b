"""What a diagnosis says, in values, words and JSON (contract §4)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, final

import numpy as np

from twin._common.provenance import SIMULATED, SourceWarning, merged, to_json
from twin.machine.calibration import Calibration
from twin.machine.effects import Effect
from twin.measurement.table import Measurements

SCHEMA: Final = "twin.diagnosis/1"
Next = Mapping[str, Any]
"""A point worth measuring next, as the JSON has it."""
Verdict = Literal["consistent", "explained", "ambiguous", "unexplained"]


@final
@dataclass(frozen=True)
class Quantity:
    """One number found: value and standard uncertainty in a unit."""

    name: str
    value: float
    unit: str
    u: float


@final
@dataclass(frozen=True)
class Rival:
    """The best of what was tried in a cause's place, the other causes kept, and is ruled out.

    Attributes:
        effect, where: contract §5.
        share: of the excess residual sum of squares that it would explain there.
        log_odds: natural log of how many times less likely it is, the price of both searches paid.
    """

    effect: str
    where: str
    share: float
    log_odds: float


@final
@dataclass(frozen=True)
class Cause:
    """One cause found.

    Attributes:
        effect, where, origin: contract §5.
        parameters: with standard uncertainties.
        p_value: of what it explains given the other causes, the search paid for.
        share: of the excess residual sum of squares.
        equivalent: (effect, where) of what these data cannot tell from it.
        evidence: one sentence a machinist can read.
        pattern_um: (n, 3) what it does to each reading.
        effects: what extends the model; empty for an instrument's.
        promised: whether it is in the extended calibration; not what repeats at the positions measured, but foretells none left out.
        bounded: whether a parameter stands at a physical bound, or a time constant at the length of the measurement.
        rivals: what came next in its place and is ruled out, best first.
        probability: that it or one of ``equivalent`` exists, by `twin.diagnosis.judgement.second_opinion`; None beside patterns
        without a name. credible: 95 % credible set of the effect that corresponds to it there, or that was found in its place.
    """

    effect: str
    where: str
    origin: str
    parameters: tuple[Quantity, ...]
    p_value: float
    share: float
    equivalent: tuple[tuple[str, str], ...]
    evidence: str
    pattern_um: np.ndarray
    effects: tuple[Effect, ...] = ()
    promised: bool = True
    bounded: bool = False
    rivals: tuple[Rival, ...] = ()
    probability: float | None = None
    credible: tuple[tuple[str, str], ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """As in the JSON."""
        return {
            "effect": self.effect,
            "where": self.where,
            "origin": self.origin,
            "parameters": [{"name": q.name, "value": q.value, "unit": q.unit, "u": q.u} for q in self.parameters],
            "p_value": self.p_value,
            "share": self.share,
            "equivalent": [{"effect": effect, "where": where} for effect, where in self.equivalent],
            "evidence": self.evidence,
            "promised": self.promised,
            "bounded": self.bounded,
            "probability": self.probability,
            "credible": [{"effect": effect, "where": where} for effect, where in self.credible],
        }


@final
@dataclass(frozen=True)
class HeldOut:
    """Residuals of readings that the fit has not seen; the causes are those found on all readings that are worth it on the others.

    Attributes:
        of: what was held out: ``rounds``, ``positions``, ``poses`` or ``blocks`` of time.
        groups: how many of these there are.
        before_um, after_um: RMS a coordinate, without and with the causes chosen from the others.
        ci95_um: 95 % interval of the difference, by group; None for fewer than six.
    """

    of: str
    groups: int
    before_um: float
    after_um: float
    ci95_um: tuple[float, float] | None

    def to_dict(self) -> dict[str, Any]:
        """As in the JSON."""
        return {
            "of": self.of,
            "groups": self.groups,
            "rms_before_um": self.before_um,
            "rms_after_um": self.after_um,
            "ci95_um": None if self.ci95_um is None else list(self.ci95_um),
        }


@final
@dataclass(frozen=True)
class Term:
    """One pattern without a known cause, as an effect of the calibration.

    Attributes:
        where: its place: ``tool by X_mm, Y_mm``.
        along: axes of which frame it shifts along: ``base``, ``tool`` or ``work``.
        columns: of the table.
        ranges: lowest and highest value measured, by column; columns whose functions need no range are left out.
        rms_um: what it does to the readings, RMS a coordinate.
        reason: why no effect can be made of it; None where it can.
    """

    where: str
    along: str
    columns: tuple[str, ...]
    ranges: Mapping[str, tuple[float, float]]
    rms_um: float
    reason: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """As in the JSON."""
        return {
            "where": self.where,
            "along": self.along,
            "columns": list(self.columns),
            "ranges": {column: list(own) for column, own in self.ranges.items()},
            "rms_um": self.rms_um,
            "reason": self.reason,
        }


@final
@dataclass(frozen=True)
class Extension:
    """Effects made of what is left unexplained (``effect: empirical``): without a known cause.

    Attributes:
        terms: one a pattern.
        rms_um: what those that an effect can be made of do to the readings together, RMS a coordinate.
        held_out: residuals of readings held out, with the named causes alone and with these effects beside them; None where no effect
            can be made, or nothing can be held out.
        written: whether they are in the extended calibration: only where held-out readings show that they gain.
        reason: why they are not; None where they are.
    """

    terms: tuple[Term, ...]
    rms_um: float
    held_out: HeldOut | None
    written: bool
    reason: str | None

    @property
    def made(self) -> tuple[Term, ...]:
        """The terms that an effect can be made of."""
        return tuple(term for term in self.terms if term.reason is None)

    @property
    def ranges(self) -> Mapping[str, tuple[float, float]]:
        """Of all columns together."""
        return {column: own for term in self.made for column, own in term.ranges.items()}

    def to_dict(self) -> dict[str, Any]:
        """As in the JSON: all terms together first."""
        return {
            "where": "; ".join(term.where for term in self.made) or None,
            "columns": list(dict.fromkeys(column for term in self.made for column in term.columns)),
            "ranges": {column: list(own) for column, own in self.ranges.items()},
            "rms_um": self.rms_um,
            "held_out": None if self.held_out is None else self.held_out.to_dict(),
            "written": self.written,
            "reason": self.reason,
            "terms": [term.to_dict() for term in self.terms],
        }


@final
@dataclass(frozen=True)
class Unexplained:
    """Structure no known effect accounts for.

    Attributes:
        share: of the excess residual sum of squares.
        depends_on: columns of the table; none if it is scatter.
        carrier: ``tool``, ``work`` or ``both``.
        evidence: one sentence.
        size_um: RMS a coordinate.
        extension: effects made of it; None where they were not asked for.
    """

    share: float
    depends_on: tuple[str, ...]
    carrier: str
    evidence: str
    size_um: float
    extension: Extension | None = None

    def to_dict(self) -> dict[str, Any]:
        """As in the JSON."""
        return {
            "share": self.share,
            "depends_on": list(self.depends_on),
            "carrier": self.carrier,
            "evidence": self.evidence,
            "size_um": self.size_um,
            "extension": None if self.extension is None else self.extension.to_dict(),
        }


@final
@dataclass(frozen=True)
class Trend:
    """How much of the misfit goes smoothly with a column, whatever the cause.

    Attributes:
        column: of the table.
        carrier: ``tool`` or ``work``.
        explains: chi² of a few smooth functions of the column.
        p_value: chance of as much in any column of either side without any cause.
    """

    column: str
    carrier: str
    explains: float
    p_value: float


@final
@dataclass(frozen=True)
class Gain:
    """What modelling the causes changes.

    Attributes:
        rms_before_um, rms_after_um: of the residuals a coordinate, all readings, with the calibration before and with the one that is
            written; what was found of the instrument is taken out of the readings.
        held_out: None where nothing can be held out.
        tool_before_um, tool_after_um: RMS error at the tool tip over the volume after compensating with each model, the extended one
            taken as the machine; what is found but not in the file stays in both.
        tool_length_mm: of the tool that is for: the machine file's, or a usual one.
    """

    rms_before_um: float
    rms_after_um: float
    held_out: HeldOut | None
    tool_before_um: float
    tool_after_um: float
    tool_length_mm: float


@dataclass(frozen=True)
class Answer:
    """The answer in numbers (`twin.diagnosis.diagnosis.Diagnosis` says it in words as well).

    Attributes:
        verdict: ``consistent``, ``explained``, ``ambiguous`` or ``unexplained``.
        rms_um, expected_rms_um: of the residuals a coordinate, as read and as the readings' scatter lets expect.
        absorbed_rms_um: of what is left once the uncertainty that the calibration states has taken up what it can.
        points, dof, p_value: how many, and the chance of as large a misfit without any cause.
        causes: strongest first.
        unexplained: structure that is left, or None.
        unidentifiable: (effect, where) that these data could not show, however large.
        looks_like: what looks the same as each of them, in words.
        not_evaluated: (effect, where, column that is missing).
        gain: None where nothing was found, named or written without a name.
        next_measurement: points worth measuring next, with what they would tell.
        trends: where the misfit is, by column and side, clearest first; what could be chance is left out.
        ranking: (effect, where, what it explains, p-value) of the causes tried alone, best first.
        tried: how many causes were tried.
        scatter: whose scatter the readings are judged by.
        calibration, extended: before and after.
        data: what was used; set-aside rows are listed there.
        residual_um, after_um: (n, 3) residuals a coordinate before and after; NaN where nothing was read.
        directions: (n, 3, 3) a row a coordinate: direction in the machine's base along which it counts; zero where nothing was read.
        precision: (n, 3, 3) inverse covariance of each reading, µm⁻²; zero where nothing was read.
    """

    verdict: Verdict
    rms_um: float
    absorbed_rms_um: float
    expected_rms_um: float
    points: int
    dof: int
    p_value: float
    causes: tuple[Cause, ...]
    unexplained: Unexplained | None
    unidentifiable: tuple[tuple[str, str], ...]
    looks_like: Mapping[tuple[str, str], str]
    not_evaluated: tuple[tuple[str, str, str], ...]
    gain: Gain | None
    next_measurement: tuple[Next, ...]
    trends: tuple[Trend, ...]
    ranking: tuple[tuple[str, str, float, float], ...]
    tried: int
    scatter: str
    calibration: Calibration
    extended: Calibration
    data: Measurements
    residual_um: np.ndarray
    after_um: np.ndarray
    directions: np.ndarray
    precision: np.ndarray

    @property
    def warnings(self) -> tuple[SourceWarning, ...]:
        """Warnings of where the readings and the calibration come from."""
        return merged(self.calibration.warnings, (SIMULATED,) if self.data.simulated else ())

    def to_dict(self) -> dict[str, Any]:
        """``schema: twin.diagnosis/1``."""
        gain = self.gain
        return {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "residual": {
                "rms_um": self.rms_um,
                "absorbed_rms_um": self.absorbed_rms_um,
                "expected_rms_um": self.expected_rms_um,
                "points": self.points,
                "dof": self.dof,
                "p_value": self.p_value,
            },
            "causes": [cause.to_dict() for cause in self.causes],
            "unexplained": None if self.unexplained is None else self.unexplained.to_dict(),
            "unidentifiable": [
                {"effect": effect, "where": where, "because": self.looks_like.get((effect, where), "")}
                for effect, where in self.unidentifiable
            ],
            "not_evaluated": [{"effect": e, "where": w, "missing": column} for e, w, column in self.not_evaluated],
            "gain": None
            if gain is None
            else {
                "rms_before_um": gain.rms_before_um,
                "rms_after_um": gain.rms_after_um,
                "held_out": None if gain.held_out is None else gain.held_out.to_dict(),
                "tool_point": {
                    "before_um": gain.tool_before_um,
                    "after_um": gain.tool_after_um,
                    "tool_length_mm": gain.tool_length_mm,
                },
            },
            "next_measurement": [dict(one) for one in self.next_measurement],
            "trends": [
                {"column": t.column, "carrier": t.carrier, "explains": t.explains, "p_value": t.p_value}
                for t in self.trends
            ],
            "scatter": self.scatter,
            "set_aside": [{"line": note.line, "reason": note.text} for note in self.data.set_aside],
            "notices": list(self.data.notices),
            "warnings": to_json(self.warnings),
        }


def readable_unit(unit: str) -> str:
    """A unit as people write it: ``um/(m.K)`` → µm/(m·K)."""
    return unit.replace("urad", "µrad").replace("um", "µm").replace("m2", "m²").replace(".", "·")
