"""Which constant errors of a machine a measurement determines: scales, squareness and locations, before or after it is made.

The set-up (tips, spheres, stations) is unknown too. A combination of constant errors that only the set-up can compensate is lost,
whatever the number of readings: one sphere at an unknown place does not show the common scale of X, Y and Z, for example.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.counts import count_with_noun
from twin.identification.network import Network
from twin.identification.setup import SetUp
from twin.identification.unknowns import Unknowns
from twin.machine.machine import Machine
from twin.measurement.instruments import StationInstruments
from twin.measurement.table import Measurements
from twin.numerics.curves import POWER, CurveSpace

LOST_ALONE: Final = 0.98
"""Share of a constant error within the lost combinations above which it is lost itself."""
NEGLIGIBLE: Final = 0.02
"""Share below which a combination does not contain a constant error."""
EQUAL: Final = 0.05
"""Relative difference of slopes that count as a common scale."""


@final
@dataclass(frozen=True)
class ConstantErrors:
    """The constant errors of a machine's moved axes, and what a measurement tells about them.

    Attributes:
        u: standard uncertainty of each by name, µm/m of a scale, µm or µrad of the others; NaN where it is not determined.
        determined: number of independent combinations that are determined.
        lost: the other combinations, in words, one each.
    """

    u: Mapping[str, float]
    determined: int
    lost: tuple[str, ...]

    @property
    def text(self) -> str:
        """The result in one sentence."""
        known = f"{self.determined} of {count_with_noun(len(self.u), 'constant error')} (scales, squareness, locations) determined"
        return f"{known}; not: {'; '.join(self.lost)}" if self.lost else known


def constant_errors(
    machine: Machine,
    data: Measurements,
    instruments: StationInstruments,
    setup: SetUp,
    covariance: np.ndarray | None = None,
) -> ConstantErrors | None:
    """Return what a measurement determines of the constant errors of the axes that it moves, linearised at the nominal machine.

    Args:
        machine: the machine.
        data: the positions, targets and stations, and which coordinates are read.
        instruments: those of the stations.
        setup: stations and targets; those that are known are not among the unknowns.
        covariance: (n, 3, 3) of the readings, m²; that of the table and the instruments if None.

    Returns:
        The constant errors; None if no axis with any moves.
    """
    found = constant_rows(machine, data, instruments, setup, covariance)
    if found is None:
        return None
    unknowns, rows = found
    jacobian = rows.reshape(-1, rows.shape[-1])
    own, nuisance = jacobian[:, : len(unknowns)], jacobian[:, len(unknowns) :]
    scales, constants = unknowns.curves, list(unknowns.constants)
    # The prior of the set-up is so wide that it only regularises what the readings do not determine.
    prior = np.concatenate([np.eye(len(setup)), np.zeros((len(setup), own.shape[1]))], axis=1)
    whole = np.concatenate([np.concatenate([nuisance, own], axis=1), prior])
    triangle = np.asarray(np.linalg.qr(whole, mode="r"))[len(setup) :, len(setup) :]
    _, size, directions = np.linalg.svd(triangle)
    seen = size > 1.0
    variance = np.sum((directions[seen] / size[seen, None]) ** 2, axis=0)
    lost = directions[~seen]
    within = np.sum(lost**2, axis=0)
    per_unit = np.array([scale_unit(curve) for curve in scales] + [1.0] * len(constants))
    labels = [f"E_{curve.name[2:]}" for curve in scales] + constants
    u = np.where(within < NEGLIGIBLE, np.sqrt(variance) * unknowns.plausible * per_unit, np.nan)
    slopes = unknowns.plausible[: len(scales)] * per_unit[: len(scales)]
    return ConstantErrors(
        dict(zip(labels, (float(v) for v in u), strict=True)), int(np.sum(seen)), _lost(labels, lost, within, slopes)
    )


def constant_rows(
    machine: Machine,
    data: Measurements,
    instruments: StationInstruments,
    setup: SetUp,
    covariance: np.ndarray | None = None,
) -> tuple[Unknowns, np.ndarray] | None:
    """Return the constant errors of the moved axes, and the derivatives of each reading; arguments as of `constant_errors`.

    Returns:
        The unknowns of the machine, and (n, 3, unknowns + set-up) whitened derivatives per plausible size; None if no axis with any
        moves.
    """
    unknowns = constant_unknowns(
        machine, [a.name for a, q in zip(machine.axes, data.positions.T, strict=True) if np.ptp(q)]
    )
    if not len(unknowns):
        return None
    network = Network(machine, data, instruments, unknowns, covariance=covariance)
    rows = [chunk.jacobian for chunk in network.chunks(np.zeros(len(unknowns)), setup)]
    return unknowns, np.concatenate(rows) * np.concatenate([unknowns.plausible, setup.plausible])


def constant_unknowns(machine: Machine, axes: Collection[str]) -> Unknowns:
    """Return the constant errors of some axes, by name, as unknowns: scales, then squareness and locations."""
    scales = [
        CurveSpace(f"E_{'XYZ'[int(np.argmax(np.abs(axis.machine_direction)))]}{axis.name}", POWER, axis.domain, 1, 2)
        for axis in machine.axes
        if axis.linear and axis.name in axes
    ]
    constants = [name for name in (*machine.squareness_names, *machine.location_names) if name[4:] in axes]
    return Unknowns(machine, scales, constants)


def scale_unit(curve: CurveSpace) -> float:
    """Return the scale error, µm/m, of one µm RMS of the linear term of a positioning error."""
    lo, hi = curve.domain
    return float(np.diff(curve.functions(np.array([lo, hi]))[:, 1])[0]) / (hi - lo) * 1e3


def _lost(names: list[str], lost: np.ndarray, within: np.ndarray, slopes: np.ndarray) -> tuple[str, ...]:
    """Return the lost combinations in words, from an orthonormal basis (k, p) of them in plausible units."""
    alone = [i for i in range(len(names)) if within[i] > LOST_ALONE]
    found = [names[i] for i in alone]
    rest = np.delete(lost, alone, axis=1)
    others = [name for i, name in enumerate(names) if i not in alone]
    count = len(lost) - len(alone)
    if count <= 0:
        return tuple(found)
    _, _, basis = np.linalg.svd(rest, full_matrices=False)
    shares = np.sum(basis[:count] ** 2, axis=0)
    included = [i for i, share in enumerate(shares) if share > NEGLIGIBLE]
    scales = [names.index(others[i]) for i in included]
    if count == 1 and len(scales) > 1 and max(scales) < len(slopes):
        value = basis[0][np.array(included)] * slopes[np.array(scales)]
        if np.ptp(value) < EQUAL * np.abs(value).max():
            return (f"the common scale of {' and '.join(names[i][-1] for i in scales)}", *found)
    listed = ", ".join(others[i] for i in included)
    return (f"{count_with_noun(count, 'combination')} of {listed}", *found)
