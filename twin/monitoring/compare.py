"""Comparison of two calibrations of one machine."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, final

import numpy as np
import scipy

from twin._common.errors import InputError, require_type
from twin._common.messages import Message, Number, Quoted, joined
from twin._common.provenance import merge_warnings
from twin._common.resources import Progress, silent
from twin.display.numbers import COVERAGE_FACTOR, readable
from twin.model.calibration import Calibration
from twin.model.conditions import Conditions, needed_values
from twin.model.datum import MEAN_LINES
from twin.model.effects import Effect, split_name
from twin.monitoring.comparison import (
    LOOKS,
    Changes,
    Culprits,
    changed_in_words,
    common_pattern,
    number,
    place,
    some_of,
)
from twin.monitoring.pairs import (
    FALSE_ALARMS_OF_A_TEST,
    ErrorChange,
    NotCompared,
    Pair,
    holm_adjusted,
    joint_covariance,
    not_identified,
    pair_errors,
    simultaneous_factor,
    smallest_set,
    whiten,
)
from twin.monitoring.tool import POSES, ActingError, JudgedErrors, at_tool
from twin.tool.uncertainty import without_missing_channels

NAMED_SHAPE_SHARE: Final = 0.9
"""Share of the mean square of a change that a line, a parabola or one wave per turn must explain to name the shape."""


def compare(
    first: Calibration,
    second: Calibration,
    *,
    tool_length_mm: float | None = None,
    conditions: Conditions | None = None,
    tolerance_mm: float | None = None,
    poses: int = POSES,
    progress: Progress = silent,
) -> Changes:
    """Return the changes from one calibration of a machine to another, with their significance and effect at the tool.

    Both are converted to mean lines first (`twin.model.datum`). The two are taken as independent of each other, except for errors
    with identical numbers. An error that only one of them contains is not compared: a missing error is not a zero error.

    Args:
        first: the older calibration.
        second: the newer calibration.
        tool_length_mm: tool length for the effect at the tool; None for the machine file's.
        conditions: temperatures and time, for effects that need them.
        tolerance_mm: largest error at the tool that the older calibration may leave on the machine described by the newer.
        poses: number of poses at which the tool point is evaluated.
        progress: called with the stage and the fraction done.

    Raises:
        InputError: calibrations of different machines; one measured under control tables and the other without; conditions that
            neither calibration uses; a tolerance that is not positive.

    Examples:
        >>> from dataclasses import replace
        >>> machine = twin.Machine.load("dmu50")
        >>> last_year = twin.Calibration.default(machine)
        >>> today = replace(last_year, squareness={**last_year.squareness, "E_C0Y": 40.0})
        >>> changes = twin.compare(last_year, today, tool_length_mm=120)
        >>> [(change.name, round(change.rms, 1), change.unit) for change in changes.errors if change.rms > 0]
        [('E_C0Y', 123.8, 'urad')]
        >>> round(changes.tool.left.max_um, 1)  # largest error that the older calibration leaves
        57.7

    References:
        - S. Holm: A simple sequentially rejective multiple test procedure, Scand. J. Statist. 6 (1979) 65-70.
    """
    notices, named = (
        _check_tables(first, second),
        (_label(first, Message("the first")), _label(second, Message("the second"))),
    )
    first, second = (side.with_control(None) if side.corrections else side for side in (first, second))
    at = _checked_conditions(conditions, first, second, tolerance_mm)
    progress("comparing", 0.0)
    first, second, datum, moved = _in_one_datum(first, second)
    pairs, alone = pair_errors(first, second)
    not_compared = tuple(one for one in alone if one.name not in moved)
    progress("comparing", 0.05)
    errors, whole = _error_changes(pairs, first, second)
    sides, left_out = _without_missing_channels(at, first, second)
    known = _errors_at_tool(pairs, errors, whole, {name for name, _ in left_out})
    tool = at_tool(
        sides[0], sides[1], known, tool_length_mm=tool_length_mm, conditions=at, poses=poses, progress=progress
    )
    changes = Changes(
        machine=first.machine,
        warnings=merge_warnings(first.warnings, second.warnings),
        first=named[0],
        second=named[1],
        errors=errors,
        not_compared=not_compared,
        not_identified=not_identified(first, second),
        joint_p_value=whole.p_value,
        joint_dof=whole.dof,
        culprits=whole.culprits,
        tool=tool,
        tolerance_mm=tolerance_mm,
        left_out=left_out,
        notices=(*notices, datum, *_notices(first, second, pairs, not_compared)),
    )
    progress("comparing", 1.0)
    return replace(changes, meaning=meaning_of(changes))


def _errors_at_tool(
    pairs: Sequence[Pair], errors: Sequence[ErrorChange], whole: _JointChange, absent: Collection[str]
) -> JudgedErrors:
    """Return the errors that can be tested at the tool, without those that lack a channel."""
    doubtful = {*absent, *(error.name for error in errors if error.without_variance > 0.0)}
    return JudgedErrors(
        classes={p.name: p.iso_class for p in pairs if p.status != "unknown" and p.name not in doubtful},
        drawn=[p.name for p in pairs if p.status == "known" and p.name not in doubtful],
        share=FALSE_ALARMS_OF_A_TEST,
        causes={name: cause for name, cause in whole.causes.items() if name not in absent},
        whole_model=not absent,
    )


def _error_changes(
    pairs: Sequence[Pair], first: Calibration, second: Calibration
) -> tuple[tuple[ErrorChange, ...], _JointChange]:
    """Return the change of each error, with p-values corrected for multiple testing, and the joint change of all known ones."""
    errors = [_change(pair, pair.change, pair.covariance) for pair in pairs]
    known = [i for i, pair in enumerate(pairs) if pair.status == "known"]
    p_values = [whiten(pairs[i].change, pairs[i].covariance, pairs[i].exact).p_value for i in known]
    whole = _joint_change([pairs[i] for i in known], first, second)
    for i, p, adjusted, without_variance in zip(
        known, p_values, holm_adjusted(p_values), whole.without_variance, strict=True
    ):
        errors[i] = replace(
            errors[i],
            p_value=p,
            p_adjusted=adjusted,
            without_variance=max(errors[i].without_variance, without_variance),
        )
    return tuple(errors), whole


def _without_missing_channels(
    at: Conditions, first: Calibration, second: Calibration
) -> tuple[list[Calibration], tuple[tuple[str, str], ...]]:
    """Return both calibrations without the effects whose channels are not given, and those effects with what they need."""
    limited = [without_missing_channels(at, side) for side in (first, second)]
    needs = [(name, needed_values([channel])) for _, gone in limited for channel, by in gone.items() for name in by]
    absent = {name for name, _ in needs}
    return [side.where(lambda name: name not in absent) for side, _ in limited], tuple(dict.fromkeys(needs))


def _in_one_datum(first: Calibration, second: Calibration) -> tuple[Calibration, Calibration, Message, set[str]]:
    """Return both calibrations in mean lines, or unchanged if one cannot be converted; a sentence about it; errors new to both.

    If neither is in mean lines, only errors that one of them contains may change: constants and slopes that only another error could
    take over stay in the curves of both.
    """
    given = first.datum, second.datum
    named = {name for side in (first, second) for name in (*side.curves, *side.squareness, *side.location)}
    may_change = None if MEAN_LINES in given else named
    try:
        one, two = (side.in_datum(MEAN_LINES, may_change) for side in (first, second))
    except InputError as error:
        text = Message(
            "not converted to mean lines; each file is compared in its own datum: {why} (twin doc datum)",
            why=Quoted(error.what),
        )
        return first, second, text, set()
    converted = [
        Message("{name} from {datum}", name=name, datum=datum)
        for name, datum in zip(
            (_label(first, Message("the first")), _label(second, Message("the second"))), given, strict=True
        )
        if datum != MEAN_LINES
    ]
    if not converted:
        return one, two, Message("both are in mean lines (twin doc datum)"), set()
    text = Message("both converted to mean lines: {names} (twin doc datum)", names=joined(", ", converted))
    moved = {name: None for side in (one, two) for name in (*side.curves, *side.squareness, *side.location)}
    only = [name for name in moved if name not in named]
    if only:
        text += Message(
            "; not compared error by error, because neither file contains it: {names}", names=", ".join(only)
        )
    return one, two, text, set(only)


def _check_tables(first: Calibration, second: Calibration) -> list[Message]:
    """Return notices on the control's tables; `InputError` if these make the calibrations not comparable: not in both, or different."""
    for name, side in (("first", first), ("second", second)):
        require_type(name, side, Calibration)
    one, two = first.control, second.control
    kinds = ["remaining" if c is not None and c.errors_are == "remaining" else "uncorrected" for c in (one, two)]
    what = "kinematics module" if any(c is not None and c.live for c in (one, two)) else "tables"
    several = "kinematics modules" if what == "kinematics module" else what
    if kinds[0] != kinds[1]:
        raise InputError(
            f"one calibration gives the machine's own errors, the other those remaining under the control's {what}; they differ by the "
            f"{what} even if the machine did not change",
            expected=f"both `errors_are: uncorrected`, or both `remaining` under the same {what}",
            file=second.path,
            value=f"{kinds[0]} and {kinds[1]}",
        )
    tables = [set() if c is None else {entry.sha256 for entry in (*c.tables, *c.live)} for c in (one, two)]
    if kinds[0] == "remaining":
        if tables[0] != tables[1]:
            raise InputError(
                f"the calibrations give the errors remaining under different {several} of the control; they differ by them even if "
                "the machine did not change",
                expected=f"two calibrations measured under the same {what}",
                file=second.path,
                value=f"different {several}",
            )
        return [
            Message(
                "both give the errors remaining under the same kinematics module of the control; the machine's own "
                "errors are not "
                "compared"
            )
            if what == "kinematics module"
            else Message(
                "both give the errors remaining under the same tables of the control; the machine's own errors are "
                "not compared"
            )
        ]
    if not (tables[0] or tables[1]):
        return []
    if what == "kinematics module":
        text = Message(
            "the machine's own errors are compared, without the kinematics module of the control, which corrects them"
        )
        differs = Message("; the kinematics module differs between the two")
    else:
        text = Message(
            "the machine's own errors are compared, without the tables of the control, which correct part of them"
        )
        differs = Message("; the tables differ between the two")
    return [text if tables[0] == tables[1] else text + differs]


def _checked_conditions(
    conditions: Conditions | None, first: Calibration, second: Calibration, tolerance_mm: float | None
) -> Conditions:
    """Return the conditions; raise `InputError` for different machines, a tolerance that is not positive, or unused conditions."""
    at = Conditions() if conditions is None else conditions
    machine = first.machine
    if second.machine.name != machine.name or second.machine.names != machine.names:
        raise InputError(
            "calibrations of different machines", expected=f"both of {machine.name}", value=second.machine.name
        )
    if tolerance_mm is not None and not 0.0 < tolerance_mm < np.inf:
        raise InputError("tolerance must be positive", expected="a positive number of mm", value=tolerance_mm)
    extra = {effect.name: effect for side in (first, second) for effect in side.extra}
    at.check(replace(first, extra=tuple(extra.values())))
    return at


def _label(calibration: Calibration, otherwise: str) -> str:
    return otherwise if calibration.path is None else str(calibration.path)


@final
@dataclass(frozen=True)
class _JointChange:
    """The joint change of all known errors."""

    p_value: float  # of its χ²; NaN and 0 without known errors
    dof: int
    culprits: Culprits  # the smallest set of errors that explains it
    without_variance: tuple[float, ...]  # for each error, the largest change in directions without variance
    causes: Mapping[str, ActingError]  # changes of the errors of that set, as functions of the state of the machine


def _joint_change(pairs: Sequence[Pair], first: Calibration, second: Calibration) -> _JointChange:
    if not pairs:
        return _JointChange(float("nan"), 0, Culprits((), (), (), float("nan")), (), {})
    change = np.concatenate([pair.change for pair in pairs])
    exact = scipy.linalg.block_diag(*(pair.exact for pair in pairs))
    white = whiten(change, joint_covariance(pairs, (first.covariance, second.covariance)), exact)
    axes = first.machine.by_name
    joint = smallest_set(pairs, white, [axes[pair.axis].linear for pair in pairs])
    errors = []
    for culprit in joint.culprits:
        p = min(culprit.p_value * joint.tried, 1.0)
        errors.append(
            replace(
                _change(pairs[culprit.pair], culprit.change, culprit.covariance),
                p_value=culprit.p_value,
                p_adjusted=p,
                without_variance=0.0,
            )
        )
    culprits = Culprits(
        tuple(errors),
        tuple(tuple(pairs[i].name for i in culprit.alternatives) for culprit in joint.culprits),
        tuple(
            _shape_of(pairs[culprit.pair], culprit.change, linear=axes[pairs[culprit.pair].axis].linear)
            for culprit in joint.culprits
        ),
        joint.left_p_value,
        tuple(
            (pair.name, size, pair.unit)
            for pair, size in zip(pairs, joint.shows_from, strict=True)
            if pair.kind == "number" and np.isfinite(size)
        ),
    )
    starts = np.concatenate([[0], np.cumsum([len(pair.change) for pair in pairs])])
    still = [
        float(np.abs(pair.shape @ white.without_variance[start : start + len(pair.change)]).max(initial=0.0))
        for pair, start in zip(pairs, starts, strict=False)
    ]
    effects = {effect.name: effect for effect in second.effects}
    causes = {
        pairs[culprit.pair].name: _as_effect(pairs[culprit.pair], culprit.change, effects[pairs[culprit.pair].name])
        for culprit in joint.culprits
    }
    return _JointChange(white.p_value, white.rank, culprits, tuple(still), causes)


def _as_effect(pair: Pair, change: np.ndarray, effect: Effect) -> ActingError:
    """Return the change of one error as frame and components: a curve by interpolation, other numbers by their derivatives."""

    def components(state: Mapping[str, Any]) -> Mapping[int, Any]:
        if pair.kind == "curve":
            lo, hi = pair.positions[0], pair.positions[-1]
            q = np.asarray(state[pair.axis])
            inside = np.where((q >= lo) & (q <= hi), q, lo + (q - lo) % (hi - lo))
            return {split_name(pair.name)[0]: np.interp(inside, pair.positions, pair.shape @ change)}
        total: dict[int, Any] = {}
        for size, rates in zip(change, effect.derivatives(state), strict=True):
            for component, rate in rates.items():
                total[component] = total.get(component, 0.0) + size * rate
        return total

    return effect.frame, components


def _change(pair: Pair, change: np.ndarray, covariance: np.ndarray) -> ErrorChange:
    values = pair.shape @ change
    known, curve = pair.status == "known", pair.kind == "curve"
    u = np.full(len(values), np.nan)
    if known:
        u = np.sqrt(np.maximum(np.einsum("gi,ij,gj->g", pair.shape, covariance, pair.shape), 0.0))
    elif pair.status == "same":
        u = np.zeros(len(values))
    size = np.abs(values)
    if pair.kind == "effect" and known:
        size = np.where(u > 0.0, size / np.where(u > 0.0, u, 1.0), 0.0)
    row = int(np.argmax(size))
    factor = simultaneous_factor(pair.shape, covariance) if known and curve else COVERAGE_FACTOR
    white = whiten(change, covariance, pair.exact) if known else None
    return ErrorChange(
        name=pair.name,
        kind=pair.kind,
        unit=pair.unit or pair.labels[row][1],
        axis=pair.axis,
        iso_class=pair.iso_class,
        status=pair.status,
        label=pair.labels[row][0] if pair.kind == "effect" else "",
        rms=float(np.sqrt(np.mean(values**2))) if curve else float(abs(values[row])),
        largest=float(values[row]),
        at=float(pair.positions[row]) if curve else float("nan"),
        u=float(u[row]),
        band=float(factor * u[row]),
        p_value=1.0 if pair.status == "same" else float("nan"),
        p_adjusted=1.0 if pair.status == "same" else float("nan"),
        without_variance=0.0 if white is None else float(np.abs(pair.shape @ white.without_variance).max(initial=0.0)),
        notes=pair.notes,
    )


def _shape_of(pair: Pair, change: np.ndarray, *, linear: bool) -> str:
    """Return the shape of a change along its axis (`Culprits.trends`), or an empty string."""
    if pair.kind != "curve":
        return ""
    values, q = pair.shape @ change, pair.positions
    u = np.linspace(-1.0, 1.0, len(q))
    angle = np.deg2rad(q)
    ways = (
        (("constant", [np.ones_like(u)]), ("line", [np.ones_like(u), u]), ("bow", [np.ones_like(u), u, u**2]))
        if linear
        else (("constant", [np.ones_like(u)]), ("turn", [np.ones_like(u), np.cos(angle), np.sin(angle)]))
    )
    for name, functions in ways:
        columns = np.stack(functions, axis=1)
        left = values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
        if np.sum(left**2) <= (1.0 - NAMED_SHAPE_SHARE) * np.sum(values**2):
            return name
    return ""


def _notices(
    first: Calibration, second: Calibration, pairs: Sequence[Pair], not_compared: Sequence[NotCompared]
) -> list[Message]:
    notices = list[Message]()
    drawn = [name for side in (first, second) for name, curve in side.curves.items() if curve.illustrative]
    if drawn:
        notices.append(
            Message(
                "illustrative curves, not measured, in one or both: {names}. Their change is not of a real machine",
                names=", ".join(dict.fromkeys(drawn)),
            )
        )
    same = [pair.name for pair in pairs if pair.status == "same"]
    if same and len(same) < len(pairs) + len(not_compared):
        notices.append(
            Message(
                "identical numbers in both, taken as one estimate: {names}. If one file was made from the other, "
                "their remaining common parts are still taken as independent, and the uncertainty of the change is "
                "too large",
                names=", ".join(same),
            )
        )
    if any(pair.status == "known" for pair in pairs):
        notices.append(
            Message(
                "the calibrations are taken as independent and their uncertainties as stated: a misfit reported by "
                "`twin identify` is in no covariance"
            )
        )
    return notices


# --- The meaning of a comparison, in sentences that a technician can act on ---------------------------

MOST_NAMED: Final = 6


def meaning_of(found: Changes) -> tuple[str, ...]:
    """Return the sentences, the most important first."""
    verdict = found.verdict
    sentences: list[str] = []
    if verdict == "same":
        sentences.append(Message("The two calibrations have identical numbers; there is nothing to compare."))
    elif verdict == "unknown":
        same = any(error.status == "same" for error in found.errors)
        why = (
            Message("the errors that both contain have identical numbers or no uncertainty")
            if same
            else Message("for no error do both calibrations state an uncertainty")
        )
        sentences.append(
            Message(
                "It cannot be decided whether anything changed: {why}. The differences are listed without a test.",
                why=why,
            )
        )
    elif verdict == "unchanged":
        sentences += _unchanged(found)
    else:
        sentences += _changed(found)
    if verdict == "reworded":
        sentences.insert(
            0,
            Message(
                "The numbers changed but the tool did not move: changes of several errors cancel, for example if the "
                "same constant or slope is attributed to a different error. Both calibrations compensate alike; "
                "leave the machine as it is."
            ),
        )
    if found.unjudged and verdict in ("unchanged", "changed"):
        left_out = {name for name, _ in found.left_out}
        names = [name for name in dict.fromkeys(found.unjudged) if name not in left_out]
        if left_out:
            needs = joined(
                ", ", [Message("{name} (needs {channel})", name=n, channel=channel) for n, channel in found.left_out]
            )
            sentences.append(Message("The results at the tool do not include {needs}.", needs=needs))
    else:
        names = []
    if names:
        sentences.append(
            Message(
                "This does not cover errors that could not be compared or tested: {names}.",
                names=some_of(names, MOST_NAMED),
            )
        )
    if found.not_identified:
        sentences.append(
            Message(
                "Nothing is known of {names}: neither calibration could determine them. A change of them is not "
                "seen; U of the remaining error includes their plausible size.",
                names=some_of([one.name for one in found.not_identified], MOST_NAMED),
            )
        )
    sentences += _verdict_on_tolerance(found)
    return tuple(sentences)


def _unchanged(found: Changes) -> list[str]:
    row = found.tool.judged
    sentences: list[str] = [
        Message(
            "All changes that could be tested are within the uncertainty of the two calibrations: the older one "
            "remains valid."
        )
    ]
    if row is not None and np.isfinite(row.limit_um):
        sentences.append(
            Message(
                "A change that moves the tool by less than about {limit} µm RMS over the volume may be undetected, "
                "unless only one or a few errors changed; these have lower detection limits.",
                limit=number(row.limit_um),
            )
        )
    if found.culprits.shows_from:
        limits = [(name, Number(f"{number(size)} {readable(own)}")) for name, size, own in found.culprits.shows_from]
        shown = joined(", ", [joined(" ", pair) for pair in limits])
        sentences.append(Message("Detection limits (19 of 20 comparisons, all else unchanged): {shown}.", shown=shown))
    return sentences


def _changed(found: Changes) -> list[str]:
    culprits = found.culprits
    sentences = []
    if culprits.errors:
        only = (
            Message("Only ")
            if len(culprits.errors) == 1
            and culprits.left_p_value > FALSE_ALARMS_OF_A_TEST
            and not culprits.alternatives[0]
            else ""
        )
        for error, others, trend in zip(culprits.errors, culprits.alternatives, culprits.trends, strict=True):
            sentences.append(changed_in_words(found, error, others, trend, only))
        if culprits.left_p_value > FALSE_ALARMS_OF_A_TEST:
            sentences.append(
                Message(
                    "All other changes are within the uncertainty; the sizes are estimated with all else taken as "
                    "unchanged."
                )
            )
        else:
            sentences.append(
                Message(
                    "This does not explain the whole change: more has changed than can be attributed to single errors."
                )
            )
        if found.verdict != "reworded":
            sentences += common_pattern(found)
    else:
        own = [error.name for error in found.errors if error.significant]
        if own:
            sentences.append(
                Message(
                    "Changed by more than the uncertainty, each tested by itself: {names}.",
                    names=some_of(own, MOST_NAMED),
                )
            )
        else:
            sentences.append(
                Message(
                    "There is a change, but it cannot be attributed to single errors with these two calibrations. "
                    "Detected by: {names}.",
                    names=joined(", ", [LOOKS[one] for one in found.seen_by]),
                )
            )
    return sentences


def _verdict_on_tolerance(found: Changes) -> list[str]:
    left, answer = found.tool.left, found.good_enough
    if not left.poses:
        return [
            Message("The error that the older calibration would leave cannot be evaluated: no pose is within reach.")
        ]
    if found.tolerance_mm is None:
        return []
    limit = Number(f"{number(found.tolerance_mm * 1e3)} µm")
    most = Message("{size} µm at most", size=number(left.max_um))
    if answer is True:
        return [
            Message(
                "The older calibration is good enough for {limit}: it leaves {most}, and no more than {high} µm with "
                "uncertainty (95 %).",
                limit=limit,
                most=most,
                high=number(left.upper_95_um),
            )
        ]
    if answer is False:
        return [
            Message(
                "The older calibration is not good enough for {limit}: it leaves {most} (at {where}), and no less "
                "than {low} µm with uncertainty (95 %).",
                limit=limit,
                most=most,
                where=place(left.where),
                low=number(left.lower_95_um),
            )
        ]
    if np.isfinite(left.upper_95_um):
        return [
            Message(
                "It cannot be decided whether the older calibration is good enough for {limit}: it leaves {most}, "
                "with uncertainty {low} to {high} µm (95 %).",
                limit=limit,
                most=most,
                low=number(max(left.lower_95_um, 0.0)),
                high=number(left.upper_95_um),
            )
        ]
    return [
        Message(
            "It cannot be decided whether the older calibration is good enough for {limit}: it leaves {most}, with "
            "unknown uncertainty.",
            limit=limit,
            most=most,
        )
    ]
