"""A station that creeps while it measures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from twin._common.units import UM
from twin.diagnosis.candidates.candidate import STRAIGHT, Candidate, CandidateSource, Catalogue, Drift, CandidateInputs
from twin.diagnosis.candidates.signatures import LARGEST, Column, SignatureTerm
from twin.machine.effects.specification import NOTHING, REST, Advice, Drawing, Specification
from twin.machine.effects.thermal_drift import constants, course
from twin.numerics.functions import Functions, Rows

STATION_DRIFT: Final = Specification(
    name="station_drift",
    kind="instrument",
    title=lambda where: f"instrument at station {where} creeps",
    family="creep of the instrument",
    advice=Advice(
        "Who measured: tripod, floor, and whether the instrument was warm.",
        f"{REST} Better, measure again from a steady stand.",
        NOTHING,
    ),
    evidence=lambda of: f"station {of.where} creeps while it measures{course(of)}",
    bent=("time_constant",),
    varies="with time",
    drawn=Drawing(columns=lambda where: ("time_s",), by_state=True, shared="station"),
)


def station_drifts(inputs: CandidateInputs) -> Catalogue:
    """Every station, where the readings have times."""
    stations = list(dict.fromkeys(inputs.data.station))
    if "time_s" not in inputs.state:
        return Catalogue((), ((STATION_DRIFT.name, ", ".join(stations), "time_s"),))
    names = tuple((f"rate_{a}", "um/h") for a in "xyz")
    found = []
    for name in stations:
        drift = of_station(inputs.state["time_s"], inputs.data.station == name)
        found.append(Candidate(STATION_DRIFT, name, names, drift.variants, 3.0, drift=drift))
    return Catalogue(tuple(found))


def of_station(time_s: np.ndarray, mask: np.ndarray) -> Drift:
    """A drift of a station along the axes of the base; a parameter is its rate at the beginning of the record, µm/h.

    The same functions of time as a drift of the machine has, so that the shape never decides between them.

    Args:
        time_s: (n,) of all readings.
        mask: (n,) whether a reading is the station's.
    """
    hours = (time_s - time_s.min()) / 3600.0
    tried = constants(time_s)

    def of(several: Sequence[float]) -> list[tuple[Column, ...]]:
        tau = np.array(several) / 3600.0

        def values(rows: Rows) -> np.ndarray:
            at = np.where(mask[rows], hours[rows], 0.0)[:, None]
            bent = np.where(np.isinf(tau), 1.0, tau)
            return np.where(np.isinf(tau), at, -bent * np.expm1(-at / bent))

        functions = Functions(len(hours), len(several), values, mask)
        scale = LARGEST / np.maximum(functions.largest, 1e-9)
        return [
            tuple(Column((SignatureTerm(("base", i), functions, k, -UM),), float(scale[k])) for i in range(3))
            for k in range(len(several))
        ]

    every = (STRAIGHT, *tried)
    known = dict(zip(every, of(every), strict=True))
    return Drift(lambda constant: known[constant] if constant in known else of([constant])[0], tried, straight=True)


SOURCE: Final = CandidateSource((STATION_DRIFT,), station_drifts)
