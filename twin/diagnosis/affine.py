"""Affine errors of an instrument: scales along its own axes and shears between them, at one station or in one round.

With one station and one round the machine's scales and squareness do the same, so nothing is tried then.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin.diagnosis.functions import given
from twin.diagnosis.signatures import STRAINS, Column, Part, strained
from twin.measurement.table import Measurements

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


@final
@dataclass(frozen=True)
class Affine:
    """Where an instrument may be affine, and what that does.

    Attributes:
        where: ``station B`` or ``round 2``.
        names: (name, unit) of the parameters that the data hold something of.
        forms: their columns: about the station's origin, and in a round about the middle of what is read as well.
    """

    where: str
    names: tuple[tuple[str, str], ...]
    forms: tuple[tuple[Column, ...], ...]


def affine_errors(data: Measurements) -> Iterator[Affine]:
    """Every station if there are several, every round if there are several."""
    stations, rounds = (list(dict.fromkeys(names.tolist())) for names in (data.station, data.round))
    by_station = {f"station {name}": data.station == name for name in stations} if len(stations) > 1 else {}
    by_round = {f"round {name}": data.round == name for name in rounds} if 1 < len(rounds) <= MOST else {}
    alone = {mask.tobytes() for mask in by_station.values()}
    for where, mask in (by_station | by_round).items():
        if where in by_round and mask.tobytes() in alone:
            continue  # a station of its own
        seen = _extended(np.asarray(data.point_mm)[mask])
        kept = [k for k, (i, j) in enumerate(STRAINS) if seen[i] and seen[j]]
        if not kept:
            continue
        forms = [_columns(mask, kept, np.zeros(3))]
        if where in by_round:
            # An instrument is aligned anew with a round: its origin is where the readings are.
            middle = [np.nanmean(data.point_mm[mask, i]) if seen[i] else 0.0 for i in range(3)]
            forms.append(_columns(mask, kept, MM * np.array(middle)))
        yield Affine(where, tuple(NAMES[k] for k in kept), tuple(forms))


def _extended(points: np.ndarray) -> np.ndarray:
    """(3,) whether points (n, 3), mm, were read along a direction and have an extent there."""
    read = np.isfinite(points)
    low = np.min(np.where(read, points, np.inf), axis=0)
    high = np.max(np.where(read, points, -np.inf), axis=0)
    extent = np.where(np.any(read, axis=0), high - low, 0.0)
    return np.asarray((extent > 0.0) & (extent > FLAT * extent.max()))


def _columns(mask: np.ndarray, kept: list[int], middle: np.ndarray) -> tuple[Column, ...]:
    function = given(mask[:, None].astype(float))
    back = strained(middle[None])[0]
    return tuple(
        Column(
            (
                Part(("strain", k), function, 0, 1e-6),
                *(Part(("station", i), function, 0, -1e-6 * float(back[i, k])) for i in range(3) if back[i, k] != 0.0),
            ),
            PLAUSIBLE,
        )
        for k in kept
    )
