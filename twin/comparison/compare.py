"""Two calibrations of one machine, compared."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, final

import numpy as np
from scipy.linalg import block_diag

from twin._common.errors import InputError
from twin._common.provenance import merged
from twin.comparison.pairs import Apart, Pair, joint_spread, paired
from twin.comparison.result import Changes, Culprits, ErrorChange
from twin.comparison.significance import SHARE, fewest, holm, simultaneous_factor, whiten
from twin.comparison.tool import POSES, Cause, JudgedErrors, at_tool
from twin.comparison.words import meaning_of
from twin.display.numbers import COVERAGE_FACTOR
from twin.machine.calibration import Calibration
from twin.machine.conditions import Conditions, options_of
from twin.machine.datum import MEAN_LINES
from twin.machine.effects import Effect, split_name
from twin.uncertainty.budget import known_at

MOSTLY: Final = 0.9
"""Share of a change's mean square that a straight line, a bow or one wave a turn must make to be called that."""


def compare(
    first: Calibration,
    second: Calibration,
    *,
    tool_length_mm: float | None = None,
    conditions: Conditions | None = None,
    tolerance_mm: float | None = None,
    poses: int = POSES,
    progress: Callable[[str, float], None] = lambda stage, fraction: None,
) -> Changes:
    """What changed from one calibration of a machine to the next, and what of it is more than their uncertainty.

    Both are converted to mean lines first (`twin.machine.datum`). The two are taken as independent of each other, but for errors
    that have the very same numbers in both. An error only one of them gives is not compared: saying nothing is not the same as zero.

    Args:
        first: the older.
        second: the newer.
        tool_length_mm: for what it means at the tool; None for the machine file's own.
        conditions: temperatures and time, for effects that need them.
        tolerance_mm: what compensating with the older may leave on the machine of the newer.
        poses: over which the tool is looked at.
        progress: called with a stage and the fraction done.

    Raises:
        InputError: calibrations of two machines; one measured under control tables and one without; conditions of nothing either knows;
            a tolerance that is not positive.
    """
    machine = first.machine
    notices, named = _same_control(first, second), (_called(first, "the first"), _called(second, "the second"))
    first, second = (side.with_control(None) if side.corrections else side for side in (first, second))
    at = _checked(conditions, first, second, tolerance_mm)
    progress("comparing", 0.0)
    first, second, datum, moved = _in_one_datum(first, second)
    pairs, alone = paired(first, second)
    apart = tuple(one for one in alone if one.name not in moved)
    progress("comparing", 0.05)
    errors, whole = _judged(pairs, first, second)
    sides, left_out = _given(at, first, second)
    known = _known(pairs, errors, whole, {name for name, _ in left_out})
    tool = at_tool(
        sides[0], sides[1], known, tool_length_mm=tool_length_mm, conditions=at, poses=poses, progress=progress
    )
    found = Changes(
        machine=machine,
        warnings=merged(first.warnings, second.warnings),
        first=named[0],
        second=named[1],
        errors=errors,
        apart=apart,
        joint_p_value=whole.p_value,
        joint_dof=whole.dof,
        culprits=whole.culprits,
        tool=tool,
        tolerance_mm=tolerance_mm,
        left_out=left_out,
        notices=(*notices, datum, *_notices(first, second, pairs, apart)),
    )
    progress("comparing", 1.0)
    return replace(found, meaning=meaning_of(found))


def _known(
    pairs: Sequence[Pair], errors: Sequence[ErrorChange], whole: _Together, absent: Collection[str]
) -> JudgedErrors:
    """What of the errors counts at the tool, without those of which a channel is not given."""
    doubtful = {*absent, *(error.name for error in errors if error.fixed > 0.0)}
    return JudgedErrors(
        classes={p.name: p.iso_class for p in pairs if p.status != "unknown" and p.name not in doubtful},
        drawn=[p.name for p in pairs if p.status == "known" and p.name not in doubtful],
        share=SHARE,
        causes={name: cause for name, cause in whole.causes.items() if name not in absent},
        whole_model=not absent,
    )


def _judged(
    pairs: Sequence[Pair], first: Calibration, second: Calibration
) -> tuple[tuple[ErrorChange, ...], _Together]:
    """The change of every error by itself, p-values adjusted for their number, and of all known ones together."""
    errors = [_change(pair, pair.change, pair.spread) for pair in pairs]
    known = [i for i, pair in enumerate(pairs) if pair.status == "known"]
    p_values = [whiten(pairs[i].change, pairs[i].spread, pairs[i].exact).p_value for i in known]
    whole = _together([pairs[i] for i in known], first, second)
    for i, p, adjusted, fixed in zip(known, p_values, holm(p_values), whole.fixed, strict=True):
        errors[i] = replace(errors[i], p_value=p, p_adjusted=adjusted, fixed=max(errors[i].fixed, fixed))
    return tuple(errors), whole


def _given(
    at: Conditions, first: Calibration, second: Calibration
) -> tuple[list[Calibration], tuple[tuple[str, str], ...]]:
    """Both calibrations without the effects whose channels nobody gave, and those effects with what they need."""
    limited = [known_at(at, side) for side in (first, second)]
    needs = [(name, options_of([channel])) for _, gone in limited for channel, by in gone.items() for name in by]
    absent = {name for name, _ in needs}
    return [side.where(lambda name: name not in absent) for side, _ in limited], tuple(dict.fromkeys(needs))


def _in_one_datum(first: Calibration, second: Calibration) -> tuple[Calibration, Calibration, str, set[str]]:
    """Both calibrations in mean lines; as they are where one cannot be converted.

    Where neither is in mean lines, only errors that one of them names may change: what only another one could take over stays in the
    curves, in both alike.

    Returns:
        The two, the sentence that says so, and names of errors that neither named before.
    """
    given = first.datum, second.datum
    named = {name for side in (first, second) for name in (*side.curves, *side.squareness, *side.location)}
    may_change = None if MEAN_LINES in given else named
    try:
        one, two = (side.in_datum(MEAN_LINES, may_change) for side in (first, second))
    except InputError as error:
        text = f"not converted to mean lines, compared in the datum of each file: {error.what} (twin doc datum)"
        return first, second, text, set()
    converted = [
        f"{name} from {datum}"
        for name, datum in zip((_called(first, "the first"), _called(second, "the second")), given, strict=True)
        if datum != MEAN_LINES
    ]
    if not converted:
        return one, two, "both are in mean lines (twin doc datum)", set()
    text = f"both converted to mean lines: {', '.join(converted)} (twin doc datum)"
    moved = {name: None for side in (one, two) for name in (*side.curves, *side.squareness, *side.location)}
    only = [name for name in moved if name not in named]
    if only:
        text += f"; not compared error by error, since neither file names it: {', '.join(only)}"
    return one, two, text, set(only)


def _same_control(first: Calibration, second: Calibration) -> list[str]:
    """What is to be said of the control's own tables, if the two are about the same thing.

    Raises:
        InputError: they are not.
    """
    one, two = first.control, second.control
    kinds = ["remaining" if c is not None and c.errors_are == "remaining" else "uncorrected" for c in (one, two)]
    if kinds[0] != kinds[1]:
        raise InputError(
            "one calibration gives the machine's own errors, the other what the control's tables leave of them: they differ by the "
            "tables, whatever the machine did",
            expected="two measured alike: both `errors_are: uncorrected` or both `remaining` under the same tables",
            file=second.path,
            value=f"{kinds[0]} and {kinds[1]}",
        )
    tables = [set() if c is None else {entry.sha256 for entry in c.tables} for c in (one, two)]
    if kinds[0] == "remaining":
        if tables[0] != tables[1]:
            raise InputError(
                "both calibrations give what the control's tables leave, but of other tables: they differ by these, whatever the "
                "machine did",
                expected="two measured under the same tables",
                file=second.path,
                value="other tables",
            )
        return [
            "both are what the same tables of the control leave: compared is what they leave, not the machine's own errors"
        ]
    if tables[0] or tables[1]:
        return [
            "compared are the machine's own errors; the tables of the control, which take part of them out, are not in it"
            + ("" if tables[0] == tables[1] else ", and are not the same in both")
        ]
    return []


def _checked(
    conditions: Conditions | None, first: Calibration, second: Calibration, tolerance_mm: float | None
) -> Conditions:
    """The conditions, of which one of the two has to know each temperature; calibrations of one machine, a tolerance that can be."""
    at = Conditions() if conditions is None else conditions
    machine = first.machine
    if second.machine.name != machine.name or second.machine.names != machine.names:
        raise InputError("calibrations of two machines", expected=f"two of {machine.name}", value=second.machine.name)
    if tolerance_mm is not None and not 0.0 < tolerance_mm < np.inf:
        raise InputError("--tolerance is out of place", expected="a positive number of mm", value=tolerance_mm)
    extra = {effect.name: effect for side in (first, second) for effect in side.extra}
    at.check(replace(first, extra=tuple(extra.values())))
    return at


def _called(calibration: Calibration, otherwise: str) -> str:
    return otherwise if calibration.path is None else str(calibration.path)


@final
@dataclass(frozen=True)
class _Together:
    """All known changes together.

    Attributes:
        p_value, dof: of their χ²; NaN and 0 if there is none.
        culprits: the fewest errors that account for them.
        fixed: of every change, how much lies along no variance at all.
        causes: the changes of those fewest, as something that acts.
    """

    p_value: float
    dof: int
    culprits: Culprits
    fixed: tuple[float, ...]
    causes: Mapping[str, Cause]


def _together(pairs: Sequence[Pair], first: Calibration, second: Calibration) -> _Together:
    if not pairs:
        return _Together(float("nan"), 0, Culprits((), (), (), float("nan")), (), {})
    change = np.concatenate([pair.change for pair in pairs])
    exact = block_diag(*(pair.exact for pair in pairs))
    white = whiten(change, joint_spread(pairs, (first.covariance, second.covariance)), exact)
    axes = first.machine.by_name
    found = fewest(pairs, white, [axes[pair.axis].linear for pair in pairs])
    errors = []
    for one in found.culprits:
        p = min(one.p_value * found.tried, 1.0)
        errors.append(
            replace(_change(pairs[one.pair], one.change, one.covariance), p_value=one.p_value, p_adjusted=p, fixed=0.0)
        )
    culprits = Culprits(
        tuple(errors),
        tuple(tuple(pairs[i].name for i in one.alternatives) for one in found.culprits),
        tuple(_trend(pairs[one.pair], one.change, linear=axes[pairs[one.pair].axis].linear) for one in found.culprits),
        found.left_p_value,
        tuple(
            (pair.name, size, pair.unit)
            for pair, size in zip(pairs, found.shows_from, strict=True)
            if pair.kind == "number" and np.isfinite(size)
        ),
    )
    starts = np.concatenate([[0], np.cumsum([len(pair.change) for pair in pairs])])
    still = [
        float(np.abs(pair.shape @ white.fixed[start : start + len(pair.change)]).max(initial=0.0))
        for pair, start in zip(pairs, starts, strict=False)
    ]
    effects = {effect.name: effect for effect in second.effects}
    causes = {
        pairs[one.pair].name: _acting(pairs[one.pair], one.change, effects[pairs[one.pair].name])
        for one in found.culprits
    }
    return _Together(white.p_value, white.rank, culprits, tuple(still), causes)


def _acting(pair: Pair, change: np.ndarray, effect: Effect) -> Cause:
    """A change of one error as an effect: a curve as it is drawn, other numbers by their derivatives."""

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
    """One error's change, with its uncertainty where it is known."""
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
        fixed=0.0 if white is None else float(np.abs(pair.shape @ white.fixed).max(initial=0.0)),
        notes=pair.notes,
    )


def _trend(pair: Pair, change: np.ndarray, *, linear: bool) -> str:
    """How a change goes along its axis, if it is plain."""
    if pair.kind != "curve":
        return ""
    values, q = pair.shape @ change, pair.positions
    u = np.linspace(-1.0, 1.0, len(q))
    angle = np.deg2rad(q)
    ways = (
        (("constant", [np.ones_like(u)]), ("line", [np.ones_like(u), u]), ("bow", [np.ones_like(u), u, u**2]))
        if linear
        else (
            ("constant", [np.ones_like(u)]),
            ("turn", [np.ones_like(u), np.cos(angle), np.sin(angle)]),
        )
    )
    for name, functions in ways:
        columns = np.stack(functions, axis=1)
        left = values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
        if np.sum(left**2) <= (1.0 - MOSTLY) * np.sum(values**2):
            return name
    return ""


def _notices(first: Calibration, second: Calibration, pairs: Sequence[Pair], apart: Sequence[Apart]) -> list[str]:
    found = []
    drawn = [name for side in (first, second) for name, curve in side.curves.items() if curve.illustrative]
    if drawn:
        found.append(
            f"illustrative, drawn and not measured, in one or both: {', '.join(dict.fromkeys(drawn))}. No machine changed by this"
        )
    same = [pair.name for pair in pairs if pair.status == "same"]
    if same and len(same) < len(pairs) + len(apart):
        found.append(
            f"the very same numbers in both, taken as one estimate and not as two: {', '.join(same)}. If one file was made from the "
            "other, what else it has in common is taken as independent, and the uncertainty of its change is too large"
        )
    if any(pair.status == "known" for pair in pairs):
        found.append(
            "the two calibrations are taken as independent measurements, and as uncertain as they say: a misfit that `twin identify` "
            "complained of is in no covariance"
        )
    return found
