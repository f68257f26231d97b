"""A calibration: error motions, squareness errors and axis locations of one machine, by their ISO 230-1 names."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, final

import numpy as np

from twin._common.arrays import outside_bounds, read_only
from twin._common.errors import InputError, closest_name, require_type
from twin._common.files import write_atomic
from twin._common.provenance import (
    CORRECTED_IN_CONTROL,
    ILLUSTRATIVE,
    NOT_IDENTIFIABLE,
    PARTLY_UNKNOWN_UNCERTAINTY,
    SIMULATED,
    UNKNOWN_UNCERTAINTY,
    UNSETTLED_ESTIMATE,
    SourceWarning,
    warning_texts,
)
from twin._common.units import count_with_noun
from twin._common.yaml_files import MAX_VALUE, EntryPath, line_of, load_yaml, yaml_text
from twin.controls import ControlSection, TableEntry
from twin.display import note
from twin.display.results import Display, DisplayedResult
from twin.machine.machine import Machine
from twin.model.calibration_file import (
    CalibrationFile,
    ControlEntry,
    CovarianceEntry,
    CurveEntry,
    MeasuredWith,
    MisfitEntry,
    UnidentifiedEntry,
    covariance_of,
    covariance_text,
    effect_entry,
    effects_of,
    measurement_entries,
)
from twin.model.datum import AS_GIVEN, DATUMS, Datum, Numbers, convert, datum_of, violation
from twin.model.display import about_rows, errors_html
from twin.model.effects import AxisLocation, ControlCorrection, Effect, Empirical, ErrorMotion, Squareness, split_name
from twin.model.effects.base import RecordingState
from twin.model.effects.control import kinematics_of, tables_of
from twin.model.effects.empirical import channel_name, check_ranges
from twin.model.effects.entries import distinguished, payload_entries, payloads_on
from twin.model.effects.gravity_compliance import AddedLoad, carrying
from twin.model.effects.table_load import with_payloads
from twin.model.effects.thermal_response import ThermalResponse
from twin.model.motion_curve import Curve, conversion_of, sum_of_curves
from twin.numerics.covariance import Covariance, not_a_covariance
from twin.numerics.curves import Basis, basis_named

SCHEMA = "twin.calibration/1"
LARGEST_ANGLE_URAD = 1e5
"""Largest angle accepted: a larger one is a mistake in the file. The rotation series is exact well beyond it."""


@final
@dataclass(frozen=True, repr=False)
class Calibration(DisplayedResult):
    """Errors of one machine; a curve, squareness or location that is absent is zero.

    Attributes:
        machine: the machine it belongs to.
        source: origin of the numbers, in words.
        curves: error motions by name.
        squareness: µrad by name.
        location: µm and µrad by name.
        extra: further effects, for example those added by a diagnosis.
        joint: joint covariance of all identified parameters, or None if only single curves have a covariance.
        path: the file it was read from, or None.
        control: correction tables active in the machine's control; None if there are none.
        corrections: corrections that the control applies to these errors; empty if the errors were measured with the tables active.
        transformation: corrections by the kinematics of the control; they act in tool centre point mode only (`with_transformation`).
        settled: whether the estimation converged; if not, no program is corrected and no table is made with it.
        simulated: whether it was identified from simulated readings.
        not_identifiable: errors that the readings did not determine, and why (`twin.model.unknown_errors`).
        not_estimated: names of errors that were left out of the estimate on request, and count as zero.
        misfit: residuals of the identification; None if it was not identified.
        instruments: names of the instruments it was measured with.
        set_up: set-up of the measurement; None if unknown.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> calibration = twin.Calibration.default(machine)
        >>> len(calibration.curves), calibration.illustrative
        (30, True)
        >>> calibration.where(lambda name: name == "E_XX").save("positioning.yaml")
        >>> tuple(twin.Calibration.load("positioning.yaml", machine).curves)
        ('E_XX',)

    References:
        - ISO 230-1:2012, Geometric accuracy of machines operating under no-load or quasi-static conditions (names of the errors).
    """

    machine: Machine
    source: str
    curves: Mapping[str, Curve]
    squareness: Mapping[str, float]
    location: Mapping[str, float]
    joint: Covariance | None = None
    extra: tuple[Effect, ...] = ()
    path: Path | None = None
    control: ControlSection | None = None
    corrections: tuple[ControlCorrection, ...] = ()
    transformation: tuple[ControlCorrection, ...] = ()
    settled: bool = True
    simulated: bool = False
    not_identifiable: tuple[UnidentifiedEntry, ...] = ()
    not_estimated: tuple[str, ...] = ()
    misfit: MisfitEntry | None = None
    instruments: tuple[str, ...] = ()
    set_up: MeasuredWith | None = None

    @classmethod
    def zero(cls, machine: Machine) -> Calibration:
        """Return a calibration without errors (nominal machine)."""
        empty: Mapping[str, Any] = MappingProxyType({})
        return cls(machine, "nominal: no errors", empty, empty, empty)

    @classmethod
    def load(cls, path: str | Path, machine: Machine) -> Calibration:
        """Read and check a calibration file.

        Raises:
            InputError: the file is invalid; the error names file, line, value and what was expected.
        """
        require_type("machine", machine, Machine)
        path = Path(path)
        entries, lines = load_yaml(path, CalibrationFile, SCHEMA)
        if entries.machine != machine.name:
            raise InputError(
                "a calibration for another machine",
                expected=f"machine: {machine.name}",
                file=path,
                line=line_of(("machine",), lines),
                value=entries.machine,
            )
        check = _Check(path, lines, machine)
        extra = effects_of(entries.effects, machine, check.fail)
        curves = {name: check.curve(name, entry) for name, entry in entries.curves.items()}
        for kind, given, allowed in (
            ("squareness", entries.squareness, machine.squareness_names),
            ("location", entries.location, machine.location_names),
        ):
            for name, value in given.items():
                check.name((kind, name), name, allowed)
                if (split_name(name)[0] >= 3) and abs(value) > LARGEST_ANGLE_URAD:
                    raise check.fail(
                        (kind, name), "implausibly large angle", f"at most {LARGEST_ANGLE_URAD:g} µrad", value
                    )
        loaded = cls(
            machine=machine,
            source=entries.source,
            curves=MappingProxyType(curves),
            squareness=MappingProxyType(dict(entries.squareness)),
            location=MappingProxyType(dict(entries.location)),
            extra=extra,
            path=path,
            settled=entries.settled,
            simulated=entries.simulated,
            not_identifiable=check.not_identifiable(entries),
            not_estimated=entries.not_estimated,
            misfit=entries.misfit,
            instruments=entries.instruments,
            set_up=entries.set_up,
        )
        check.datum(entries.datum, loaded)
        if entries.covariance is not None:
            loaded = replace(loaded, joint=check.joint(entries.covariance, loaded))
        return loaded if entries.control is None else loaded.with_control(check.control(entries.control))

    @classmethod
    def default(cls, machine: Machine) -> Calibration:
        """Load the calibration named in the machine file, or return one without errors if it names none."""
        require_type("machine", machine, Machine)
        path = machine.default_calibration
        return cls.zero(machine) if path is None else cls.load(path, machine)

    @classmethod
    def given(cls, machine: Machine, calibration: Calibration | None) -> Calibration:
        """Return a caller's calibration, or the `default` where there is none. Raises `TypeError`: not a calibration."""
        if calibration is None:
            return cls.default(machine)
        require_type("calibration", calibration, cls)
        return calibration

    def save(self, path: str | Path) -> None:
        """Write the file atomically, after it was read back and its errors were evaluated.

        Raises:
            InputError: it cannot be written, or a value would be refused by `load` or is not finite.
        """
        text = self.to_yaml(Path(path).parent)
        write_atomic(Path(path), text, check=lambda written: self._check_copy(written, text))

    def _check_copy(self, written: Path, text: str) -> None:
        """Raise `InputError` unless a file written from this calibration reads back as the same errors, finite everywhere."""
        loaded = Calibration.load(written, self.machine)
        if loaded.to_yaml(written.parent) != text:
            raise InputError(
                "the file reads back as another calibration", expected="the same numbers", value=self.source
            )
        for effect in loaded.effects:
            if not all(
                np.all(np.isfinite(value)) for value in effect.components(RecordingState(self.machine)).values()
            ):
                raise InputError("an error that is not finite", expected="a finite error everywhere", value=effect.name)

    def to_yaml(self, folder: Path | None = None) -> str:
        """Return the text of the calibration file; reading it gives the same calibration.

        Args:
            folder: folder of the file: control files are named relative to it; by their full path if None.
        """
        data: dict[str, Any] = {
            "schema": SCHEMA,
            "machine": self.machine.name,
            "source": self.source,
            "datum": self.datum,
            **({} if self.settled else {"settled": False}),
            **({"simulated": True} if self.simulated else {}),
            **measurement_entries(
                self.instruments, self.set_up, self.misfit, self.not_identifiable, self.not_estimated
            ),
            "curves": {name: _entry(curve) for name, curve in self.curves.items()},
            "squareness": {name: float(value) for name, value in self.squareness.items()},
            "location": {name: float(value) for name, value in self.location.items()},
        }
        if self.extra:
            data["effects"] = [*payload_entries(self.extra, self.machine), *map(effect_entry, self.extra)]
        if self.control is not None:
            data["control"] = self.control.to_entry(folder)
        text = yaml_text(data)
        if self.joint is not None and self.joint.names:
            text += covariance_text(self.joint)
        return text

    @cached_property
    def datum(self) -> Datum:
        """Datum that the numbers fulfil (`twin.model.datum`)."""
        return datum_of(self._numbers)

    def in_datum(self, datum: Datum, names: Collection[str] | None = None) -> Calibration:
        """Return the calibration, with its covariance, converted to a datum; itself if it is in that datum already.

        Args:
            datum: the new datum.
            names: errors that may change; all of the machine if None (`twin.model.datum.convert`).

        Raises:
            InputError: the datum is ``as given``, or the basis of a curve cannot represent it in that datum.
        """
        if violation(self._numbers, datum) is None and datum != AS_GIVEN:
            return self
        converted = convert(self._numbers, datum, names)
        if converted.numbers == self._numbers:
            return self
        joint = converted.covariance(self.covariance)
        names = set(joint.names)
        curves = {}
        for name, curve in converted.numbers.curves.items():
            own = [f"{name}[{k}]" for k in range(len(curve.coefficients))]
            curves[name] = replace(curve, covariance=joint.of(own).matrix if own[0] in names else None)
        return replace(
            self,
            source=f"{self.source} Datum changed to {datum}.",
            curves=MappingProxyType(curves),
            squareness=converted.numbers.squareness,
            location=converted.numbers.location,
            joint=joint if names else None,
            path=None,
        )

    @property
    def _numbers(self) -> Numbers:
        return Numbers(self.machine, self.curves, self.squareness, self.location)

    @cached_property
    def effects(self) -> tuple[Effect, ...]:
        """The error model: one effect per entry, in the order of the file."""
        effects: list[Effect] = []
        for curve in self.curves.values():
            axis = self.machine.by_name[split_name(curve.name)[2]]
            effects.append(curve.motion(wrapped=axis.lower is None))
        for name, angle in self.squareness.items():
            effects.append(Squareness(name, angle, self.machine.by_name[split_name(name)[2]]))
        effects += [AxisLocation(name, offset) for name, offset in self.location.items()]
        return (*effects, *self.extra, *self.corrections)

    def with_control(self, control: ControlSection | None) -> Calibration:
        """Return the same errors with the tables of another control, read from their files; None for no tables.

        Raises:
            InputError: a table cannot be read, differs from the recorded file, or moves an axis that the machine does not have.
        """
        corrections, transformation = (
            () if control is None else of(control, self.machine) for of in (tables_of, kinematics_of)
        )
        return replace(self, control=control, corrections=corrections, transformation=transformation)

    def with_transformation(self) -> Calibration:
        """Return the same errors in tool centre point mode, where the kinematics of the control act too."""
        if not self.transformation:
            return self
        return replace(self, corrections=(*self.corrections, *self.transformation), transformation=())

    def check_settled(self) -> None:
        """Raise `InputError` unless the estimation converged, so that the calibration may be used on a machine."""
        if not self.settled:
            raise InputError(
                "the estimate this calibration comes from did not settle",
                expected="a settled estimate: identify again with more readings, other poses, or known target and station positions",
                file=self.path,
                value="settled: false",
            )

    @property
    def corrected_in_control(self) -> bool:
        """Whether a kinematics module in the control corrects these errors already."""
        return self.control is not None and bool(self.control.live) and self.control.errors_are == "uncorrected"

    def check_not_live(self) -> None:
        """Raise `InputError` if a kinematics module in the control corrects these errors already."""
        if self.control is not None and self.corrected_in_control:
            off = self.control.live[-1].file.name
            raise InputError(
                "a kinematics module in the control corrects these errors: they would be corrected twice",
                expected=f"programs as they are; with the module switched off, the calibration {off}",
                file=self.path,
            )

    def with_tool(self, tool_length_mm: float) -> Calibration:
        """Return the same errors for a tool of the given length, where the control's correction depends on it."""
        corrections = tuple(correction.with_tool(tool_length_mm) for correction in self.corrections)
        same = all(new is old for new, old in zip(corrections, self.corrections, strict=True))
        return self if same else replace(self, corrections=corrections)

    def where(self, keep: Callable[[str], bool]) -> Calibration:
        """Return the calibration with only those effects (error motions, squareness, locations, others) whose name fulfils ``keep``.

        Errors that it does not contain because they could not be determined stay unknown.
        """
        given = {effect.name for effect in self.effects}
        numbers = {number.name for effect in self.effects if keep(effect.name) for number in effect.parameters}
        return replace(
            self,
            curves=MappingProxyType({name: curve for name, curve in self.curves.items() if keep(name)}),
            squareness=MappingProxyType({name: value for name, value in self.squareness.items() if keep(name)}),
            location=MappingProxyType({name: value for name, value in self.location.items() if keep(name)}),
            joint=None if self.joint is None else self.joint.where(lambda name: name in numbers),
            extra=tuple(effect for effect in self.extra if keep(effect.name)),
            corrections=tuple(effect for effect in self.corrections if keep(effect.name)),
            not_identifiable=tuple(
                error for error in self.not_identifiable if error.name not in given or keep(error.name)
            ),
        )

    @property
    def covariance(self) -> Covariance:
        """Covariance of the parameters: the joint covariance, or those of the single curves, taken as independent."""
        if self.joint is not None:
            return self.joint
        blocks = []
        for curve in self.curves.values():
            if curve.covariance is not None:
                names = tuple(f"{curve.name}[{k}]" for k in range(len(curve.coefficients)))
                blocks.append(Covariance(names, curve.covariance))
        return Covariance.of_blocks(blocks) if blocks else Covariance.none()

    @property
    def without_uncertainty(self) -> tuple[str, ...]:
        """Names of the errors that have a value but no uncertainty."""
        known = {name.partition("[")[0] for name in self.covariance.names}
        return tuple(name for name in (*self.curves, *self.squareness, *self.location) if name not in known)

    def extended(
        self, effects: Sequence[Effect], covariance: Covariance, source: str, *, simulated: bool = False
    ) -> Calibration:
        """Return the calibration with effects added: to its curves, squareness and locations where they apply, else as further effects.

        Args:
            effects: effects to add, for example those found by a diagnosis.
            covariance: covariance of their parameters.
            source: their origin, appended to this calibration's own.
            simulated: whether they were found in simulated readings.
        """
        curves, squareness, location = dict(self.curves), dict(self.squareness), dict(self.location)
        extra = list(self.extra)
        added: dict[str, AddedLoad] = {}
        own = self.covariance
        effects, found = distinguished(extra, effects, covariance)
        motions: dict[str, list[ErrorMotion]] = {}
        for effect in effects:
            if isinstance(effect, ErrorMotion):
                motions.setdefault(effect.name, []).append(effect)
                curves[effect.name] = sum_of_curves(curves.get(effect.name), effect)
            elif isinstance(effect, Squareness):
                squareness[effect.name] = squareness.get(effect.name, 0.0) + effect.angle_urad
            elif isinstance(effect, AxisLocation):
                location[effect.name] = location.get(effect.name, 0.0) + effect.offset
            elif isinstance(effect, AddedLoad):
                added[effect.side] = effect
            else:
                extra.append(effect)
        for load in added.values():
            extra = carrying(self.machine, extra, len(self.extra), load)
            masses = {parameter.name for parameter in load.parameters}
            found = found.where(lambda name, masses=masses: name not in masses)  # type: ignore[misc]
        extra = with_payloads(self.machine, extra, payloads_on(extra))
        for name in [name for name in motions if name in self.curves]:
            before, basis, count = self.curves[name], curves[name].family, len(curves[name].coefficients)
            widest = max(motions[name], key=lambda motion: len(motion.coefficients))
            own = own.transformed(name, conversion_of(name, before.family, basis, len(before.coefficients), count))
            found = found.transformed(name, conversion_of(name, widest.basis, basis, len(widest.coefficients), count))
        # What these readings determined is known now.
        found_now = {name.partition("[")[0] for name in covariance.names}
        whole = replace(
            self,
            source=f"{self.source}; {source}",
            not_identifiable=tuple(error for error in self.not_identifiable if error.name not in found_now),
            curves=MappingProxyType(curves),
            squareness=MappingProxyType(squareness),
            location=MappingProxyType(location),
            extra=tuple(extra),
            joint=None,
            path=None,
            simulated=self.simulated or simulated,
        )
        return replace(whole, joint=own.plus(found))

    @property
    def empty(self) -> bool:
        """Whether it has no errors at all."""
        return not (self.curves or self.squareness or self.location or self.extra or self.corrections)

    @property
    def illustrative(self) -> bool:
        """Whether any error motion is illustrative instead of measured."""
        return any(curve.illustrative for curve in self.curves.values())

    @property
    def warnings(self) -> tuple[SourceWarning, ...]:
        """Warnings about the origin of the numbers; every file made from them repeats these."""
        warnings = [ILLUSTRATIVE] if self.illustrative else []
        warnings += [SIMULATED] if self.simulated else []
        warnings += [] if self.settled else [UNSETTLED_ESTIMATE]
        warnings += [CORRECTED_IN_CONTROL] if self.corrected_in_control else []
        if self.not_identifiable:
            warnings.append(NOT_IDENTIFIABLE.about(error.name for error in self.not_identifiable))
        warnings += [] if self.misfit is None or self.misfit.warning is None else [self.misfit.warning]
        numbers = {parameter.name for effect in self.effects for parameter in effect.parameters}
        known = numbers.intersection(self.covariance.names)
        if known != numbers:
            warnings.append(PARTLY_UNKNOWN_UNCERTAINTY if known else UNKNOWN_UNCERTAINTY)
        return tuple(warnings)

    @property
    def brief(self) -> str:
        """Numbers of errors and warnings."""
        constants = count_with_noun(len(self.squareness) + len(self.location), "constant error")
        parts = [count_with_noun(len(self.curves), "error motion"), constants]
        parts += [count_with_noun(len(self.extra), "other effect")] if self.extra else []
        return "; ".join(
            [f"calibration of {self.machine.name}: {', '.join(parts)}", *(warning.title for warning in self.warnings)]
        )

    def display(self) -> Display:
        """Return warnings, all errors and their origin."""
        drawn = tuple(curve.name for curve in self.curves.values() if curve.illustrative)
        errors = errors_html(self.machine, self.effects, self.covariance, drawn)
        unknown = self.without_uncertainty if self.covariance.names or self.empty else ("all of it",)
        about = about_rows(self.source, self.path, self.control, drawn, unknown)
        small = "no errors (nominal machine)" if self.empty else ""
        title = f"Calibration of {self.machine.name}"
        # The card itself marks illustrative numbers, and `about` lists what has no uncertainty.
        others = [warning for warning in self.warnings if warning not in (ILLUSTRATIVE, UNKNOWN_UNCERTAINTY)]
        warnings = (note(text, loud=True) for text in warning_texts(others))
        return Display(title, about, above=(*warnings, errors), small=small, illustrative=self.illustrative)

    @cached_property
    def empirical(self) -> tuple[Empirical, ...]:
        """Effects of unknown cause, each valid only within its ranges."""
        return tuple(effect for effect in self.extra if isinstance(effect, Empirical))

    @cached_property
    def bounded(self) -> tuple[Empirical | ThermalResponse, ...]:
        """Effects that are valid only within their ranges."""
        return tuple(effect for effect in self.extra if isinstance(effect, Empirical | ThermalResponse))

    def outside(self, positions: np.ndarray) -> np.ndarray:
        """Return (n, axes) whether positions (mm, degrees) leave a curve's domain or an empirical effect's range, beyond rounding."""
        found = self.outside_domains(positions)
        for effect in self.empirical:
            for column, outside in effect.outside(self.state(positions)).items():
                found[:, self.machine.names.index(channel_name(column))] |= outside
        return found

    def outside_domains(self, positions: np.ndarray) -> np.ndarray:
        """Return (n, axes) whether positions (mm, degrees) leave the domain of a curve by more than rounding."""
        lower, upper = (self.domains() + np.array([-1e-9, 1e-9])).T
        return outside_bounds(positions, lower, upper)

    def state(self, positions: np.ndarray) -> dict[str, np.ndarray]:
        """Return the positions (n, axes) as arrays (n,) by axis name."""
        return dict(zip(self.machine.names, np.asarray(positions, dtype=float).T, strict=True))

    def check(self, positions: np.ndarray) -> None:
        """Raise `InputError` unless every curve and every empirical effect covers the positions (n, axes)."""
        outside = self.outside_domains(positions)
        if np.any(outside):
            row, column = np.argwhere(outside)[0]
            lo, hi = self.domains()[column]
            axis = self.machine.axes[column]
            raise InputError(
                f"{axis.name} outside the domain of its error motions",
                expected=f"{lo:g} to {hi:g} {axis.unit}",
                value=float(positions[row, column]),
            )
        check_ranges(self.empirical, self.state(positions))

    def domains(self) -> np.ndarray:
        """Return (axes, 2) the common domain of the curves of every axis, mm and degrees; infinite if there is no limit."""
        return self._domains

    @cached_property
    def _domains(self) -> np.ndarray:
        bounds = np.tile([-np.inf, np.inf], (len(self.machine.axes), 1))
        for curve in self.curves.values():
            axis = self.machine.by_name[split_name(curve.name)[2]]
            if axis.lower is not None:
                row = bounds[self.machine.axes.index(axis)]
                row[:] = max(row[0], curve.domain[0]), min(row[1], curve.domain[1])
        return read_only(bounds)


@final
@dataclass(frozen=True)
class _Check:
    """Checks of a calibration file that need the machine."""

    path: Path
    lines: Mapping[EntryPath, int]
    machine: Machine

    def fail(self, place: EntryPath, what: str, expected: str, value: object, meant: str | None = None) -> InputError:
        line = line_of(place, self.lines)
        return InputError(what, expected=expected, file=self.path, line=line, value=value, nearest=meant)

    def name(self, place: EntryPath, name: str, allowed: tuple[str, ...]) -> None:
        if name not in allowed:
            what = f"{self.machine.name} has no such entry under {place[0]}"
            raise self.fail(place, what, f"one of {', '.join(allowed)}", name, closest_name(name, allowed))

    def not_identifiable(self, entries: CalibrationFile) -> tuple[UnidentifiedEntry, ...]:
        every = (*self.machine.motion_names, *self.machine.squareness_names, *self.machine.location_names)
        named = [error.name for error in entries.not_identifiable]
        for kind, names in (("not_identifiable", named), ("not_estimated", entries.not_estimated)):
            for i, name in enumerate(names):
                self.name((kind, i), name, every)
                if name in names[:i]:
                    raise self.fail((kind, i), f"duplicate entry under {kind}", "each error once", name)
        return entries.not_identifiable

    def datum(self, stated: str | None, calibration: Calibration) -> None:
        if stated is None:
            return
        known = next((datum for datum in DATUMS if datum == stated), None)
        if known is None:
            one, meant = f"one of {', '.join(DATUMS)}", closest_name(stated, DATUMS)
            raise self.fail(("datum",), "no such datum", one, stated, meant)
        found = violation(calibration._numbers, known)
        if found is not None:
            curve, what, amount = found
            unit = "µm" if split_name(curve)[0] < 3 else "µrad"
            wrong = f"the numbers contradict the datum '{known}': {curve} has a {what}"
            expected = "none; remove the entry `datum:` and convert the file with `twin info` (twin doc datum)"
            raise self.fail(("datum",), wrong, expected, f"{amount:.4g} {unit}")

    def curve(self, name: str, entry: CurveEntry) -> Curve:
        place: EntryPath = ("curves", name)
        self.name(place, name, self.machine.motion_names)
        component, _, axis_name = split_name(name)
        axis = self.machine.by_name[axis_name]
        unit = "um" if component < 3 else "urad"
        if entry.unit != unit:
            raise self.fail((*place, "unit"), f"wrong unit for {name}", unit, entry.unit)
        lo, hi = entry.domain
        if not lo < hi:
            raise self.fail((*place, "domain"), "an empty domain", "[lo, hi] with lo < hi", list(entry.domain))
        if axis.lower is None and abs(hi - lo - 360.0) > 1e-9:
            turn = "360 degrees, for an unlimited axis"
            raise self.fail((*place, "domain"), "not one turn", turn, list(entry.domain))
        basis = self.basis(place, entry)
        misfit = basis.count_problem(len(entry.coefficients), rotary=not axis.linear)
        if misfit is not None:
            raise self.fail((*place, "coefficients"), f"not a {basis.name} curve", misfit, entry.coefficients)
        peak = np.abs(basis.value(np.linspace(lo, hi, 201), entry.domain, entry.coefficients)).max()
        if unit == "urad" and peak > LARGEST_ANGLE_URAD:
            most = f"at most {LARGEST_ANGLE_URAD:g} µrad"
            raise self.fail((*place, "coefficients"), "implausibly large angle", most, float(peak))
        return Curve(
            name=name,
            unit=entry.unit,
            domain=entry.domain,
            basis=entry.basis,
            coefficients=entry.coefficients,
            covariance=self.covariance((*place, "covariance"), entry),
            source=entry.source,
            illustrative=entry.illustrative,
            knots=entry.knots,
        )

    def basis(self, place: EntryPath, entry: CurveEntry) -> Basis:
        part = "basis"
        try:
            kind = basis_named(entry.basis)
            part = "knots"
            basis = kind(entry.knots)
        except InputError as error:
            raise self.fail((*place, part), error.what, str(error.expected), error.value, error.nearest) from None
        misfit = basis.knots_problem(entry.domain)
        if misfit is not None:
            raise self.fail((*place, "knots"), "knots that do not fit this curve", misfit, list(entry.knots))
        return basis

    def covariance(self, place: EntryPath, entry: CurveEntry) -> np.ndarray | None:
        if entry.covariance is None:
            return None
        count = len(entry.coefficients)
        if len(entry.covariance) != count or any(len(row) != count for row in entry.covariance):
            raise self.fail(place, "covariance of the wrong shape", f"{count} rows of {count}", entry.covariance)
        matrix = np.array(entry.covariance)
        if not np.allclose(matrix, matrix.T, rtol=1e-9, atol=0.0):
            raise self.fail(place, "covariance is not symmetric", "a symmetric matrix", entry.covariance)
        problem = not_a_covariance(matrix)
        if problem is not None:
            raise self.fail(place, "not a covariance", "a positive semi-definite matrix", problem)
        return read_only(matrix)

    def control(self, entry: ControlEntry) -> ControlSection:
        folder = self.path.parent
        tables, kinematics, live = (
            tuple(TableEntry(folder / one.file, one.format, one.classes, one.sha256) for one in listed)
            for listed in (entry.tables, entry.kinematics, entry.live)
        )
        return ControlSection(entry.errors_are, tables, kinematics, live, entry.tool_length_mm)

    def joint(self, entry: CovarianceEntry, calibration: Calibration) -> Covariance:
        known = [parameter.name for effect in calibration.effects for parameter in effect.parameters]
        for name in entry.parameters:
            if name not in known:
                what = "a covariance of a parameter that is not in this file"
                raise self.fail(("covariance",), what, "its parameters", name, closest_name(name, known))
            if entry.parameters.count(name) > 1:
                raise self.fail(("covariance",), "duplicate parameter", "each parameter once", name)
        try:
            joint = covariance_of(entry)
        except ValueError as error:
            expected = "the lower triangle, one row per line (lower), or as twin writes it (compressed, sha256)"
            raise self.fail(("covariance",), "not a covariance", expected, error) from None
        if np.any(np.abs(joint.matrix) > MAX_VALUE):
            raise self.fail(("covariance",), "too large a number", f"at most {MAX_VALUE:g}", "")
        for curve in calibration.curves.values():
            names = [f"{curve.name}[{k}]" for k in range(len(curve.coefficients))]
            whole = set(names) <= set(entry.parameters)
            if curve.covariance is not None and not (
                whole and np.allclose(joint.of(names).matrix, curve.covariance, rtol=1e-9, atol=0.0)
            ):
                place: EntryPath = ("curves", curve.name, "covariance")
                raise self.fail(place, "differs from the joint covariance", "the same values", curve.name)
        return joint


def _entry(curve: Curve) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "unit": curve.unit,
        "domain": [float(bound) for bound in curve.domain],
        "basis": curve.basis,
        **({"knots": [float(knot) for knot in curve.knots]} if curve.knots else {}),
        "coefficients": [float(c) for c in curve.coefficients],
    }
    if curve.covariance is not None:
        entry["covariance"] = [[float(value) for value in row] for row in curve.covariance]
    if curve.illustrative:
        entry["illustrative"] = True
    if curve.source:
        entry["source"] = curve.source
    return entry
