"""Candidate: drift of a station during the measurement."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from twin._common.units import UM
from twin.diagnosis.candidates.candidate import STRAIGHT, Candidate, CandidateInputs, CandidateSource, Catalogue, Drift
from twin.diagnosis.candidates.signatures import LARGEST, Column, SignatureTerm
from twin.machine.effects.specification import NOTHING, REST, Advice, Drawing, Specification
from twin.machine.effects.thermal_drift import drift_course, drift_time_constants
from twin.numerics.functions import Functions, Rows

STATION_DRIFT: Final = Specification(
    name="station_drift",
    kind="instrument",
    title=lambda where: f"drift of the instrument at station {where}",
    family="drift of the instrument",
    advice=Advice(
        "Metrology: tripod, floor and warm-up of the instrument.",
        f"{REST} Better, measure again from a stable stand.",
        NOTHING,
    ),
    evidence=lambda of: f"station {of.where} drifts during the measurement{drift_course(of)}",
    nonlinear=("time_constant",),
    varies="with time",
    drawing=Drawing(columns=lambda where: ("time_s",), by_state=True, shared="station"),
)


def station_drifts(inputs: CandidateInputs) -> Catalogue:
    """Return a candidate for every station if the readings have times."""
    stations = list(dict.fromkeys(inputs.data.station))
    if "time_s" not in inputs.state:
        return Catalogue((), ((STATION_DRIFT.name, ", ".join(stations), "time_s"),))
    names = tuple((f"rate_{a}", "um/h") for a in "xyz")
    found = []
    for name in stations:
        drift = drift_of_station(inputs.state["time_s"], inputs.data.station == name)
        found.append(Candidate(STATION_DRIFT, name, names, drift.variants, 3.0, drift=drift))
    return Catalogue(tuple(found))


def drift_of_station(time_s: np.ndarray, mask: np.ndarray) -> Drift:
    """Return a drift of a station along the axes of the base; the parameters are its initial rates, µm/h.

    The functions of time are the same as for a drift of the machine, so that their shape never decides between the two.

    Args:
        time_s: (n,) times of all readings.
        mask: (n,) whether a reading was taken from the station.
    """
    hours = (time_s - time_s.min()) / 3600.0
    tried = drift_time_constants(time_s)

    def columns_at(several: Sequence[float]) -> list[tuple[Column, ...]]:
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
    known = dict(zip(every, columns_at(every), strict=True))
    return Drift(
        lambda constant: known[constant] if constant in known else columns_at([constant])[0], tried, straight=True
    )


SOURCE: Final = CandidateSource((STATION_DRIFT,), station_drifts)
