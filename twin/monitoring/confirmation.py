"""Whether what was written into a machine took effect as intended, from readings taken afterwards; or what moved in a crash.

The readings are linear in everything that may be wrong: r = G f + H h + A a + B s + noise. f has one factor for every written value
(a table, a value of the kinematics, a corrected word of a program, an adjusted error): 1 in effect, 0 absent, −1 reversed. h are
changes of scales, squareness and locations, with the plausible sizes of the machine file as prior; a are the errors of the machine,
with the covariance of the calibration as prior; s is the set-up, free in each measurement. Hypotheses are compared by their likelihood
with a and s integrated out. The likelihood ratio of a hypothesis exceeds k by chance with probability 1/k or less (Markov), whatever
its shape, so that the sum over all of them gives the rate of false alarms.

A calibration may come from the readings before. Both are then used with doubled variances, which is consistent for any correlation
(covariance intersection; Julier and Uhlmann 1997).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, final

import numpy as np

from twin._common.distributions import chi2_sf
from twin._common.errors import InputError
from twin._common.messages import Message, Number, joined
from twin._common.provenance import SIMULATED, SourceWarning, merge_warnings
from twin._common.resources import Progress, one_blas_thread, silent
from twin._common.units import UM, URAD
from twin.compensation.live import errors_while_on
from twin.display import readable
from twin.display.numbers import listed
from twin.identification.inputs import reading_noise
from twin.identification.network import Network, Unknowns, axes_with_known_places, spaces_for
from twin.identification.solve import solve
from twin.identification.unidentified import constant_unknowns, scale_unit
from twin.machine.machine import Machine
from twin.measurement.columns import grouped_notes
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.conditions import Conditions
from twin.model.effects import MACHINE_EFFECTS, unit_of
from twin.model.effects.base import motion_in_words
from twin.monitoring.confirmed import Confirmation, ConfirmedValue, MotionBound, MovedError, Verdict
from twin.monitoring.written import (
    POSES,
    SEED,
    Hypothesis,
    LinearReadings,
    Weigher,
    WrittenValue,
    best_hypothesis,
    effects_on,
    groups_of,
    linear_readings,
    mattering,
    prepared,
    rms_length,
    shown,
)
from twin.numerics.covariance import symmetric_root
from twin.numerics.curves import bases_for
from twin.tool.forward import Kinematics
from twin.tool.uncertainty import volume, without_missing_channels

UNEXPLAINED_BELOW: Final = 0.01
"""Rate of false alarms of the test whether anything is left that no hypothesis explains."""
DRAWS: Final = 400
WIDER: Final = 5.0
"""Factor on the calibration's uncertainty in the model from which the noise of the readings is estimated."""
UNSEEN: Final = 0.01
"""Share of the prior variance from which the readings do not determine a change."""
CARRIED: Final = 0.1
FUNCTIONS: Final = 6  # of each error motion, where no calibration is given
AT_THE_NOSE: Final = Message(
    "no tool length is given or stated with the tables, so the figures hold at the spindle nose (0 mm): angular errors act with the "
    "length of the tool"
)
ACTIVE: Final = Message(
    "kinematics act in tool centre point mode only: measure AFTER with the transformation active, at the programmed points for which "
    "the nominal kinematics give the axis positions of the table"
)


def confirm(
    before: Measurements | None,
    after: Measurements,
    machine: Machine,
    *,
    calibration: Calibration | None = None,
    written: Sequence[WrittenValue] = (),
    tool_length_mm: float | None = None,
    progress: Progress = silent,
) -> Confirmation:
    """Return whether written values took effect as intended; without any, whether scales, squareness or locations moved.

    Args:
        before: readings before they were written; None: the calibration alone says what was before.
        after: readings afterwards; stations and targets may have been set up anew.
        calibration: the errors of the machine without the written values, with their covariance; None: plausible errors. Corrections
            of its control are taken as active.
        written: what was written (`twin.written_values`).
        tool_length_mm: length of the tool for the figures at the tool; None: that of the machine file.

    Raises:
        InputError: neither readings before nor a calibration; written values without a calibration; readings that disagree with the
            commands, or that move no axis.

    Examples:
        >>> machine, tracker, draws = twin.Machine.load("dmu50"), twin.instruments.LaserTracker(), np.random.default_rng(1)
        >>> task = twin.thesis_plan.plan(machine), machine, twin.Calibration.zero(machine), tracker, draws
        >>> twin.confirm(twin.simulate(*task)[0], twin.simulate(*task)[0], machine).verdict
        'unchanged'
    """
    if calibration is None and (before is None or written):
        raise InputError("no calibration", expected="the calibration of the machine before", file=after.source)
    errors, said_of_control = _errors_now(machine, calibration)
    known = bool(errors.covariance.names)
    with one_blas_thread():
        progress("reading", 0.1)
        tables = [table for table in (after, before) if table is not None]
        axes = sorted({name for table in tables for name in table.moved(machine)}, key=machine.names.index)
        unknowns = constant_unknowns(machine, axes)
        if not len(unknowns):
            raise after.error(
                "no axis with a scale, squareness or location moved", expected="two or more positions of an axis", row=0
            )
        prior = None if known else _plausible_errors(machine, tables)
        found = [
            _linearised(machine, table, errors, unknowns, written if table is after else (), prior) for table in tables
        ]
        now, then = found[0][0], found[1][0] if before is not None else None
        progress("weighing", 0.5)
        dependent = known and then is not None
        chi2, dof = Weigher(_wider(now), None if then is None else _wider(then), dependent=dependent).noise()
        variance = max(1.0, chi2 / dof) if dof >= 1.0 else 1.0
        weigher = Weigher(now, then, dependent=dependent, variance=variance)
        length = machine.tool_length_mm if tool_length_mm is None else tool_length_mm
        task = _Task(machine, errors, unknowns, prior, tuple(written), weigher, length)
        progress("figures", 0.8)
        box = {
            name: (float(after.positions[:, i].min()), float(after.positions[:, i].max()))
            for i, name in enumerate(machine.names)
        }
        notices = [text for _, said in found for text in said] + said_of_control
        notices += _limits(written, tool_length_mm, length, unknown_u=calibration is not None and not known)
        return task.confirmation(
            box,
            np.sqrt(variance),
            len(after),
            tuple(dict.fromkeys(notices)),
            merge_warnings(errors.warnings, (SIMULATED,) if any(table.simulated for table in tables) else ()),
        )


def _limits(
    written: Sequence[WrittenValue], given_mm: float | None, length_mm: float, *, unknown_u: bool
) -> list[Message]:
    """Return what limits the figures; ``given_mm``: the tool length that was asked for; ``unknown_u``: errors without one."""
    limits = [ACTIVE] if any(value.name.startswith("kinematics") for value in written) else []
    if given_mm is None and length_mm == 0.0:
        limits.append(AT_THE_NOSE)
    if unknown_u:
        limits.append(
            Message(
                "the calibration gives no uncertainty: its errors are uncertain by their plausible sizes, and no figures are given"
            )
        )
    return limits


def _errors_now(machine: Machine, calibration: Calibration | None) -> tuple[Calibration, list[Message]]:
    """Return the errors as the control leaves them, and a notice on its corrections."""
    if calibration is None or calibration.control is None:
        return Calibration.zero(machine) if calibration is None else calibration, []
    errors = errors_while_on(calibration) if calibration.corrected_in_control else calibration
    return errors, [
        Message("the corrections of the control that the calibration lists are taken as active in these readings")
    ]


def _plausible_errors(machine: Machine, tables: Sequence[Measurements]) -> Unknowns:
    """Return all errors that the positions of some tables could show."""
    bases = {axis.name: bases_for(rotary=not axis.linear, endless=axis.lower is None)[0] for axis in machine.axes}
    positions = np.concatenate([table.positions for table in tables])
    spaces, constants = spaces_for(machine, positions, bases=bases, most=FUNCTIONS, wanted=lambda name: True)
    return Unknowns(machine, spaces, constants, axes_with_known_places(machine, tables[0]))


def _linearised(
    machine: Machine,
    table: Measurements,
    errors: Calibration,
    unknowns: Unknowns,
    written: Sequence[WrittenValue],
    prior: Unknowns | None,
) -> tuple[LinearReadings, list[Message]]:
    """Return the linear model of a table, and what to know of its rows and its noise."""
    placed = prepared(machine, table, written)
    noise = reading_noise(machine, placed, "stated", named=False)

    def network(some: Unknowns) -> Network:
        return Network(machine, placed.data, placed.instruments, some, errors, noise.covariance, check=False)

    # The set-up alone: with free constants, combinations that only the set-up could compensate would carry it away.
    solution = solve(network(Unknowns(machine, (), ())), np.zeros(0), placed.setup, np.ones(len(placed.data)))
    if not solution.converged:
        raise table.error("the set-up of these readings cannot be estimated", expected="more or other positions", row=0)
    name = "" if table.source is None else f"{table.source}: "
    said = [
        *placed.data.notices,
        *noise.notices,
        *(Message("set aside, {text}", text=text) for text in grouped_notes(placed.data.set_aside)),
    ]
    return linear_readings(network(unknowns), solution.setup, errors, written, prior), [
        Message("{file}{text}", file=name, text=text) for text in said
    ]


def _wider(readings: LinearReadings) -> LinearReadings:
    return replace(readings, errors=WIDER * readings.errors)


@final
@dataclass(frozen=True)
class _Task:
    """Input of the verdict."""

    machine: Machine
    errors: Calibration
    unknowns: Unknowns
    prior: Unknowns | None
    written: tuple[WrittenValue, ...]
    weigher: Weigher
    tool_length_mm: float

    def confirmation(
        self,
        box: Mapping[str, tuple[float, float]],
        noise: float,
        readings: int,
        notices: tuple[Message, ...],
        warnings: tuple[SourceWarning, ...],
    ) -> Confirmation:
        """Return the verdict with everything that belongs to it."""
        groups = groups_of(self.named)
        state, others = best_hypothesis(self.weigher, list(groups.values()))
        _, chi2, estimate, covariance = self.weigher.fit(state, list(groups.values()))
        p_value = float(chi2_sf(chi2, self.weigher.rank))
        values = self._values(state, list(groups.values()))
        findings = () if state == Hypothesis() else self.sentences(state, groups, estimate, covariance)
        verdict: Verdict
        if state == Hypothesis():
            if p_value < UNEXPLAINED_BELOW:
                verdict = "changed otherwise"
                findings = (
                    Message(
                        "changed otherwise: no single scale, squareness, location or written value explains the readings"
                    ),
                )
            elif not self.written:
                verdict = "unchanged"
            elif any(value.matters and value.says == "not shown" for value in values):
                verdict, seen = (
                    "undecided",
                    [value.name for value in values if value.matters and value.says == "not shown"],
                )
                findings = (
                    Message(
                        "undecided: these readings cannot show the sign of {names}",
                        names=_names(seen, groups, self.named),
                    ),
                )
            else:
                verdict = "confirmed"
        elif not self.written:
            verdict = "moved"
        elif any(factor != 0.0 for _, factor in state.factors) or state.axes or any(one < 0 for one in state.free):
            verdict = "wrong"
        elif state.factors:
            verdict = "not in effect" if len(state.factors) == len(self.written) and not state.free else "wrong"
        else:
            verdict = "changed otherwise"
        before, expected, expanded, measured = self._figures(state, list(groups.values()))
        return Confirmation(
            machine=self.machine,
            verdict=verdict,
            findings=findings,
            alternatives=tuple(
                dict.fromkeys(
                    joined("; ", self.sentences(one, groups)) for one in others if _differs(state, one, values)
                )
            ),
            values=values,
            moved=self._moved(state, estimate, covariance),
            tool_length_mm=self.tool_length_mm,
            before_um=before,
            expected_um=expected,
            expanded_um=expanded,
            measured_um=measured,
            bound=self._bound(state, list(groups.values()), box),
            p_value=p_value,
            noise=float(noise),
            readings=readings,
            notices=notices,
            warnings=warnings,
        )

    @cached_property
    def _at_rest(self) -> Calibration:
        """The errors without effects that need a channel."""
        return without_missing_channels(Conditions(), self.errors)[0]

    @property
    def _volume(self) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Positions (n, axes) over the volume, and the same by name with directions of approach."""
        q = volume(self.machine, POSES, SEED)
        upwards = {f"approach_{name}": np.ones(len(q)) for name in self.machine.names}
        return q, dict(zip(self.machine.names, q.T, strict=True)) | upwards

    @cached_property
    def named(self) -> tuple[WrittenValue, ...]:
        """The written values; the name of a table also has the errors that it corrects: ``table Y by X (E_YX)``.

        An error of the axis that the table is over belongs to it if it cancels `CARRIED` of the table's squared effect at the tool.
        """
        tables = [k for k, value in enumerate(self.written) if value.name.startswith("table ")]
        if not tables:
            return self.written
        q, state = self._volume
        by_error, own = self._by_error(q), self.at_tool[0]
        index = {(frame.axis, frame.role): 6 * i for i, frame in enumerate(self.machine.frames)}
        shares: dict[int, list[tuple[float, str]]] = {k: [] for k in tables}
        for effect in self._at_rest.effects:
            at, moved = index[effect.frame.axis, effect.frame.role], np.zeros((len(q), 3))
            for c, value in effect.components(state).items():
                moved += by_error[:, :, at + c] * ((1.0 if c < 3 else URAD / UM) * np.reshape(value, (-1, 1)))
            group = f"all tables over {effect.frame.axis}" if effect.frame.role == "motion" else ""
            for k in (k for k in tables if group in self.written[k].groups):
                share = -float(np.sum(own[:, :, k] * moved) / max(np.sum(own[:, :, k] ** 2), 1e-12))
                shares[k] += [(share, effect.name)] if share >= CARRIED else []
        errors = {
            k: ", ".join(name for _, name in sorted(found, reverse=True)[:3]) for k, found in shares.items() if found
        }
        return tuple(
            replace(value, name=f"{value.name} ({errors[k]})") if k in errors else value
            for k, value in enumerate(self.written)
        )

    @cached_property
    def at_tool(self) -> tuple[np.ndarray, ...]:
        """Effects on the tool point over the volume, (n, 3, columns) µm each, as `effects_on`; the last is that of the calibration."""
        (q, state), known = self._volume, self._at_rest
        identified = replace(known, not_identifiable=())
        found = effects_on(self._by_error(q), self.machine, identified, self.written, self.unknowns, self.prior, state)
        real, nominal = (
            Kinematics(self.machine, one, tool_length_mm=self.tool_length_mm).forward(q).point_mm
            for one in (known, Calibration.zero(self.machine))
        )
        return (*(one.reshape(len(q), 3, -1) / UM for one in found), (real - nominal)[:, :, None] * 1e3)

    def _by_error(self, q: np.ndarray) -> np.ndarray:
        """Return (n, 3, 6·frames) the derivative of the tool point by every component of every error frame."""
        zero = Calibration.zero(self.machine)
        return Kinematics(self.machine, zero, tool_length_mm=self.tool_length_mm).sensitivities(q).error[:, :3]

    def _figures(self, state: Hypothesis, groups: Sequence[Sequence[int]]) -> tuple[float, float, float, float]:
        """Return the RMS error at the tool before, expected with its U, and measured, µm; NaN without written values."""
        if not self.written or self.prior is not None:
            return (np.nan,) * 4
        written, elsewhere, constants, by_errors, before = self.at_tool
        x, errors = self.weigher.coefficients(state, groups)
        known = slice(0, by_errors.shape[2])  # errors that no reading determines follow those of the calibration
        if set(self.errors.covariance.names) != set(self._at_rest.covariance.names):
            return (np.nan,) * 4  # an effect that needs a temperature, a time or a speed
        expected = before[:, :, 0] + written.sum(axis=2)
        drawn = np.random.default_rng(SEED).standard_normal((by_errors.shape[2], DRAWS))
        low, high = np.quantile(rms_length(expected[:, :, None] + by_errors @ drawn), (0.025, 0.975))
        measured = (
            before[:, :, 0] + np.concatenate([written, elsewhere, constants], axis=2) @ x + by_errors @ errors[known]
        )
        one, two, three = (float(rms_length(part.reshape(len(part), 3, 1))[0]) for part in (before, expected, measured))
        return one, two, float(high - low) / 2.0, three

    def _values(self, hypothesis: Hypothesis, groups: Sequence[Sequence[int]]) -> tuple[ConfirmedValue, ...]:
        """Return every written value with its effect at the tool and its factor."""
        if not self.written:
            return ()
        effects = self.at_tool[0]
        rms, matters = mattering(effects)
        factor, u = self.weigher.factors(hypothesis)
        words = {1.0: "as written", 0.0: "absent", -1.0: "reversed"}
        held = dict(hypothesis.factors)
        says = [words.get(held.get(k, 1.0), "otherwise") for k in range(len(factor))]
        says = [
            "not shown" if one == "as written" and not seen else one
            for one, seen in zip(says, shown(self.weigher, hypothesis, groups), strict=True)
        ]
        return tuple(
            ConfirmedValue(value.name, float(rms[k]), float(factor[k]), float(2.0 * u[k]), bool(matters[k]), says[k])
            for k, value in enumerate(self.named)
        )

    def _moved(self, state: Hypothesis, estimate: np.ndarray, covariance: np.ndarray) -> tuple[MovedError, ...]:
        """Return the constant errors that changed, in words, with where to look."""
        found = []
        for k, one in enumerate(state.free):
            if one < 0:
                continue
            name, size, expanded, unit = self._constant(one, float(estimate[k]), float(covariance[k, k]))
            kind, words = "axis_location", motion_in_words(name)
            if name[3] != "0":
                kind, words = "positioning", f"scale of {name[3]}"
            elif name in self.machine.squareness_names:
                kind, words = "squareness", f"squareness of {name[4]}"
            look = next(one.advice.look for one in MACHINE_EFFECTS if one.name == kind).format(
                axis=name[-1], where=name
            )
            at_tool = np.linalg.norm(self.at_tool[2][:, :, one] * float(estimate[k]), axis=1).max()
            found.append(MovedError(name, size, expanded, unit, float(at_tool), words, look))
        return tuple(found)

    def _constant(self, number: int, estimate: float, variance: float) -> tuple[str, float, float, str]:
        """Return name, change, U and unit of a constant error: µm/m of a scale."""
        name, plausible = self.unknowns.columns[number].entity, float(self.unknowns.plausible[number])
        curve = next((one for one in self.unknowns.curves if one.name == name), None)
        factor = plausible * (1.0 if curve is None else scale_unit(curve))
        return (
            name,
            factor * estimate,
            2.0 * factor * float(np.sqrt(variance)),
            "um/m" if curve is not None else unit_of(name),
        )

    def _bound(
        self, state: Hypothesis, groups: Sequence[Sequence[int]], box: Mapping[str, tuple[float, float]]
    ) -> MotionBound:
        """Return the bound at the tool from all constant errors together, without those that are named as changed."""
        weigher, named = self.weigher, {one for one in state.free if one >= 0}
        rest = [k for k in range(weigher.constants) if k not in named]
        every = replace(state, free=(*state.free, *rest))
        _, _, estimate, covariance = weigher.fit(every, groups)
        last = slice(len(state.free), None)
        size, directions = np.linalg.eigh(covariance[last, last])
        seen = directions[:, size < UNSEEN]
        hidden = [
            self.unknowns.columns[k].entity
            for k, v in zip(rest, np.diag(covariance[last, last]), strict=True)
            if v >= UNSEEN
        ]
        rng = np.random.default_rng(SEED)
        drawn = estimate[last, None] + symmetric_root(covariance[last, last]) @ rng.standard_normal((len(rest), DRAWS))
        change = seen @ (seen.T @ drawn)
        whole = volume(self.machine, POSES, SEED)
        low, high = np.array(list(box.values())).T
        ranges = np.array([axis.domain for axis in self.machine.axes])
        inside = low + (whole - ranges[:, 0]) / np.ptp(ranges, axis=1) * (high - low)
        bounds = []
        for q in (inside, whole):
            state_at = dict(zip(self.machine.names, q.T, strict=True))
            by_constant = effects_on(
                self._by_error(q), self.machine, self.errors, (), self.unknowns, self.unknowns, state_at
            )[2]
            moved = (by_constant[:, rest] @ change).reshape(len(q), 3, -1) / UM
            bounds.append(float(np.quantile(np.linalg.norm(moved, axis=1).max(axis=0), 0.95)))
        return MotionBound(bounds[0], bounds[1], box, tuple(hidden))

    def sentences(
        self,
        state: Hypothesis,
        groups: Mapping[str, Sequence[int]],
        estimate: np.ndarray | None = None,
        covariance: np.ndarray | None = None,
    ) -> tuple[str, ...]:
        """Return what a state says, one sentence each."""
        by_value: dict[tuple[float, int | None], list[int]] = {}
        axes = dict(state.axes)
        for k, factor in state.factors:
            by_value.setdefault((factor, axes.get(k)), []).append(k)
        found = []
        for (factor, axis), some in by_value.items():
            names = [self.named[k].name for k in some]
            left = [value.name for k, value in enumerate(self.named) if k not in some]
            few = (
                Message("only {names} took effect", names=_names(left, groups, self.named))
                if left
                else Message("nothing changed")
            )
            words = few if len(left) < len(names) else ""
            found.append(self._mistake(factor, axis, _names(names, groups, self.named), words))
        for k, one in enumerate(state.free):
            if one < 0:
                name, members = list(groups.items())[-1 - one]
                about = dict(state.factors).get(members[0], 1.0)
                if estimate is None or covariance is None:
                    found.append(Message("{name} acts with another share of its values", name=name))
                else:
                    size = Number(f"{about + estimate[k]:.2f} ± {2 * np.sqrt(covariance[k, k]):.2f}")
                    found.append(Message("{name} acts with {size} times its values", name=name, size=size))
            else:
                what = self.unknowns.columns[one].entity
                if estimate is not None and covariance is not None:
                    name, change, expanded, unit = self._constant(one, float(estimate[k]), float(covariance[k, k]))
                    what = Message(
                        "{name} by {size}", name=name, size=Number(f"{change:+.3g} ± {expanded:.2g} {readable(unit)}")
                    )
                found.append(
                    Message("changed otherwise: {what}", what=what)
                    if self.written
                    else Message("moved: {what}", what=what)
                )
        return tuple(found) or (
            Message("everything in effect as written") if self.written else Message("nothing moved"),
        )

    def _mistake(self, factor: float, axis: int | None, names: str, left: str) -> str:
        """Return a sentence on values that do not act as written; ``left``: words on the others, if few act."""
        if axis is not None:
            return Message("{names}: moves {axis} instead", names=names, axis=self.machine.names[axis])
        if factor == 0.0:
            return Message("not in effect: {names}", names=left or names)
        if factor == -1.0:
            return Message("sign of {names} reversed: the error doubled", names=names)
        if factor == 2.0:
            return Message("{names} in effect twice", names=names)
        return Message("{names} in effect with {factor:g} times the values: wrong unit?", names=names, factor=factor)


def _differs(one: Hypothesis, other: Hypothesis, values: Sequence[ConfirmedValue]) -> bool:
    """Return whether two states differ in a value that matters, or in the free ones."""
    states = [(dict(state.factors), dict(state.axes)) for state in (one, other)]
    return one.free != other.free or any(
        value.matters and len({(factors.get(k, 1.0), axes.get(k)) for factors, axes in states}) > 1
        for k, value in enumerate(values)
    )


def _names(names: Sequence[str], groups: Mapping[str, Sequence[int]], written: Sequence[WrittenValue]) -> str:
    """Return the name of the group that these values are, else their names, else how many they are."""
    numbers = [value.name for value in written]
    some = sorted(numbers.index(name) for name in names)
    group = next((name for name, own in groups.items() if sorted(own) == some), None)
    if group is not None:
        return group
    return listed(list(names)) if len(names) <= 4 else f"{', '.join(names[:3])} and {len(names) - 3} more"
