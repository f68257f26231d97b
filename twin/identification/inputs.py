"""Checks of the readings before a fit: sensors that respond, columns that are read, commands that agree with the readings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.distributions import chi2_sf
from twin._common.errors import InputError, require_type
from twin._common.messages import Message
from twin._common.units import MM
from twin.display.numbers import listed
from twin.identification.network import Network, stated_covariance
from twin.identification.solve import SIGNIFICANCE, Repeats, Spread, covariance_from_repeats, noise_text, repeats_of
from twin.machine.machine import Machine
from twin.measurement.agreement import WRONG_COLUMN_SHARE, agreeing_rows, fit_of, other_unit
from twin.measurement.columns import ASSUMED, POINT_COLUMNS
from twin.measurement.instruments import (
    SIDES,
    Instrument,
    StationInstruments,
    default_instrument,
    instrument_named,
    others_alike,
)
from twin.measurement.observation import CarriedTargets, at_origin, nominal_carriers
from twin.measurement.set_up import LARGEST_MISFIT_M, StationsAndTargets
from twin.measurement.table import Measurements

FEWEST_ROWS: Final = 3
"""Number of equal readings above which they are not a coincidence."""
LEAST_MOTION_M: Final = 1e-4
"""Motion, m, that a sensor must show. Gauges for machine tools have a resolution of 0.01 mm or better."""
IN_LINE: Final = 0.01
"""Ratio of width to length below which points are on a line, which has no sides."""
NOTICEABLE_MOTION_M: Final = 1e-5
"""Motion, m, above which a constant reading gives a notice."""
NOT_PROBED_M: Final = 0.02
"""Motion, m, of a sphere in the frame of its probe that is no error of a machine: the positions are not those of its centre."""
ABOVE_NOSE_M: Final = 0.01
"""Height of a probe's tip above the spindle nose, m, that is no measurement error."""
LENGTH_SHARE: Final = 0.01
"""Share of the motion by which a column must change to be taken for a length; across the beam, anything would fit."""
BALL_BAR_TRAVEL: Final = 0.05
"""Relative change of a ball bar's length, at most: its travel is a few millimetres."""
FARTHEST_STATION_M: Final = 50.0
"""Largest distance of an interferometer, m; beyond it, the column is a coordinate."""


class PreparedData(NamedTuple):
    """The instruments, the rows whose command agrees with the readings, and the initial set-up."""

    instruments: StationInstruments
    data: Measurements
    setup: StationsAndTargets


def prepare(machine: Machine, data: Measurements, instrument: Instrument | None) -> PreparedData:
    """Return the instruments, the rows whose command agrees with the readings, and the initial set-up.

    ``instrument``: the instrument of the stations whose instrument the table does not name; if None, the one that their readings
    indicate (`_instruments`).

    Raises `InputError`: a sensor that does not follow its target; a single column that is no coordinate and no length; readings that do
    not belong to the instrument; commands that do not agree with the readings (`agreeing_rows`).
    """
    carried = nominal_carriers(machine, data)
    sensors = _check_sensors(data, carried)
    instruments, notices = _instruments(machine, data, instrument)
    assumed = any(text.startswith(ASSUMED) for text in notices)
    try:
        agreeing, setup = agreeing_rows(machine, data, instruments, carried)
    except InputError as error:
        if not assumed:
            raise
        raise InputError(
            f"only x_mm is given, and it follows the commands neither as a coordinate along a line nor as a length: {error.what}",
            expected="x_mm, y_mm and z_mm, or a length or coordinate that changes with the commands",
            file=error.file,
            line=error.line,
            value=error.value,
        ) from None
    far = float(np.linalg.norm(setup.origin, axis=1).max())
    if assumed and far > FARTHEST_STATION_M:
        raise data.error(
            f"only x_mm is given, and it does not follow the commands as a coordinate along a line; as a length it would place the "
            f"station {far:.3g} m away, so it is one of several coordinates",
            expected="x_mm, y_mm and z_mm, or an interferometer's lengths in x_mm",
            row=0,
        )
    plane = _mirrored_planes(agreeing, setup)
    _check_artefacts(agreeing, setup)
    certified = [artefact.brief for artefact in agreeing.artefacts]
    all_notices = (*notices, *data.notices, *sensors, *_unobserved_axes(machine, agreeing), *plane, *certified)
    return PreparedData(instruments, replace(agreeing, notices=all_notices), setup)


def _check_artefacts(data: Measurements, setup: StationsAndTargets) -> None:
    """Raise `InputError` unless each artefact's targets are on one side, their places are unknown, and the readings are those of it."""
    for artefact in data.artefacts:
        rows = [int(np.flatnonzero(data.target == name)[0]) for name in artefact.targets if name in setup.targets]
        at = [setup.targets.index(data.target[row]) for row in rows]
        if len({str(data.carrier[row]) for row in rows}) > 1:
            raise data.error(
                f"targets of certificate {artefact.number} are on both sides of the machine",
                expected="all of one artefact on one carrier, tool or work",
                row=rows[0],
            )
        given = [row for row, target in zip(rows, at, strict=True) if setup.target_known[target] or setup.lines[target]]
        if given:
            raise data.error(
                f"target {data.target[given[0]]} has a place in the table and in certificate {artefact.number}",
                expected="one of them; or its rows without place_x_mm, place_y_mm, place_z_mm",
                row=given[0],
            )
        known = artefact.among(setup.targets)
        read = np.isin(data.target, [data.target[row] for row in rows])
        if known is None or not np.isfinite(data.point_mm[read]).all():
            continue
        miss = known.largest_difference(setup.place[[setup.targets.index(name) for name in known.targets]])
        if miss > LARGEST_MISFIT_M:
            raise InputError(
                f"the readings contradict certificate {artefact.number}: its spheres are up to {miss / MM:.4g} mm from where they were "
                "measured",
                expected="the targets' names of the certificate, and the artefact that was measured",
                file=artefact.source,
            )


def _check_sensors(data: Measurements, carried: CarriedTargets) -> list[Message]:
    """Return a notice for each coordinate that never changes.

    Raises `InputError`: a target of which no coordinate ever changes, although the commands move it wherever it sits on its carrier; a
    sphere that is not at the tip of its probe.
    """
    probed, notices = at_origin(data), []
    for station in dict.fromkeys(data.station):
        of_station = data.station == station
        check = _check_sphere if np.all(probed[of_station]) else _check_signal
        for target in dict.fromkeys(data.target[of_station]):
            rows = np.flatnonzero(of_station & (data.target == target))
            notices += check(data, rows, carried.select(rows).least_motion(data.place_mm[rows[0]]))
        if check is _check_signal:
            notices += _constant_coordinates(data, np.flatnonzero(of_station), carried)
    return notices


def _check_signal(data: Measurements, rows: np.ndarray, motion: np.ndarray) -> list[Message]:
    """Return a notice, or raise `InputError`, if nothing that a station reads of a target changes, although its carrier moves it.

    ``rows``: (k,) those of the station and target; ``motion``: (k, 3) least motion of the target, m.
    """
    constant, read = _constant(data.point_mm[rows])
    if not np.any(read) or not np.array_equal(constant, read):
        return []
    far = int(np.argmax(np.linalg.norm(motion - motion[0], axis=1)))
    moved = float(np.linalg.norm(motion[far] - motion[0]))
    target, station = data.target[rows[0]], data.station[rows[0]]
    if moved > LEAST_MOTION_M:
        raise data.error(
            f"sensor without signal: readings of target {target} from station {station} are equal in all {len(rows)} rows, but it "
            f"was moved by {moved / MM:.3g} mm",
            expected="readings that follow the commands; check the sensor, its cable and its column",
            row=rows[far],
            value=", ".join(f"{POINT_COLUMNS[i]} {data.point_mm[rows[0], i]:g}" for i in np.flatnonzero(read)),
        )
    coarse = Message(
        "readings of target {target} from station {station} are equal in all {count} rows, but it was moved by {distance:.2g} mm: the "
        "sensor is dead or its resolution is coarse",
        target=target,
        station=station,
        count=len(rows),
        distance=moved / MM,
    )
    return [coarse] if moved > NOTICEABLE_MOTION_M else []


def _check_sphere(data: Measurements, rows: np.ndarray, motion: np.ndarray) -> list[Message]:
    """Raise `InputError` if a sphere moves in the frame of its probe; arguments as `_check_signal`."""
    distance = np.linalg.norm(motion, axis=1)
    if distance.max() > NOT_PROBED_M:
        target, probe = data.target[rows[0]], data.station[rows[0]]
        raise data.error(
            f"with these positions, sphere {target} moves by {distance.max() / MM:.3g} mm in the frame of probe {probe}",
            expected="the positions of the linear axes at which the tip was at the centre of the sphere",
            row=rows[int(np.argmax(distance))],
        )
    return []


def implausible_tips(data: Measurements, setup: StationsAndTargets) -> tuple[Message, ...]:
    """Return a notice for each probe whose tip would be above the spindle nose: the positions are probably those of the tip."""
    implausible_tips = []
    for i, name in enumerate(setup.stations):
        rows = data.station == name
        above = float(setup.origin[i, 2])
        if setup.reads[i].reads == "null" and data.station_carrier[rows][0] == "tool" and above > ABOVE_NOSE_M:
            implausible_tips.append(
                Message(
                    "the tip of probe {name} would be {height:.0f} mm above the spindle nose: the positions may be those of "
                    "the tip (tool centre point control active), not those of the axes",
                    name=name,
                    height=above / MM,
                )
            )
    return tuple(implausible_tips)


def _constant(point_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (3,) whether a coordinate is the same in all rows that have it, and (3,) whether any has it."""
    read = np.isfinite(point_mm)
    low = np.min(np.where(read, point_mm, np.inf), axis=0)
    high = np.max(np.where(read, point_mm, -np.inf), axis=0)
    return (read.sum(axis=0) >= FEWEST_ROWS) & (low == high), read.any(axis=0)


def _constant_coordinates(data: Measurements, rows: np.ndarray, carried: CarriedTargets) -> list[Message]:
    """Return a notice for each coordinate of a station, read in some rows, that never changes while others do."""
    point_mm = data.point_mm[rows]
    constant, read = _constant(point_mm)
    moved = float(np.linalg.norm(np.ptp(carried.points[rows], axis=0)))
    if moved <= LEAST_MOTION_M or np.array_equal(constant, read):
        return []
    return [
        Message(
            "{column} of station {station} is {value:g} in every row while its targets move by {distance:.3g} mm: a "
            "dead channel, unless they move in a plane and are noise-free",
            column=POINT_COLUMNS[i],
            station=data.station[rows[0]],
            value=point_mm[np.isfinite(point_mm[:, i]), i][0],
            distance=moved / MM,
        )
        for i in np.flatnonzero(constant)
    ]


def _unobserved_axes(machine: Machine, data: Measurements) -> list[Message]:
    """Return a notice for each axis that moved although no target or station is on the side that it carries."""
    sides = {*data.carrier, *data.station_carrier}
    return [
        Message(
            "{name} moved, but it carries the {side} side, which has no target: its errors are not identifiable",
            name=axis.name,
            side=axis.side,
        )
        for axis in map(machine.by_name.__getitem__, data.moved(machine))
        if axis.side != "both" and axis.side not in sides
    ]


def _mirrored_planes(data: Measurements, setup: StationsAndTargets) -> list[Message]:
    """Return a notice for each station that reads two coordinates and looks at their plane from the negative side.

    Readings in a plane fit either way: a station on the other side sees a mirror image.
    """
    mirrored_planes = []
    for i in np.flatnonzero(~setup.station_known):
        point = data.point_mm[data.station == setup.stations[i]]
        read = np.isfinite(point).any(axis=0)
        whole = point[np.isfinite(point[:, read]).all(axis=1)][:, read]
        if setup.reads[i].reads != "point" or np.count_nonzero(read) != 2 or len(whole) < FEWEST_ROWS:
            continue
        size = np.linalg.svd(whole - whole.mean(axis=0), compute_uv=False)
        unread = int(np.flatnonzero(~read)[0])
        if size[1] > IN_LINE * size[0] and setup.rotation[i][unread, unread] < -0.5:
            columns = listed([POINT_COLUMNS[k] for k in np.flatnonzero(read)])
            mirrored_planes.append(
                Message(
                    "station {station} reads {columns} only, and its readings fit a station on the machine's -{direction} "
                    "side: if it is not there, one column of commands or readings has the wrong sign (mirrored axis)",
                    station=setup.stations[i],
                    columns=columns,
                    direction="xyz"[unread],
                )
            )
    return mirrored_planes


def _instruments(
    machine: Machine, data: Measurements, instrument: Instrument | None
) -> tuple[StationInstruments, tuple[Message, ...]]:
    """Return the instrument of each station, and notices of assumptions.

    A station has the instrument that the table names. If it names none, stations of the same kind (the side on which they ride, the
    coordinates that were read, and whether all readings are zero) have the same.
    """
    if instrument is not None:
        require_type("instrument", instrument, Instrument)
    kinds: dict[tuple[Any, ...], list[str]] = {}
    probed = at_origin(data)
    for station in dict.fromkeys(data.station.tolist()):
        rows = data.station == station
        read, side = np.isfinite(data.point_mm[rows]), str(data.station_carrier[rows][0])
        zero = bool(np.all(probed[rows]))
        kinds.setdefault((str(data.instrument[rows][0]), side, zero, *read.any(axis=0)), []).append(station)
    instruments: dict[str, Instrument] = {}
    notices: list[Message] = []
    for (name, side, zero, *_), stations in kinds.items():
        part = data if len(kinds) == 1 else data.select(np.isin(data.station.astype(str), stations))
        named = instrument_named(name) if name else instrument
        if named is None and zero:
            named = default_instrument("null", side)
        own, notes = _instrument(machine, part, named, side)
        instruments |= dict.fromkeys(stations, own)
        notices += notes
    return StationInstruments(instruments), tuple(dict.fromkeys(notices))


def _instrument(
    machine: Machine, data: Measurements, instrument: Instrument | None, side: str
) -> tuple[Instrument, tuple[Message, ...]]:
    """Return the instrument of stations of one kind, and notices of assumptions.

    An empty field is a coordinate that was not measured: a scale parallel to a stage reads x alone. The length of a tracking
    interferometer is also in x_mm; the motion shows which of the two it is.

    Raises `InputError`: readings that do not belong to the instrument; a single column that does not follow the commands.
    """
    read = [i for i in range(3) if np.isfinite(data.point_mm[:, i]).any()]
    if instrument is not None and instrument.specification.columns == ("x_mm",):
        if read != [0]:
            raise data.error(
                f"{instrument.name} reads one number, but y_mm or z_mm is given",
                expected="the reading in x_mm, y_mm and z_mm empty",
                row=np.flatnonzero(np.isfinite(data.point_mm[:, 1:]).any(axis=1))[0],
            )
        return instrument, ()
    if len(read) > 1 or np.isfinite(data.station_pose).all():
        return instrument or default_instrument("point", side, float(np.nanmax(np.abs(data.point_mm)))), ()
    length = data.point_mm[np.isfinite(data.point_mm[:, 0]), 0]
    if instrument is None and side != SIDES[0] and read == [0] and np.ptp(length) < BALL_BAR_TRAVEL * length.mean():
        bar = default_instrument("length", side, float(length.max()))
        return bar, (
            Message(
                "assumed: x_mm is an absolute length, read by a {title}: it hardly changes",
                title=bar.specification.title,
            ),
        )
    column, points = POINT_COLUMNS[read[0]], default_instrument("point", side)
    if _follows_as_coordinate(machine, data):
        notice = Message("only {column} is given: taken as the coordinate of all targets along a line", column=column)
        return instrument or points, () if read == [0] else (notice,)
    unit = other_unit(machine, data, StationInstruments.same(points, data.station))
    if unit is not None or read != [0] or instrument is not None or not _may_be_length(machine, data):
        named = "" if instrument is None else f" that {instrument.name} read"
        raise data.error(
            f"only {column} is given, and as a coordinate{named} it does not follow the commands{'' if unit is None else f': {unit}'}",
            expected="x_mm, y_mm and z_mm; or lengths of an interferometer, or a coordinate along a line, in x_mm",
            row=0,
            value=f"{data.point_mm[0, read[0]]:g}",
        )
    return default_instrument("length"), (
        Message(
            "assumed: x_mm is a length from an unknown zero, read by a tracking interferometer: only x_mm is given, "
            "and it does not follow the commands as a coordinate. Otherwise name the instrument, or give y_mm and "
            "z_mm."
        ),
    )


def _follows_as_coordinate(machine: Machine, data: Measurements) -> bool:
    """Return whether a single column follows the commands as a coordinate along one line."""
    try:
        fit = fit_of(machine, data, StationInstruments.same(default_instrument("point"), data.station))
    except InputError:
        return False
    return fit.share <= WRONG_COLUMN_SHARE


def _may_be_length(machine: Machine, data: Measurements) -> bool:
    """Return whether x_mm changes by a sufficient share of the motion of some target."""
    carried = nominal_carriers(machine, data)
    for station, target in dict.fromkeys(zip(data.station, data.target, strict=True)):
        rows = (data.station == station) & (data.target == target) & np.isfinite(data.point_mm[:, 0])
        if np.count_nonzero(rows) < 2:
            continue
        motion = carried.select(rows).least_motion(data.place_mm[rows][0])
        moved = float(np.linalg.norm(np.ptp(motion, axis=0)))
        if np.ptp(data.point_mm[rows, 0]) * MM >= LENGTH_SHARE * moved:
            return True
    return False


def certificate_notices(network: Network, setup: StationsAndTargets) -> list[Message]:
    """Return a notice for each certificate that the estimated places contradict: chi² of its whitened residuals."""
    notices = []
    for artefact in network.data.artefacts:
        known = artefact.among(setup.targets)
        residual = np.zeros(0)
        if known is not None:
            residual = known.rows(setup.place[[setup.targets.index(name) for name in known.targets]]).residual
        chi2 = float(residual @ residual)
        if len(residual) and chi2_sf(chi2, len(residual)) < SIGNIFICANCE:
            notices.append(
                Message(
                    "THE READINGS CONTRADICT CERTIFICATE {number}: chi² {chi2:.4g} of {count} known values. Check the "
                    "artefact's temperature, the targets' names and the instrument's scale",
                    number=artefact.number,
                    chi2=chi2,
                    count=len(residual),
                )
            )
    return notices


# --- The noise with which an estimate weights its readings: as stated, or from repeats where these contradict it


@final
@dataclass(frozen=True, eq=False)
class NoiseOfReadings:
    """Noise of the readings.

    Attributes:
        covariance: (n, 3, 3) m².
        spread: noise on which the covariance of the estimate is based; ``repeats`` where they contradict the stated noise.
        contradicted: names of the instruments whose stated noise the repeats contradict.
        assumed: names of the instruments that nothing but the kind of the readings indicates, and no repeats test.
    """

    covariance: np.ndarray
    spread: Spread
    contradicted: tuple[str, ...]
    assumed: tuple[str, ...]
    notices: tuple[Message, ...]

    def interval_text(self, *, incomplete: bool) -> str:
        """Return on which noise the intervals are based; ``incomplete``: whether residuals exceed the noise."""
        text = {
            "stated": "the stated uncertainty of the readings",
            "repeats": "the standard deviation of repeats",
            "between poses": "the variation between poses",
            "between rounds": "the variation between rounds",
        }[self.spread]
        return f"{text} and the model discrepancy" if incomplete and not self.spread.startswith("between") else text


def reading_noise(machine: Machine, placed: PreparedData, spread: Spread, *, named: bool) -> NoiseOfReadings:
    """Return the noise of the readings.

    If the repeats of an instrument vary more than its stated noise allows, their standard deviation is taken. If it has too few repeats
    to test its noise, and nothing names it, the assumption is stated.

    ``spread``: source that was asked for; with ``repeats`` they are taken in any case; ``named``: whether the user named the instrument
    of the stations for which the table does not.

    Raises `InputError`: too few repeats for ``repeats``.
    """
    data, instruments = placed.data, placed.instruments
    stated = stated_covariance(data, instruments)
    repeats = repeats_of(machine, data, instruments, stated)
    if spread == "repeats":
        return NoiseOfReadings(covariance_from_repeats(data, instruments, repeats), spread, (), (), ())
    covariance = np.array(stated)
    by_instrument = {id(repeat.instrument): repeat for repeat in repeats}
    contradicted, assumed, notices = [], [], []
    for instrument, rows in instruments.groups(data.station):
        own, point = by_instrument.get(id(instrument)), data.point_mm[rows] * 1e-3
        of_table = bool(np.isfinite(data.u_mm[rows]).any())
        if own is not None and own.contradict:
            covariance[rows] = own.covariance
            contradicted.append(instrument.name)
            notices.append(_contradiction(own, of_table=of_table, point=point, stated=stated[rows]))
        elif not (of_table or named or all(data.instrument[rows]) or (own is not None and own.decide)):
            assumed.append(instrument.name)
            notices.append(
                Message(
                    "assumed: the readings are those of a {title}, {noise}: the table names no instrument and has too few "
                    "repeats to test this{others}",
                    title=instrument.specification.title,
                    noise=noise_text(instrument, point, stated[rows]),
                    others=_others(instrument),
                )
            )
    return NoiseOfReadings(
        read_only(covariance),
        "repeats" if contradicted and spread == "stated" else spread,
        tuple(contradicted),
        tuple(assumed),
        tuple(notices),
    )


def _contradiction(repeats: Repeats, *, of_table: bool, point: np.ndarray, stated: np.ndarray) -> Message:
    """Return the notice that repeats contradict the stated noise."""
    instrument = repeats.instrument
    source = (
        Message("the table's uncertainties")
        if of_table
        else Message("the noise of a {title}", title=instrument.specification.title)
    )
    return Message(
        "the repeats contradict {source} ({stated}): reduced chi² {chi2:.3g} ({dof} degrees of freedom a "
        "coordinate). Their standard deviation is taken instead: {taken}{others}",
        source=source,
        stated=noise_text(instrument, point, stated),
        chi2=repeats.reduced_chi2,
        dof=repeats.dof,
        taken=noise_text(instrument, point, repeats.covariance),
        others="" if of_table else _others(instrument),
    )


def _others(instrument: Instrument) -> str:
    """Return the names of the other instruments with such readings, as a clause; empty if there is none."""
    names = others_alike(instrument)
    return Message(". If it was another one, name it: {names}", names=", ".join(names)) if names else ""
