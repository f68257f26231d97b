"""The result of a diagnosis as values and JSON (contract §4)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, final

import numpy as np

from twin._common.messages import Message
from twin._common.provenance import SIMULATED, SourceWarning, merge_warnings, warnings_to_json
from twin.display.numbers import listed
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects import Effect

SCHEMA: Final = "twin.diagnosis/1"
Next = Mapping[str, Any]  # a point to measure next, as in the JSON
Verdict = Literal["consistent", "explained", "ambiguous", "unexplained"]


@final
@dataclass(frozen=True)
class Quantity:
    """A number of a cause: an estimated parameter, or one that its effect states.

    Attributes:
        name, value, unit: as in an entry of a calibration.
        u: standard uncertainty; 0 if the number is stated.
        coefficient: whether it is a coefficient of a curve, which means nothing by itself.
    """

    name: str
    value: float
    unit: str
    u: float
    coefficient: bool = False


@final
@dataclass(frozen=True)
class Rival:
    """An alternative to a cause that the readings rule out, tested in its place with the other causes kept.

    Attributes:
        effect, where: contract §5.
        share: of the excess residual sum of squares: the part of the cause's share that it would explain.
        log_odds: natural log of how many times less likely it is, both corrected for the number of tests.
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
        p_value: of the χ² it explains given the other causes, corrected for the number of tests.
        share: of the excess residual sum of squares (over measurement noise): its Shapley value in the part that all causes explain;
            with the share that is unexplained, and a rest, the shares add up to one.
        equivalent: (effect, where) of the causes it is confounded with in these data.
        together: groups of these that replace it only together.
        assumes: what it assumes of the instrument, in words, where an error of the instrument would fit as well; else empty.
        below_increment: whether it is smaller than the least increment of the axes.
        evidence: one sentence a machine operator can read.
        pattern_um: (n, 3) its effect on each reading.
        effects: the effects that extend the model; empty for an error of the instrument.
        promised: whether it is in the extended calibration; false if the measured positions do not predict held-out ones.
        bounded: whether a parameter is at a physical bound, or a time constant at the length of the measurement.
        rivals: alternatives that are ruled out, best first.
        probability: that it or one of ``equivalent`` exists, by `twin.diagnosis.second_opinion`; None if there are unnamed
            patterns, or the cause is not ``promised``.
        credible: 95 % credible set of the corresponding effect of that method, or of the effect found in its place.
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
    together: tuple[tuple[tuple[str, str], ...], ...] = ()
    assumes: str = ""
    below_increment: bool = False

    def alternatives(self, title: Callable[[str, str], str]) -> list[str]:
        """Return the names of `equivalent`, those that replace it only together as one.

        Args:
            title: gives the name of an effect at a place.
        """
        grouped = {key for group in self.together for key in group}
        alone = [title(*key) for key in self.equivalent if key not in grouped]
        groups = [listed([title(*key) for key in group], most=len(group)) for group in self.together]
        return [*alone, *(Message("{names} together", names=names) for names in groups)]

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON."""
        return {
            "effect": self.effect,
            "where": self.where,
            "origin": self.origin,
            "parameters": [{"name": q.name, "value": q.value, "unit": q.unit, "u": q.u} for q in self.parameters],
            "p_value": self.p_value,
            "share": self.share,
            "equivalent": [self._alternative(key) for key in self.equivalent],
            "evidence": self.evidence,
            "assumes": self.assumes or None,
            "promised": self.promised,
            "bounded": self.bounded,
            "probability": self.probability,
            "credible": [{"effect": effect, "where": where} for effect, where in self.credible],
        }

    def _alternative(self, key: tuple[str, str]) -> dict[str, Any]:
        with_it = next((group for group in self.together if key in group), ())
        others = [{"effect": effect, "where": where} for effect, where in with_it if (effect, where) != key]
        return {"effect": key[0], "where": key[1], **({"together_with": others} if others else {})}


@final
@dataclass(frozen=True)
class HeldOut:
    """Residuals of held-out readings; the written causes are fitted to the others.

    Attributes:
        of: what was held out: ``rounds``, ``positions``, ``poses`` or ``blocks`` of time.
        groups: number of independent groups.
        before_um, after_um: RMS per coordinate, without and with the causes fitted to the other readings.
        ci95_um: 95 % confidence interval of the difference, from the groups; None for fewer than six.
    """

    of: str
    groups: int
    before_um: float
    after_um: float
    ci95_um: tuple[float, float] | None

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON."""
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
        where: side and columns: ``tool by X_mm, Y_mm``.
        along: frame along whose axes it shifts the targets: ``base``, ``tool`` or ``work``.
        columns: columns of the table that it depends on.
        ranges: lowest and highest measured value by column; periodic columns and approach directions have none.
        rms_um: its effect on the readings, RMS per coordinate.
        reason: why it cannot become an effect of the calibration; None if it can.
    """

    where: str
    along: str
    columns: tuple[str, ...]
    ranges: Mapping[str, tuple[float, float]]
    rms_um: float
    reason: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON."""
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
    """Empirical effects (``effect: empirical``) fitted to the unexplained patterns, without a known cause.

    Attributes:
        terms: one per pattern.
        rms_um: effect of the usable terms together on the readings, RMS per coordinate.
        held_out: residuals of held-out readings, with the named causes alone and with these effects added; None without a usable term,
            or if nothing can be held out.
        written: whether they are in the extended calibration: only if they reduce the residuals of held-out readings.
        reason: why they are not written; None if they are.
    """

    terms: tuple[Term, ...]
    rms_um: float
    held_out: HeldOut | None
    written: bool
    reason: str | None

    @property
    def made(self) -> tuple[Term, ...]:
        """Return the terms that can become effects of a calibration."""
        return tuple(term for term in self.terms if term.reason is None)

    @property
    def ranges(self) -> Mapping[str, tuple[float, float]]:
        """Return the measured ranges of all columns of the usable terms."""
        return {column: own for term in self.made for column, own in term.ranges.items()}

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON: all terms together first."""
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
    """A pattern in the residuals that no known effect explains.

    Attributes:
        share: of the excess residual sum of squares that the causes leave.
        depends_on: columns of the table; empty for excess noise without a pattern.
        carrier: ``tool``, ``work`` or ``both``.
        evidence: one sentence.
        size_um: RMS per coordinate.
        or_on: other sets of columns that it may depend on instead: the readings do not rule them out.
        extension: empirical effects fitted to it; None if not requested.
        jump: where in the table the whole side jumped, in words; empty for another pattern.
    """

    share: float
    depends_on: tuple[str, ...]
    carrier: str
    evidence: str
    size_um: float
    or_on: tuple[tuple[str, ...], ...] = ()
    extension: Extension | None = None
    jump: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON."""
        return {
            "share": self.share,
            "depends_on": list(self.depends_on),
            "carrier": self.carrier,
            "evidence": self.evidence,
            "size_um": self.size_um,
            "or_on": [list(columns) for columns in self.or_on],
            "extension": None if self.extension is None else self.extension.to_dict(),
        }


@final
@dataclass(frozen=True)
class Trend:
    """A smooth dependence of the residuals on one column, before any cause is fitted.

    Attributes:
        column: of the table.
        carrier: ``tool`` or ``work``.
        explains: χ² explained by a few smooth functions of the column.
        p_value: corrected for the number of columns and sides tested.
    """

    column: str
    carrier: str
    explains: float
    p_value: float


@final
@dataclass(frozen=True)
class Gain:
    """The gain of modelling the causes.

    Attributes:
        rms_before_um, rms_after_um: RMS residual per coordinate of all readings, with the given and with the extended calibration;
            for the latter, instrument errors found are subtracted from the readings.
        held_out: residuals of held-out readings; None if nothing can be held out.
        tool_before_um, tool_after_um: RMS error at the tool tip over the volume after compensating with each calibration, on a machine
            as the extended one describes it; errors found that are not in the file remain in both. NaN if they are larger than the
            model describes.
        tool_length_mm: tool length assumed: the machine file's, or a typical one.
    """

    rms_before_um: float
    rms_after_um: float
    held_out: HeldOut | None
    tool_before_um: float
    tool_after_um: float
    tool_length_mm: float


@dataclass(frozen=True)
class DiagnosisResult:
    """The result of a diagnosis in numbers (`twin.diagnosis.answer.Diagnosis` adds words).

    Attributes:
        verdict: ``consistent``, ``explained``, ``ambiguous`` or ``unexplained``.
        rms_um, expected_rms_um: RMS residual per coordinate, actual and expected from measurement noise.
        absorbed_rms_um: RMS residual per coordinate after allowing for the uncertainty stated in the calibration.
        points, dof, p_value: number of readings, degrees of freedom, and p-value of the residuals without any cause.
        causes: strongest first.
        unexplained: pattern or excess noise that no cause explains, or None.
        unidentifiable: (effect, where) of the causes that these data cannot show, whatever their size.
        looks_like: what each of them is confounded with, in words.
        not_evaluated: (effect, where, missing column).
        gain: None if the model does not change.
        next_measurement: points to measure next, with the causes they separate.
        trends: significant dependence of the residuals on single columns, by column and side, clearest first.
        ranking: (effect, where, χ² explained, p-value) of the causes tested one by one, best first.
        tried: number of causes tested.
        noise_source: source of the measurement noise, in words.
        calibration, extended: the given and the extended calibration.
        data: the readings used; it lists the rows set aside.
        residual_um, after_um: (n, 3) residuals without and with the causes; NaN where no coordinate was measured.
        directions: (n, 3, 3) a row per coordinate: its direction in the machine's base; zero where not measured.
        precision: (n, 3, 3) inverse covariance of each reading, µm⁻²; zero where not measured.
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
    noise_source: str
    calibration: Calibration
    extended: Calibration
    data: Measurements
    residual_um: np.ndarray
    after_um: np.ndarray
    directions: np.ndarray
    precision: np.ndarray

    @property
    def warnings(self) -> tuple[SourceWarning, ...]:
        """Return the warnings on the origin of the readings and of the calibration."""
        return merge_warnings(self.calibration.warnings, (SIMULATED,) if self.data.simulated else ())

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON (``schema: twin.diagnosis/1``)."""
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
            "noise_source": self.noise_source,
            "set_aside": [{"line": note.line, "reason": note.text} for note in self.data.set_aside],
            "notices": list(self.data.notices),
            "warnings": warnings_to_json(self.warnings),
        }


def readable_unit(unit: str) -> str:
    """Return a unit in typographic form: ``um/(m.K)`` → µm/(m·K)."""
    return unit.replace("urad", "µrad").replace("um", "µm").replace("m2", "m²").replace(".", "·")
