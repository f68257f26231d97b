"""Candidate: affine errors of an instrument, scales along its own axes and shears between them, at one station or in one round.

With one station and one round they are confounded with the machine's scales and squareness, and are not tested.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np

from twin.diagnosis.candidates.candidate import Candidate, CandidateInputs, CandidateSource, Catalogue, Variant
from twin.diagnosis.candidates.signatures import STRAINS, Column, SignatureTerm, strain_displacements
from twin.machine.effects.specification import NOTHING, REST, Advice, Specification
from twin.measurement.table import Measurements
from twin.numerics.functions import tabulated

NAMES: Final = (
    ("scale_x", "ppm"),
    ("scale_y", "ppm"),
    ("scale_z", "ppm"),
    ("shear_xy", "urad"),
    ("shear_xz", "urad"),
    ("shear_yz", "urad"),
)
"""Parameters, in the order of `STRAINS`: a positive scale reads too long, a shear is the change of a right angle."""
PLAUSIBLE: Final = 100.0
"""Largest plausible value, ppm and µrad."""
FLAT: Final = 0.01
"""Share of the largest extent below which the extent of the points along a direction counts as zero."""
MOST_ROUNDS: Final = 12
"""Number of rounds above which rounds are repeats or places rather than alignments of the instrument."""
MM: Final = 1e-3


AFFINE_SCALE: Final = Specification(
    name="affine_scale",
    kind="instrument",
    title=lambda where: f"scale and squareness errors of the instrument ({where})",
    family="scale and squareness errors of the instrument",
    advice=Advice(
        "Metrology: certificate and temperature compensation of the instrument in {where}; measure a calibrated length with it.",
        f"{REST} Better, measure again with a calibrated instrument.",
        NOTHING,
    ),
    evidence=lambda of: f"the instrument has scale and squareness errors in {of.where}, up to {of.measure}",
    limits={"ppm": 200.0},
    varies="with the frame",
    flexible=True,
)


class _Alignment(NamedTuple):
    """One alignment: its name, the mask of its readings, and whether the readings' centre is tried as the origin too."""

    where: str
    mask: np.ndarray
    centred: bool


def affine_scales(inputs: CandidateInputs) -> Catalogue:
    """Return one candidate for each station and for each round, where there are several."""
    return Catalogue(
        tuple(one for alignment in _alignments(inputs.data) if (one := _candidate(inputs.data, alignment)) is not None)
    )


def _alignments(data: Measurements) -> Iterator[_Alignment]:
    stations, rounds = (list(dict.fromkeys(names.tolist())) for names in (data.station, data.round))
    by_station = {f"station {name}": data.station == name for name in stations} if len(stations) > 1 else {}
    by_round = {f"round {name}": data.round == name for name in rounds} if 1 < len(rounds) <= MOST_ROUNDS else {}
    station_masks = {mask.tobytes() for mask in by_station.values()}
    yield from (_Alignment(where, mask, False) for where, mask in by_station.items())
    # A round that is exactly one station is not tested twice.
    yield from (
        _Alignment(where, mask, True) for where, mask in by_round.items() if mask.tobytes() not in station_masks
    )


def _candidate(data: Measurements, alignment: _Alignment) -> Candidate | None:
    """Return the candidate about the station's origin and, for a round, its centre; None if the points have no extent."""
    extended = _has_extent(np.asarray(data.point_mm)[alignment.mask])
    kept = [k for k, (i, j) in enumerate(STRAINS) if extended[i] and extended[j]]
    if not kept:
        return None
    variants = [Variant(_columns(alignment.mask, kept, np.zeros(3)))]
    if alignment.centred:
        # An instrument aligned anew in a round may have its origin anywhere: the centre of the readings is tried.
        centre = [np.nanmean(data.point_mm[alignment.mask, i]) if extended[i] else 0.0 for i in range(3)]
        variants.append(Variant(_columns(alignment.mask, kept, MM * np.array(centre))))
    names = tuple(NAMES[k] for k in kept)
    return Candidate(AFFINE_SCALE, alignment.where, names, tuple(variants), float(len(variants)))


def _has_extent(points: np.ndarray) -> np.ndarray:
    """Return for each direction (3,) whether the points (n, 3), mm, were measured along it and extend along it."""
    read = np.isfinite(points)
    low = np.min(np.where(read, points, np.inf), axis=0)
    high = np.max(np.where(read, points, -np.inf), axis=0)
    extent = np.where(np.any(read, axis=0), high - low, 0.0)
    return np.asarray((extent > 0.0) & (extent > FLAT * extent.max()))


def _columns(mask: np.ndarray, kept: list[int], centre: np.ndarray) -> tuple[Column, ...]:
    function = tabulated(mask[:, None].astype(float))
    at_centre = strain_displacements(centre[None])[0]
    return tuple(
        Column(
            (
                SignatureTerm(("strain", k), function, 0, 1e-6),
                *(
                    SignatureTerm(("station", i), function, 0, -1e-6 * float(at_centre[i, k]))
                    for i in range(3)
                    if at_centre[i, k] != 0.0
                ),
            ),
            PLAUSIBLE,
        )
        for k in kept
    )


SOURCE: Final = CandidateSource((AFFINE_SCALE,), affine_scales)
