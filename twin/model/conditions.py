"""Inputs of the error model besides the positions, and the machine's log that gives them over time.

They are temperatures, time, spindle speed and carried load, given for a whole program, or temperatures and speed by a log of the
machine and the program's own words for every block, and the direction of approach of every axis, which follows from the program.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Final, final

import numpy as np

from twin._common.errors import InputError, closest_name
from twin._common.messages import Message, joined
from twin._common.records import APPROACH, SPEED, TIME, is_temperature, read_log, sensor_of
from twin._common.units import count_with_noun
from twin.display.results import Result
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.effects import Effect
from twin.model.effects.base import HEAVIEST_KG, LOAD, RecordingState


@final
@dataclass(frozen=True, repr=False)
class MachineLog(Result):
    """A record of a machine.

    Attributes:
        path: the file.
        time_s: (n,), strictly increasing.
        temperature_degC: (n,) by sensor or axis.
        speed_rpm: (n,) spindle speed of the time up to each row; None if it was not recorded.
        notices: what was read but not used.

    Examples:
        >>> rows = [[0, 20.0, 0], [60, 20.4, 8000], [120, 20.9, 8000]]
        >>> np.savetxt("log.csv", rows, delimiter=",", header="time_s,T_X_degC,spindle_rpm", comments="")
        >>> log = twin.MachineLog.load("log.csv")
        >>> log.temperature_degC["X"]
        array([20. , 20.4, 20.9])
        >>> conditions = twin.Conditions(log=log, time_s=0.0)
    """

    path: Path
    time_s: np.ndarray
    temperature_degC: Mapping[str, np.ndarray]
    speed_rpm: np.ndarray | None
    notices: tuple[Message, ...] = ()

    @staticmethod
    def load(path: str | Path) -> MachineLog:
        """Read a record with the columns ``time_s``, ``T_<sensor>_degC`` and ``spindle_rpm``.

        Raises:
            InputError: as for `read_log`.
        """
        cells, numbers, notices = read_log(path)
        found = {sensor_of(name): values for name, values in numbers.items() if is_temperature(name)}
        return MachineLog(cells.path, numbers[TIME], MappingProxyType(found), numbers.get(SPEED), notices)

    @property
    def brief(self) -> str:
        """File, number of rows, times and sensors."""
        times = f"{count_with_noun(len(self.time_s), 'row')} from {self.time_s[0]:g} to {self.time_s[-1]:g} s"
        columns = [*self.temperature_degC, *([] if self.speed_rpm is None else ["spindle speed"])]
        return f"{self.path.name}: {times}, {', '.join(columns)}"


WORDS: Final = MappingProxyType(
    {TIME: Message("the time"), SPEED: Message("the spindle speed"), LOAD: Message("the load")}
)
"""Channels that are given by a single value, in words."""
UNITS: Final = MappingProxyType(
    {TIME: "time {:g} s of the measured table", SPEED: "spindle {:g} 1/min", LOAD: "load {:g} kg"}
)
"""The same with their value."""
SETTINGS: Final = MappingProxyType({TIME: "time", SPEED: "rpm", LOAD: "load"})
"""Names of the settings that give them."""
PLAUSIBLE_DEGC: Final = (-40.0, 120.0)
"""Plausible temperatures of a machine; others are mistakes: kelvin, fahrenheit, a missing decimal point."""


def temperature_channel(name: str) -> str:
    """Return the name of a temperature channel: X → ``T_X_degC``."""
    return f"T_{name}_degC"


@final
@dataclass(frozen=True)
class Conditions:
    """Conditions of a program: values that apply to all of it, and sources of values that change during it.

    Attributes:
        temperature_degC: °C by axis (of its scale) or sensor.
        time_s: time on the clock of the measured table's ``time_s``, which for a warm-up starts with the machine; None if not given.
            With a log, or with speeds of the program, it is that of the beginning of the program.
        spindle_rpm: spindle speed, 1/min, constant since time zero; None if not given.
        load_kg: mass carried in the spindle or gripper, or on the table; None if not given.
        log: temperatures and speeds of the machine over time; None if not given.
        speed_of_program: whether the program's own words give the spindle speed where nothing else does.

    Examples:
        >>> conditions = twin.Conditions(temperature_degC={"X": 23.5}, time_s=7200.0)
        >>> conditions.channels
        {'T_X_degC': 23.5, 'time_s': 7200.0}
    """

    temperature_degC: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    time_s: float | None = None
    spindle_rpm: float | None = None
    load_kg: float | None = None
    log: MachineLog | None = None
    speed_of_program: bool = False

    @property
    def channels(self) -> dict[str, float]:
        """Values by the channel names that effects use."""
        found = {temperature_channel(name): float(value) for name, value in self.temperature_degC.items()}
        held = {TIME: self.time_s, SPEED: self.spindle_rpm, LOAD: self.load_kg}
        return found | {name: float(value) for name, value in held.items() if value is not None}

    def by_block(self, calibration: Calibration) -> bool:
        """Return whether conditions that a calibration needs differ from block to block."""
        required = needed(calibration)
        own_speed = self.speed_of_program and self.spindle_rpm is None and SPEED in required
        return own_speed or (self.log is not None and bool(required))

    @property
    def _logged(self) -> set[str]:
        """Channels that the log gives."""
        if self.log is None:
            return set()
        speed = set() if self.log.speed_rpm is None else {SPEED}
        return speed | {temperature_channel(name) for name in self.log.temperature_degC}

    def check(self, calibration: Calibration) -> None:
        """Raise `InputError` unless every temperature is of an axis or sensor of the calibration and every value is plausible."""
        sensors = [sensor_of(channel) for channel in needed(calibration) if is_temperature(channel)]
        known = list(dict.fromkeys((*calibration.machine.names, *sensors)))
        low, high = PLAUSIBLE_DEGC
        for name, value in self.temperature_degC.items():
            if name not in known:
                raise InputError(
                    "temperature of neither an axis nor a sensor of the model",
                    expected=f"one of {', '.join(known)}",
                    value=name,
                    nearest=closest_name(name, known),
                )
            if not low <= value <= high:
                raise InputError(
                    f"implausible temperature of {name}", expected=f"°C from {low:g} to {high:g}", value=value
                )
        for what, given, most, expected in (
            ("time", self.time_s, np.inf, "seconds since the start, 0 or more"),
            ("spindle speed", self.spindle_rpm, np.inf, "1/min, 0 or more"),
            ("load", self.load_kg, HEAVIEST_KG, f"kg, 0 to {HEAVIEST_KG:g}"),
        ):
            if given is not None and not (0.0 <= given <= most and given < np.inf):
                raise InputError(f"{what} must be zero or positive", expected=expected, value=given)

    def missing(self, calibration: Calibration) -> dict[str, tuple[str, ...]]:
        """Return the channels, other than directions of approach, that a calibration needs and that are not given, with the effects."""
        given = self.channels.keys() | self._logged | ({SPEED} if self.speed_of_program else set())
        return {name: by for name, by in needed(calibration).items() if name not in given}

    def used(self, calibration: Calibration) -> dict[str, float]:
        """Return the given channels that a calibration needs."""
        required = needed(calibration)
        return {name: value for name, value in self.channels.items() if name in required}

    def unused(self, calibration: Calibration) -> tuple[str, ...]:
        """Return the given channels that a calibration does not need."""
        required = needed(calibration)
        return tuple(name for name in self.channels if name not in required)

    def require(self, calibration: Calibration) -> None:
        """Raise `InputError` if `check` fails or a channel that the calibration needs is missing; it names effects and channel."""
        self.check(calibration)
        self._check_log()
        missing = self.missing(calibration)
        if missing:
            settings = [
                *(["temperature"] if any(map(is_temperature, missing)) else []),
                *(setting for name, setting in SETTINGS.items() if name in missing),
            ]
            raise InputError(
                "; ".join(f"{', '.join(by)} needs {name}" for name, by in missing.items()),
                expected=needed_values(missing),
                file=calibration.path,
                setting=", ".join(settings) or None,
            )

    def _check_log(self) -> None:
        if self.log is None:
            return
        twice = self.channels.keys() & self._logged
        if twice:
            raise InputError(
                f"{', '.join(sorted(twice))} is given and in the log",
                expected="the log, or a value for the whole program",
                file=self.log.path,
            )
        if self.time_s is None:
            raise InputError(
                "the beginning of the program is unknown",
                expected="the time at which the program begins, on the clock of the log",
                file=self.log.path,
                setting="time",
            )


def needed(calibration: Calibration) -> dict[str, tuple[str, ...]]:
    """Return the channels, other than positions and directions of approach, that a calibration needs, each with its effects."""
    return {
        name: by
        for name, by in required_channels(calibration.effects, calibration.machine).items()
        if not name.startswith(APPROACH)
    }


def required_channels(effects: Sequence[Effect], machine: Machine) -> dict[str, tuple[str, ...]]:
    """Return the channels, other than positions, that the effects need, each with the names of its effects."""
    required_channels: dict[str, tuple[str, ...]] = {}
    for effect in effects:
        state = RecordingState(machine)
        effect.components(state)
        for name in state.asked:
            required_channels[name] = (*required_channels.get(name, ()), effect.name)
    return required_channels


def values_in_words(channels: Mapping[str, float]) -> str:
    """Return values by channel in words: "X 25 °C, time 3600 s of the measured table"."""
    return ", ".join(
        f"{sensor_of(name)} {value:g} °C" if is_temperature(name) else UNITS[name].format(value)
        for name, value in channels.items()
    )


def needed_values(channels: Iterable[str]) -> str:
    """Return the values that supply the channels, in words: "the temperature of bed and X, the time"."""
    names = list(channels)
    temperatures = [sensor_of(name) for name in names if is_temperature(name)]
    return joined(
        ", ",
        [
            *([Message("the temperature of {sensors}", sensors=" and ".join(temperatures))] if temperatures else []),
            *(words for name, words in WORDS.items() if name in names),
            *(
                Message("{name}, which cannot be given yet", name=name)
                for name in names
                if not is_temperature(name) and name not in WORDS
            ),
        ],
    )
