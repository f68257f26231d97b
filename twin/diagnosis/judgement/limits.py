"""The limits of the extended calibration, as it states them: errors that remain unknown, residuals, instruments and set-up.

The entries of the given calibration stay. The readings of the diagnosis add what they could not determine, and their residuals replace
the stated ones if they test the whole calibration, that is if every axis moved, or if they are worse.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final, Literal

import numpy as np

from twin.diagnosis.diagnosis import Diagnosis
from twin.diagnosis.problem.problem import rms
from twin.display.sentences import listed
from twin.identification.network import Network
from twin.identification.result import FEWEST_DOF
from twin.machine.calibration import Calibration
from twin.machine.calibration_file import MeasuredWith, MisfitEntry, UnidentifiedEntry
from twin.machine.effects import split_name
from twin.machine.unknown_errors import at_rest
from twin.measurement.table import CARRIERS

WORSE: Final = ("consistent", "untested", "larger", "systematic")
"""Verdicts on the residuals, the best first."""


def with_limits(found: Diagnosis, network: Network) -> Diagnosis:
    """Return the diagnosis with the limits of its extended calibration stated in the calibration.

    Args:
        found: the diagnosis.
        network: the readings and their instruments.
    """
    extended = found.extended
    given = {one.name for one in extended.not_identifiable}
    unknown = {name: why for name, why in _unknown(found) if name not in given}
    return replace(
        found,
        extended=replace(
            extended,
            instruments=tuple(dict.fromkeys((*extended.instruments, *(one.name for one in network.instruments.every)))),
            set_up=extended.set_up or _set_up(network),
            misfit=_misfit(found, network),
            not_identifiable=(
                *extended.not_identifiable,
                *(UnidentifiedEntry(name=name, why=why) for name, why in unknown.items()),
            ),
        ),
    )


def _unknown(found: Diagnosis) -> Iterator[tuple[str, str]]:
    """Yield the errors that the readings could not determine and the calibration does not know, with the reason."""
    machine = found.extended.machine
    every = (*machine.motion_names, *machine.squareness_names, *machine.location_names)
    known = {name.partition("[")[0] for name in found.extended.covariance.names}
    for cause in found.causes:
        for _, where in cause.equivalent:
            if where in every and where not in known:
                yield where, f"cannot be separated from {cause.effect} {cause.where}"
        if not cause.promised and cause.where in every and cause.where not in known:
            yield cause.where, "found in the readings, but not determined between the measured positions"
    if not _is_silent(found.calibration):
        return
    data, values = found.data, {effect.name for effect in found.extended.effects}
    for name in every:
        axis = split_name(name)[2]
        if name not in values and not np.ptp(data.positions[:, machine.names.index(axis)]) > 0.0:
            yield name, at_rest(axis)
    for key, why in found.looks_like.items():
        if key[1] in every and key[1] not in values:
            yield key[1], why


def _is_silent(calibration: Calibration) -> bool:
    """Return whether a calibration does not say how it was measured, so that an absent error may be unknown instead of negligible."""
    return calibration.set_up is None and not calibration.instruments


def _set_up(network: Network) -> MeasuredWith:
    data = network.data
    tool, work = (len(dict.fromkeys(data.target[data.carrier == side].tolist())) for side in CARRIERS)
    stations = len(dict.fromkeys(data.station.tolist()))
    return MeasuredWith(stations=stations, targets_on_tool=tool, targets_on_work=work, points=len(data))


def _misfit(found: Diagnosis, network: Network) -> MisfitEntry:
    """Return the residuals of the readings with the extended calibration, or the given ones if the readings cannot replace them."""
    verdict, says = _verdict(found)
    after = np.nan_to_num(found.after_um)
    chi2 = float(np.einsum("ni,nij,nj->", after, found.precision, after))
    held_out = None if found.gain is None else found.gain.held_out
    own = MisfitEntry(
        verdict=verdict,
        says=says,
        rms_um=rms(found.after_um, network.read),
        reduced_chi2=chi2 / found.dof if found.dof > 0 else None,
        dof=max(found.dof, 0),
        held_out_rms_um=None if held_out is None else held_out.after_um,
    )
    before = found.calibration.misfit
    whole = bool(np.all(np.ptp(found.data.positions, axis=0) > 0.0))
    if before is None or whole or WORSE.index(own.verdict) >= WORSE.index(before.verdict):
        return own
    return before


def _verdict(found: Diagnosis) -> tuple[Literal["consistent", "systematic", "larger", "untested"], str]:
    """Return whether the extended calibration fits the readings, and what it leaves, in words."""
    left, machine = found.unexplained, [cause for cause in found.causes if cause.origin == "machine"]
    absent = [f"{cause.effect} {cause.where}" for cause in machine if not cause.promised]
    unsure = [
        f"{cause.effect} {cause.where} cannot be separated from {listed([' '.join(key) for key in cause.equivalent])}"
        for cause in found.causes
        if cause.equivalent
    ]
    says = [f"{listed(absent)} found, but not in this calibration"] if absent else []
    written = left is not None and left.extension is not None and left.extension.written
    if left is not None:
        says.append(f"{left.evidence}{'; an empirical effect describes it' if written else ''}")
    text = "; ".join([*says, *unsure])
    if absent or (left is not None and left.depends_on and not written):
        return "systematic", text
    if left is not None and not written:
        return "larger", text
    return ("untested" if found.dof < FEWEST_DOF else "consistent"), text
