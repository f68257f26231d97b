"""Candidate causes in an instrument: scales, bent beams, linearity, lobing, refraction, drift, delay, displaced frames and targets.

With one station and one round, scales are confounded with the machine's scales and squareness, and are not tested.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from twin._common.messages import Message
from twin._common.units import MM, UM
from twin.diagnosis.candidates.candidate import (
    LARGEST_ERROR,
    STRAIGHT_LINE,
    STRAINS,
    Candidate,
    CandidateInputs,
    Catalogue,
    Column,
    Drift,
    Freedom,
    SignatureTerm,
    Variant,
    along_command,
    masked_columns,
    strain_displacements,
    tabulated_column,
)
from twin.machine.machine import Machine
from twin.measurement.observation import at_origin, has_times, order_in_time
from twin.measurement.table import Measurements
from twin.model.effects.specification import NOTHING, REST, Advice, Drawing, FittedCause, Specification
from twin.model.effects.thermal_drift import drift_course, drift_time_constants
from twin.numerics.functions import Functions, Rows, tabulated

NAMES: Final = (
    *((f"scale_{a}", "ppm") for a in ("x", "y", "z")),
    *((f"shear_{plane}", "urad") for plane in ("xy", "xz", "yz")),
)
"""Parameters, in the order of `STRAINS`: a positive scale reads too long, a shear is the change of a right angle."""
AFFINE_SCALE_PLAUSIBLE: Final = 100.0  # largest plausible value, ppm and µrad
FLAT_EXTENT: Final = 0.01  # share of the largest extent of the points below which that along a direction is zero
MOST_ROUNDS: Final = 12  # number of rounds above which these are repeats or places, not alignments of the instrument
CALIBRATED_LENGTH: Final = (
    "measure a calibrated length on the table (gauge block, scale bar) with the same instrument, and read the "
    "machine's temperature: "
    "a machine that is warmer than the length has equal scales of its axes"
)


AFFINE_SCALE: Final = Specification(
    name="affine_scale",
    kind="instrument",
    title=lambda where: Message("scale and squareness errors of the instrument ({where})", where=where),
    family="scale and squareness errors of the instrument",
    advice=Advice(
        "Metrology: certificate and temperature compensation of the instrument in {where}; measure a calibrated "
        "length with it.",
        f"{REST} Better, measure again with a calibrated instrument.",
        NOTHING,
    ),
    evidence=lambda of: Message(
        "the instrument has scale and squareness errors in {where}, up to {measure}", where=of.where, measure=of.measure
    ),
    limits={"ppm": 200.0},
    varies="with the frame",
    flexible=True,
    decided_by=CALIBRATED_LENGTH,
)


def affine_scales(inputs: CandidateInputs) -> Catalogue:
    """Return one candidate for each station and for each round, where there are several and their points have an extent.

    A single station has one if a rotary axis moved: it turns the targets in the instrument's frame, which scale and squareness of the
    machine do not.
    """
    data = inputs.data
    stations, rounds = (list(dict.fromkeys(names.tolist())) for names in (data.station, data.round))
    several = len(stations) > 1 or _turned(inputs)
    by_station = {f"station {name}": data.station == name for name in stations} if several else {}
    by_round = {f"round {name}": data.round == name for name in rounds} if 1 < len(rounds) <= MOST_ROUNDS else {}
    # A round that is exactly one station is not tested twice.
    station_masks = {mask.tobytes() for mask in by_station.values()}
    by_round = {where: mask for where, mask in by_round.items() if mask.tobytes() not in station_masks}
    candidates = [_affine_scale(data, where, mask, realigned=False) for where, mask in by_station.items()]
    candidates += [_affine_scale(data, where, mask, realigned=True) for where, mask in by_round.items()]
    return Catalogue(tuple(candidate for candidate in candidates if candidate is not None))


def _turned(inputs: CandidateInputs) -> bool:
    """Return whether a rotary axis moved."""
    moved = inputs.data.moved(inputs.machine)
    return any(not axis.linear and axis.name in moved for axis in inputs.machine.axes)


def _affine_scale(data: Measurements, where: str, mask: np.ndarray, *, realigned: bool) -> Candidate | None:
    """Return the candidate about the station's origin and, if it was realigned, the points' centre; None if they have no extent."""
    extended = _has_extent(np.asarray(data.point_mm)[mask])
    kept = [k for k, (i, j) in enumerate(STRAINS) if extended[i] and extended[j]]
    if not kept:
        return None
    variants = [Variant(_columns(mask, kept, np.zeros(3)))]
    if realigned:
        # An instrument aligned anew in a round may have its origin anywhere: the centre of the readings is tried.
        centre = [np.nanmean(data.point_mm[mask, i]) if extended[i] else 0.0 for i in range(3)]
        variants.append(Variant(_columns(mask, kept, MM * np.array(centre))))
    names = tuple(NAMES[k] for k in kept)
    return Candidate(AFFINE_SCALE, where, names, tuple(variants), float(len(variants)))


def _has_extent(points: np.ndarray) -> np.ndarray:
    """Return for each direction (3,) whether the points (n, 3), mm, were measured along it and extend along it."""
    read = np.isfinite(points)
    low = np.min(np.where(read, points, np.inf), axis=0)
    high = np.max(np.where(read, points, -np.inf), axis=0)
    extent = np.where(np.any(read, axis=0), high - low, 0.0)
    return np.asarray((extent > 0.0) & (extent > FLAT_EXTENT * extent.max()))


def _columns(mask: np.ndarray, kept: list[int], centre: np.ndarray) -> tuple[Column, ...]:
    function = tabulated(mask[:, None])
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
            AFFINE_SCALE_PLAUSIBLE,
        )
        for k in kept
    )


BEND: Final[tuple[Freedom, ...]] = tuple(("bend", i) for i in range(3))
LARGEST_BEND: Final = 10.0  # µm/m²: a gradient of the air's temperature of 20 K/m bends a beam so

BEAM_BENDING: Final = Specification(
    name="beam_bending",
    kind="instrument",
    title=lambda where: Message("beam of the instrument at station {where} not straight", where=where),
    family="bent beam",
    advice=Advice(
        "Metrology: warm or cold air along the beam, from the machine or a door; the instrument's supports.",
        f"{REST} Better, measure again from nearer, or from the other side.",
        NOTHING,
    ),
    evidence=lambda of: Message(
        "readings from station {where} are off with the square of their distance, by {measure}",
        where=of.where,
        measure=of.measure,
    ),
    limits={"um/m2": LARGEST_BEND},
    varies="with the frame",
    decided_by="measure the same points from a station on another side, or from half the distance, where it is off by a quarter",
)


def beam_bendings(inputs: CandidateInputs) -> Catalogue:
    """Return a candidate for every station at rest in the base that reads points, if a rotary axis moved, as for `affine_scales`."""
    data, candidates = inputs.data, []
    for name in dict.fromkeys(data.station.tolist()) if _turned(inputs) else ():
        own = data.station == name
        if np.all(data.station_carrier[own] == "base") and np.all(np.isfinite(data.point_mm[own])):
            names = tuple((f"bend_{a}", "um/m2") for a in "xyz")
            candidates.append(
                Candidate(BEAM_BENDING, str(name), names, (Variant(masked_columns(BEND, own, UM, LARGEST_BEND)),), 1.0)
            )
    return Catalogue(tuple(candidates))


LARGEST_SENSOR_RANGE_MM: Final = 100.0
"""mm: longer runs are read by a laser interferometer, which has no such error (data sheets of triangulation and inductive sensors)."""
LARGEST_LINEARITY_UM: Final = 1000.0  # 1 % of that range
FEWEST_POSITIONS_READ: Final = 12  # a polynomial through fewer positions does not predict those that were left out
MOST_DEGREES: Final = 8  # as for a positioning error: which of the two it is must not depend on the form

SENSOR_LINEARITY: Final = Specification(
    name="sensor_linearity",
    kind="instrument",
    title=lambda where: Message("linearity of the sensor"),
    family="linearity of a sensor",
    advice=Advice(
        "Metrology: certificate of the sensor, its range, the surface that it reads, and the angle at which it is "
        "set up.",
        f"{REST} Better, measure again with a calibrated sensor.",
        NOTHING,
    ),
    evidence=lambda of: Message(
        "the sensor is off by up to {measure} within the range that was read", measure=of.measure
    ),
    limits={"um": LARGEST_LINEARITY_UM},
    varies="with the frame",
    decided_by="shift the sensor by a quarter of the range that it read and measure the same positions again: an error of the sensor "
    "shifts with it, one of the machine stays; or measure with a calibrated instrument",
)


def sensor_linearities(inputs: CandidateInputs) -> Catalogue:
    """Return a candidate for the stations whose instrument is not named and that read one coordinate over a short range.

    They are one sensor at several places, moved by linear axes. Its error is a polynomial of the reading.
    """
    data = inputs.data
    read = np.isfinite(data.point_mm)
    own = (read.sum(axis=1) == 1) & (data.instrument == "")
    across = read[own].any(axis=0)
    positions = np.unique(np.round(data.positions[own], 3), axis=0)
    degrees = min(MOST_DEGREES, len(positions) - 1)
    if np.count_nonzero(across) != 1 or len(positions) < FEWEST_POSITIONS_READ or _turned(inputs):
        return Catalogue(())
    reading = _smoothed(data, own, data.point_mm[own, int(np.argmax(across))])
    low, high = float(reading.min()), float(reading.max())
    if not 0.0 < high - low <= LARGEST_SENSOR_RANGE_MM:
        return Catalogue(())
    polynomials = np.zeros((len(data), degrees + 1))
    polynomials[own] = np.polynomial.legendre.legvander((2.0 * reading - low - high) / (high - low), degrees)
    functions, along = tabulated(polynomials), ("station", int(np.argmax(across)))
    columns = tuple(
        Column((SignatureTerm(along, functions, k, UM),), LARGEST_LINEARITY_UM) for k in range(1, degrees + 1)
    )
    variants = tuple(Variant(columns[:degree]) for degree in range(1, degrees + 1))
    names = (("largest", "um"),)
    candidate = Candidate(SENSOR_LINEARITY, "—", names, variants, float(degrees), reported=_largest_deviation)
    return Catalogue((candidate,))


def _smoothed(data: Measurements, own: np.ndarray, reading: np.ndarray) -> np.ndarray:
    """Return the readings of a sensor as they follow the positions of the axes, without noise: a polynomial of noise fits itself."""
    setups = [f"{station} {target}" for station, target in zip(data.station[own], data.target[own], strict=True)]
    names = sorted(set(setups))
    of_setup = np.array(setups)[:, None] == np.array(names)
    columns = np.concatenate([data.positions[own], of_setup], axis=1)
    return np.asarray(columns @ np.linalg.lstsq(columns, reading, rcond=None)[0])


def _largest_deviation(values: np.ndarray) -> np.ndarray:
    """Return (1,) the largest deviation within the range, of Legendre coefficients from degree 1 on."""
    deviation = np.polynomial.legendre.legval(np.linspace(-1.0, 1.0, 201), np.concatenate([[0.0], values]))
    return np.array([np.abs(deviation).max()])


ASSUMED_OF_INSTRUMENT: Final = Message(
    "assumes that the instrument reads to scale, at right angles and along straight beams: such an error of its own "
    "would fit as "
    "well: a calibrated length on the table, or the same points from a station on another side, would show it"
)


def assumed_zero(data: Measurements) -> tuple[Column, ...]:
    """Return the errors that every instrument of a table is assumed not to have, the same at all its stations and in all rounds.

    A strain of its frame, and a beam that sags or is bent by a gradient of the air.
    """
    every = np.ones(len(data), dtype=bool)
    return (*_columns(every, list(range(len(STRAINS))), np.zeros(3)), *masked_columns(BEND, every, UM, LARGEST_BEND))


LOBES: Final = 3  # number of supports of a kinematic probe
UPRIGHT_COSINE: Final = 0.9  # cosine between axis and z of the base from which a rotary axis turns the probe
LARGEST_LOBING_UM: Final = 10.0  # largest plausible amplitude, µm

PROBE_LOBING: Final = Specification(
    name="probe_lobing",
    kind="instrument",
    title=lambda where: Message("lobing of {where}", where=where),
    family="lobing of a touch probe",
    advice=Advice(
        "Metrology: calibrate the probe in the directions and orientations in which it measures, or orient it in the "
        "direction of "
        "each contact.",
        f"{REST} Better, measure again with a calibrated probe.",
        NOTHING,
    ),
    evidence=lambda of: Message(
        "the centres move with three times the rotation of {where}, by {measure}", where=of.where, measure=of.measure
    ),
    limits={"um": LARGEST_LOBING_UM},
)


def probe_lobings(inputs: CandidateInputs) -> Catalogue:
    """Return a candidate for each probe that a rotary axis of the tool side turned about its stylus."""
    data, candidates = inputs.data, []
    probed = at_origin(data) & (data.station_carrier == "tool")
    for i, axis in enumerate(inputs.machine.axes):
        upright = float(axis.machine_direction[2])
        turned = not axis.linear and axis.side == "tool" and np.ptp(data.positions[:, i]) > 0.0
        if not turned or abs(upright) < UPRIGHT_COSINE:
            continue
        angle = LOBES * np.sign(upright) * np.radians(data.positions[:, i])
        for station in dict.fromkeys(data.station[probed]):
            own = (probed & (data.station == station)).astype(float)
            # Orthogonal parts of the amplitude: A·cos ψ and A·sin ψ.
            parts = ((np.cos(angle), -np.sin(angle)), (-np.sin(angle), -np.cos(angle)))
            terms = [
                tuple(
                    SignatureTerm(("base", k), tabulated((own * part)[:, None]), 0, UM) for k, part in enumerate(both)
                )
                for both in parts
            ]
            columns = tuple(Column(own_terms, LARGEST_LOBING_UM) for own_terms in terms)
            names = (("cos", "um"), ("sin", "um"))
            candidates.append(Candidate(PROBE_LOBING, f"probe {station}", names, (Variant(columns),), 1.0))
        break
    return Catalogue(tuple(candidates))


PPM: Final = 1e-6
LARGEST_PPM: Final = 20.0  # corresponds to air 20 K away from the temperature set on the instrument
REFRACTION_SCALE_PLAUSIBLE: Final = 100.0  # ppm: scale of the column

REFRACTION_SCALE: Final = Specification(
    name="refraction_scale",
    kind="instrument",
    title=lambda where: Message("all lengths read too long or too short"),
    family="scale of all lengths",
    advice=Advice(
        "Metrology: air temperature, pressure and humidity at the instrument, and its certificate.", REST, NOTHING
    ),
    evidence=lambda of: Message("all lengths are read {measure} too long", measure=of.measure),
    limits={"ppm": LARGEST_PPM},
    varies="with the frame",
    decided_by=CALIBRATED_LENGTH,
    drawing=Drawing(size_of="distance", by_state=True),
)


def refraction_scale(inputs: CandidateInputs) -> Catalogue:
    """Return one candidate for all readings."""
    columns = masked_columns([("length", 0)], np.ones(len(inputs.data)), PPM, REFRACTION_SCALE_PLAUSIBLE)
    return Catalogue((Candidate(REFRACTION_SCALE, "—", (("scale", "ppm"),), (Variant(columns),), 1.0),))


STATION_DRIFT: Final = Specification(
    name="station_drift",
    kind="instrument",
    title=lambda where: Message("drift of the instrument at station {where}", where=where),
    family="drift of the instrument",
    advice=Advice(
        "Metrology: tripod, floor and warm-up of the instrument.",
        f"{REST} Better, measure again from a stable stand.",
        NOTHING,
    ),
    evidence=lambda of: Message(
        "station {where} drifts during the measurement{course}", where=of.where, course=drift_course(of)
    ),
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
    candidates = []
    for name in stations:
        drift = drift_of_station(inputs.state["time_s"], inputs.data.station == name)
        candidates.append(Candidate(STATION_DRIFT, name, names, drift.variants, 3.0, drift=drift))
    return Catalogue(tuple(candidates))


def drift_of_station(time_s: np.ndarray, mask: np.ndarray) -> Drift:
    """Return a drift of a station along the axes of the base, where a mask (n,) is set; the parameters are its initial rates, µm/h.

    The functions of time are the same as for a drift of the machine, so that their shape never decides between the two.
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
        scale = LARGEST_ERROR / np.maximum(functions.largest, 1e-9)
        return [
            tuple(Column((SignatureTerm(("base", i), functions, k, -UM),), float(scale[k])) for i in range(3))
            for k in range(len(several))
        ]

    every = (STRAIGHT_LINE, *tried)
    known = dict(zip(every, columns_at(every), strict=True))
    return Drift(
        lambda constant: known[constant] if constant in known else columns_at([constant])[0],
        tried,
        straight=True,
        name=STATION_DRIFT.nonlinear[0],
    )


IN_MOTION: Final = 1.0  # s: rows at shorter intervals, while an axis moves, count as sampled in motion

TIME_SKEW: Final = Specification(
    name="time_skew",
    kind="instrument",
    title=lambda where: Message("readings and positions of {where} not taken at the same moment", where=where),
    family="delay between readings and positions",
    advice=Advice(
        "Metrology: synchronisation of readings and positions of {axis}: trigger, filter, delay of the instrument.",
        f"{REST} Better, measure again at standstill, or at half the feed.",
        NOTHING,
    ),
    evidence=lambda of: Message(
        "readings and positions of {where} were taken {size:.3g} {unit} apart while it moved",
        where=of.where,
        size=abs(of.size),
        unit=of.unit,
    ),
    limits={"s": 1.0},
)


def velocities(data: Measurements, machine: Machine) -> Mapping[str, np.ndarray]:
    """Return the velocity (n,) in mm/s or °/s of each axis that moved while it was measured; other axes are left out.

    The feed is the speed along the path of the linear axes. Its direction is the mean of those from the previous row and to the next
    one of the round, which is the tangent of a circle read at equal steps; from the previous row alone it would lag by half a step. A
    row where nothing moved has the direction of the one before. The direction of approach, where given, sets the sign.
    """
    timed, order = has_times(data), order_in_time(data)
    q = data.positions[order]
    step = np.diff(q, axis=0, prepend=q[:1])
    interval = np.diff(data.time_s[order], prepend=data.time_s[order][:1]) if timed else np.full(len(q), np.inf)
    moved = np.any(step != 0.0, axis=1)
    in_motion = moved & (interval > 0.0) & (interval < IN_MOTION)
    last = np.maximum.accumulate(np.where(moved, np.arange(len(q)), int(np.argmax(moved))))
    linear = [axis.linear for axis in machine.axes]
    direction = _tangent(step[last], np.linalg.norm(step[last][:, linear], axis=1), data.round[order])
    path = np.linalg.norm(direction[:, linear], axis=1)
    feed = np.nan_to_num(data.feed_mm_min[order]) / 60.0
    along = np.where(path > 0.0, feed / np.where(path > 0.0, path, 1.0), 0.0)
    found = direction * along[:, None]
    found = np.where(in_motion[:, None], step / np.where(in_motion, interval, 1.0)[:, None], found)
    side = data.approach[order]
    found = np.where(side != 0.0, np.abs(found) * side, found)
    velocity = np.empty_like(found)
    velocity[order] = found
    return {axis.name: velocity[:, i] for i, axis in enumerate(machine.axes) if np.any(velocity[:, i] != 0.0)}


def _tangent(step: np.ndarray, length: np.ndarray, rounds: np.ndarray) -> np.ndarray:
    """Return (n, axes) directions at the rows from the steps that lead to them.

    The mean of the steps before and after a row, where both are of one round and not opposite; at the ends of a round the direction is
    extrapolated. A row between opposite steps, or of a short round, has the direction of the step before it.
    """
    unit = step / np.where(length > 0.0, length, 1.0)[:, None]
    tangent = unit.copy()
    ends = np.flatnonzero(np.append(True, rounds[1:] != rounds[:-1]))
    for first, end in zip(ends, [*ends[1:], len(unit)], strict=True):
        own = unit[first + 1 : end]  # the step to the first row is of another round
        if len(own) < 2:
            continue
        ends_on = [2.0 * own[i] - own[j] if own[i] @ own[j] > 0.0 else own[i] for i, j in ((0, 1), (-1, -2))]
        before, after = np.concatenate([[ends_on[0]], own]), np.concatenate([own, [ends_on[1]]])
        smooth = np.einsum("ni,ni->n", before, after) > 0.0
        tangent[first] = after[0]
        tangent[first:end][smooth] = (before + after)[smooth]
    return tangent


def time_skews(inputs: CandidateInputs) -> Catalogue:
    """Return a candidate for every axis that moved: the readings are displaced by velocity times delay."""
    machine, moving = inputs.machine, velocities(inputs.data, inputs.machine)
    candidates, missing = [], []
    for axis in machine.axes:
        if axis.name in moving:
            displacement = moving[axis.name] * axis.scale / UM
            column = tabulated_column({i: displacement * part for i, part in along_command(machine, axis)})
            candidates.append(Candidate(TIME_SKEW, axis.name, (("delay", "s"),), (Variant((column,)),), 1.0))
        elif not np.any(np.isfinite(inputs.data.feed_mm_min)):
            missing.append((TIME_SKEW.name, axis.name, "feed_mm_min"))
    return Catalogue(tuple(candidates), tuple(missing))


FRAME: Final[tuple[Freedom, ...]] = tuple((name, i) for name in ("station", "station turn") for i in range(3))
FEWEST_READINGS: Final = 2  # of a target before and after it was displaced; a single one is an outlier
MOST_LINES: Final = 32  # lines of one round, evenly spaced, from which on something is tried as displaced
AT_ONCE: Final = 0.05
"""Share of the readings within which targets count as displaced at one time: the line is uncertain, and a target is not always read."""
PLACE: Final[tuple[Freedom, ...]] = tuple(("place", i) for i in range(3))
SHIFTS: Final = tuple((f"shift_{a}", "um") for a in "xyz")
TURNS: Final = tuple((f"turn_{a}", "urad") for a in "xyz")


ONE_ROUND: Final = " only"  # end of the place of an alignment of one round: ``round 2 only``
FRAME_ALONE: Final = "frame"  # event of the frame where there is one station
WITHIN: Final = "within round "
"""Beginning of the place of a change in the middle of a round; the line from which on is its parameter ``line``."""


def _frame_shift_title(where: str) -> str:
    station, _, number = where.rpartition("round ")
    station = station.removesuffix("within ").strip()
    at = Message(" at {station}", station=station.removesuffix(" from").removesuffix(" in")) if station else ""
    if WITHIN in where:
        return Message("instrument{at} displaced within round {number}", at=at, number=number)
    if number.endswith(ONE_ROUND):
        return Message("instrument{at} aligned differently in round {number}", at=at, number=number)
    return Message("instrument{at} re-aligned from round {number} on", at=at, number=number)


def _target_shift_title(where: str) -> str:
    if WITHIN in where:
        target, _, number = where.rpartition(f" {WITHIN}")
        return Message("target {target} displaced within round {number}", target=target, number=number)
    target, _, moment = where.rpartition(" from ")
    return Message(
        "target {target} displaced from round {number} on", target=target, number=moment.removeprefix("round ")
    )


def _changed_in(where: str) -> tuple[str, ...]:
    return ("time_s",) if WITHIN in where else ("round",)


def _frame_shift_evidence(of: FittedCause) -> str:
    if "line" in of.numbers:
        return Message(
            "the instrument was displaced {where}, from line {line:.0f} of the table on",
            where=of.where,
            line=of.numbers["line"],
        )
    if of.where.endswith(ONE_ROUND):
        return Message("the instrument's frame was aligned differently in {where}", where=of.where)
    return Message("the instrument's frame was re-aligned from {where} on", where=of.where)


def _target_shift_evidence(of: FittedCause) -> str:
    if "line" not in of.numbers:
        return Message("target {where} was displaced", where=of.where)
    target, _, number = of.where.rpartition(f" {WITHIN}")
    return Message(
        "target {target} was displaced within round {number}, from line {line:.0f} of the table on",
        target=target,
        number=number,
        line=of.numbers["line"],
    )


FRAME_SHIFT: Final = Specification(
    name="frame_shift",
    kind="instrument",
    title=_frame_shift_title,
    family="instrument re-aligned",
    advice=Advice(
        "Metrology: check the alignment of the instrument ({where}): a new alignment, a tripod that was knocked.",
        f"{REST} Better, measure again in one alignment.",
        NOTHING,
    ),
    evidence=_frame_shift_evidence,
    fixed={"line": "1"},
    varies="with time",
    drawing=Drawing(columns=_changed_in, by_state=True, shared="station"),
    most=1,
)
TARGET_SHIFT: Final = Specification(
    name="target_shift",
    kind="instrument",
    title=_target_shift_title,
    family="displaced targets",
    advice=Advice("Metrology: check the mounting of that target.", REST, NOTHING),
    evidence=_target_shift_evidence,
    fixed={"line": "1"},
    varies="with time",
    drawing=Drawing(columns=_changed_in, by_state=True, shared="target"),
    most=1,
)


def alignments(inputs: CandidateInputs) -> Catalogue:
    """Return a candidate for the instrument's frame and for every target, from each round but the first on, and within each round.

    And for the frame in one round alone; in the first or the last it is the same as from a round on.
    """
    station, rounds = inputs.data.station, list(dict.fromkeys(inputs.data.round))
    number = np.array([rounds.index(name) for name in inputs.data.round])
    single = len(dict.fromkeys(station)) == 1
    frame_shifts, target_shifts = [], []

    def add_frame_shifts(aligned: np.ndarray, name: str, preposition: str) -> None:
        for at, mask in [("", aligned)] if single else _changed(aligned, station):
            where = f"round {name}" if single else f"station {at} {preposition} round {name}"
            variant = Variant(masked_columns(FRAME, mask, UM))
            event = f"station {at}" if at else FRAME_ALONE
            frame_shifts.append(Candidate(FRAME_SHIFT, where, (*SHIFTS, *TURNS), (variant,), 1.0, event=event))

    for k, name in enumerate(rounds[1:], 1):
        later = number >= k
        add_frame_shifts(later, name, "from")
        if k < len(rounds) - 1 <= MOST_ROUNDS:
            add_frame_shifts(number == k, f"{name}{ONE_ROUND}", "in")
        for target, mask in _changed(later, inputs.data.target):
            variant = Variant(masked_columns(PLACE, mask, UM))
            where = f"{target} from round {name}"
            target_shifts.append(Candidate(TARGET_SHIFT, where, SHIFTS, (variant,), 1.0, event=target))
    if len(rounds) <= MOST_ROUNDS:
        sides = {str(side): set(inputs.data.target[inputs.data.carrier == side]) for side in inputs.data.carrier}
        # With one side only, or one target on a side, a jump of the machine is the same.
        for name in dict.fromkeys(station.tolist()) if len(sides) > 1 else ():
            where = "" if single else f"station {name} "
            frame_shifts += _within_rounds(inputs.data, FRAME_SHIFT, where, station == name, FRAME)
        for name in sorted(set().union(*(targets for targets in sides.values() if len(targets) > 1))):
            own = inputs.data.target == name
            target_shifts += _within_rounds(inputs.data, TARGET_SHIFT, f"{name} ", own, PLACE)
    return Catalogue((*frame_shifts, *target_shifts))


def of_a_jumped_side(data: Measurements, chosen: Sequence[tuple[Candidate, Variant]]) -> set[tuple[str, str]]:
    """Return effect and place of displaced targets that are all targets of a side, at one time: then the side jumped, and no target."""
    rank = np.empty(len(data), dtype=int)
    rank[order_in_time(data)] = np.arange(len(data))
    shifted = []
    for candidate, variant in chosen:
        if candidate.specification is TARGET_SHIFT:
            moved = variant.columns[0].terms[0].functions.values(slice(None))[:, 0] != 0.0
            shifted.append((candidate.key, set(data.target[moved]), int(rank[moved].min())))
    for side in dict.fromkeys(data.carrier.tolist()):
        targets = set(data.target[data.carrier == side])
        for _, _, first in shifted:
            own = [
                (key, moved)
                for key, moved, at in shifted
                if moved <= targets and 0 <= at - first <= AT_ONCE * len(data)
            ]
            if len(targets) > 1 and set().union(*(moved for _, moved in own)) == targets:
                return {key for key, _ in own}
    return set()


def _within_rounds(
    data: Measurements, of: Specification, where: str, own: np.ndarray, freedoms: Sequence[Freedom]
) -> list[Candidate]:
    """Return a candidate for each round in the middle of which a station or target (its readings ``own``) may have been displaced."""
    order = order_in_time(data)
    read, candidates = order[own[order]], []
    for name in dict.fromkeys(data.round[read].tolist()):
        inside = np.flatnonzero(data.round[read] == name)
        # From the first reading of a later round on is the same as from that round on.
        inside = inside[(inside >= FEWEST_READINGS) & (inside <= len(read) - FEWEST_READINGS) & (inside > inside[:1])]
        tried = inside[np.unique(np.linspace(0, len(inside) - 1, min(len(inside), MOST_LINES)).astype(int))]
        variants = []
        for first in tried.tolist():
            later = np.zeros(len(data), dtype=bool)
            later[read[first:]] = True
            variants.append(Variant(masked_columns(freedoms, later, UM), {"line": float(data.lines[read[first]])}))
        if variants:
            names = SHIFTS if freedoms is PLACE else (*SHIFTS, *TURNS)
            place = f"{where}{WITHIN}{name}"
            candidates.append(Candidate(of, place, names, tuple(variants), 1.0, event=where.strip() or FRAME_ALONE))
    return candidates


def _changed(later: np.ndarray, names: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Return stations or targets with readings both before and after a change, with the mask of the later readings."""
    masks = [(str(name), names == name) for name in dict.fromkeys(names)]
    return [(name, later & mask) for name, mask in masks if 0 < np.count_nonzero(later & mask) < np.count_nonzero(mask)]
