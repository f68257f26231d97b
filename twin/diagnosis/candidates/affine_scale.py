"""Affine errors of an instrument: scales along its own axes and shears between them, at one station or in one round.

With one station and one round the machine's scales and squareness do the same, so nothing is tried then.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np

from twin.diagnosis.candidates.candidate import Candidate, CandidateSource, Catalogue, Cell, CandidateInputs
from twin.diagnosis.candidates.signatures import STRAINS, Column, SignatureTerm, strain_displacements
from twin.machine.effects.specification import NOTHING, REST, Advice, Specification
from twin.measurement.table import Measurements
from twin.numerics.functions import given

NAMES: Final = (
    ("scale_x", "ppm"),
    ("scale_y", "ppm"),
    ("scale_z", "ppm"),
    ("shear_xy", "urad"),
    ("shear_xz", "urad"),
    ("shear_yz", "urad"),
)
"""Parameters, in the order of `STRAINS`: a scale is read too long, a shear is the change of a right angle."""
PLAUSIBLE: Final = 100.0
"""ppm and µrad."""
FLAT: Final = 0.01
"""Share of the largest extent below which the points have no extent along a direction."""
MOST: Final = 12
"""Rounds beyond which they are repeats or places, not alignments of an instrument."""
MM: Final = 1e-3


AFFINE_SCALE: Final = Specification(
    name="affine_scale",
    kind="instrument",
    title=lambda where: f"scales and right angles of the instrument off ({where})",
    family="scales and right angles of the instrument",
    advice=Advice(
        "Who measured: certificate and temperature compensation of the instrument in {where}; measure a calibrated length with it.",
        f"{REST} Better, measure again with an instrument that was checked.",
        NOTHING,
    ),
    evidence=lambda of: f"the instrument's own scales and right angles are off in {of.where}, by up to {of.measure}",
    largest={"ppm": 200.0},
    varies="with the frame",
    pliable=True,
)


class _Part(NamedTuple):
    """Readings of one alignment: its name, which they are, and whether it may be affine about their middle as well."""

    where: str
    mask: np.ndarray
    anew: bool


def affine_scales(inputs: CandidateInputs) -> Catalogue:
    """Every station if there are several, every round if there are several."""
    return Catalogue(tuple(one for part in _parts(inputs.data) if (one := _candidate(inputs.data, part)) is not None))


def _parts(data: Measurements) -> Iterator[_Part]:
    stations, rounds = (list(dict.fromkeys(names.tolist())) for names in (data.station, data.round))
    by_station = {f"station {name}": data.station == name for name in stations} if len(stations) > 1 else {}
    by_round = {f"round {name}": data.round == name for name in rounds} if 1 < len(rounds) <= MOST else {}
    alone = {mask.tobytes() for mask in by_station.values()}
    yield from (_Part(where, mask, False) for where, mask in by_station.items())
    # A station of its own is not said twice.
    yield from (_Part(where, mask, True) for where, mask in by_round.items() if mask.tobytes() not in alone)


def _candidate(data: Measurements, part: _Part) -> Candidate | None:
    """About the station's origin, and in a round about the middle of what is read as well; None if the points have no extent."""
    seen = _extended(np.asarray(data.point_mm)[part.mask])
    kept = [k for k, (i, j) in enumerate(STRAINS) if seen[i] and seen[j]]
    if not kept:
        return None
    variants = [Cell(_columns(part.mask, kept, np.zeros(3)))]
    if part.anew:
        # An instrument is aligned anew with a round: its origin is where the readings are.
        middle = [np.nanmean(data.point_mm[part.mask, i]) if seen[i] else 0.0 for i in range(3)]
        variants.append(Cell(_columns(part.mask, kept, MM * np.array(middle))))
    names = tuple(NAMES[k] for k in kept)
    return Candidate(AFFINE_SCALE, part.where, names, tuple(variants), float(len(variants)))


def _extended(points: np.ndarray) -> np.ndarray:
    """(3,) whether points (n, 3), mm, were read along a direction and have an extent there."""
    read = np.isfinite(points)
    low = np.min(np.where(read, points, np.inf), axis=0)
    high = np.max(np.where(read, points, -np.inf), axis=0)
    extent = np.where(np.any(read, axis=0), high - low, 0.0)
    return np.asarray((extent > 0.0) & (extent > FLAT * extent.max()))


def _columns(mask: np.ndarray, kept: list[int], middle: np.ndarray) -> tuple[Column, ...]:
    function = given(mask[:, None].astype(float))
    back = strain_displacements(middle[None])[0]
    return tuple(
        Column(
            (
                SignatureTerm(("strain", k), function, 0, 1e-6),
                *(
                    SignatureTerm(("station", i), function, 0, -1e-6 * float(back[i, k]))
                    for i in range(3)
                    if back[i, k] != 0.0
                ),
            ),
            PLAUSIBLE,
        )
        for k in kept
    )


SOURCE: Final = CandidateSource((AFFINE_SCALE,), affine_scales)
