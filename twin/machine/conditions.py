"""What a model needs to know beside the positions: temperatures, the time, the side every axis was come to from.

Temperatures and time are given for a whole program; the side an axis was come to from follows from the program
(`twin.compensation.backlash`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Final, final

import numpy as np

from twin._common.errors import InputError, nearest
from twin.machine.calibration import Calibration
from twin.machine.effects import Effect
from twin.machine.machine import Machine

TIME: Final = "time_s"
APPROACH: Final = "approach_"
PLAUSIBLE_DEGC: Final = (-40.0, 120.0)
"""What is no temperature of a machine is a slip: kelvin, fahrenheit, a lost point."""


def temperature_channel(name: str) -> str:
    """``T_X_degC`` of X."""
    return f"T_{name}_degC"


@final
@dataclass(frozen=True)
class Conditions:
    """What holds over a whole program.

    Attributes:
        temperature_degC: °C by axis (of its scale) or sensor.
        time_s: on the clock of the measured table's ``time_s``, which for a warm-up starts with the machine; None: not given.
    """

    temperature_degC: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    time_s: float | None = None

    @property
    def channels(self) -> dict[str, float]:
        """By the names effects know them by."""
        found = {temperature_channel(name): float(value) for name, value in self.temperature_degC.items()}
        return found if self.time_s is None else {**found, TIME: float(self.time_s)}

    def check(self, calibration: Calibration) -> None:
        """Nothing, if every name means something to a calibration and every value can be.

        Raises:
            InputError: a temperature of neither an axis nor a sensor, with the nearest right name; a value that cannot be.
        """
        sensors = [channel[2:-5] for channel in needed(calibration) if channel.startswith("T_")]
        known = list(dict.fromkeys((*calibration.machine.names, *sensors)))
        low, high = PLAUSIBLE_DEGC
        for name, value in self.temperature_degC.items():
            if name not in known:
                raise InputError(
                    "--temperature of neither an axis nor a sensor of the model",
                    expected=f"one of {', '.join(known)}",
                    value=name,
                    nearest=nearest(name, known),
                )
            if not low <= value <= high:
                raise InputError(
                    f"no temperature of a machine: {name}", expected=f"°C from {low:g} to {high:g}", value=value
                )
        if self.time_s is not None and not 0.0 <= self.time_s < np.inf:
            raise InputError("--time is no time since the start", expected="seconds, 0 or more", value=self.time_s)

    def missing(self, calibration: Calibration) -> dict[str, tuple[str, ...]]:
        """Channels that a calibration needs and nobody gave, with the effects that need them; directions apart."""
        given = self.channels
        return {name: by for name, by in needed(calibration).items() if name not in given}

    def unused(self, calibration: Calibration) -> tuple[str, ...]:
        """Channels that were given and that a calibration does not need."""
        wanted = needed(calibration)
        return tuple(name for name in self.channels if name not in wanted)

    def require(self, calibration: Calibration) -> None:
        """Nothing, if a calibration has all it needs.

        Raises:
            InputError: as `check`; a channel that is not given, with the effects that need it and the option that gives it.
        """
        self.check(calibration)
        missing = self.missing(calibration)
        if missing:
            raise InputError(
                "; ".join(f"{', '.join(by)} needs {name}" for name, by in missing.items()),
                expected=options_of(missing),
                file=calibration.path,
            )


def needed(calibration: Calibration) -> dict[str, tuple[str, ...]]:
    """Channels a calibration's effects ask for beside positions and directions, with the names of those effects."""
    return {
        name: by
        for name, by in asked(calibration.effects, calibration.machine).items()
        if not name.startswith(APPROACH)
    }


def asked(effects: Sequence[Effect], machine: Machine) -> dict[str, tuple[str, ...]]:
    """Every channel that effects ask for beside positions, with the names of those that do."""
    found: dict[str, tuple[str, ...]] = {}
    for effect in effects:
        state = Listening(machine)
        effect.components(state)
        for name in state.asked:
            found[name] = (*found.get(name, ()), effect.name)
    return found


@final
class Listening(dict[str, Any]):
    """One pose inside the ranges, and any channel an effect asks for: it remembers which.

    Args:
        machine: the machine.

    Attributes:
        asked: names of the channels, in the order they were asked for.
    """

    def __init__(self, machine: Machine) -> None:
        # Nowhere special: no effect is zero at 0.37 of a range.
        places = {
            axis.name: 137.0
            if axis.lower is None or axis.upper is None
            else axis.lower + 0.37 * (axis.upper - axis.lower)
            for axis in machine.axes
        }
        super().__init__({name: np.array([place]) for name, place in places.items()})
        self.asked: list[str] = []

    def __contains__(self, name: object) -> bool:
        return True

    def __missing__(self, name: str) -> np.ndarray:
        if name not in self.asked:
            self.asked.append(name)
        return np.array([27.0])


def options_of(channels: Iterable[str]) -> str:
    """The options that give channels."""
    names = list(channels)
    temperatures = " ".join(f"{name[2:-5]}=…" for name in names if name.startswith("T_"))
    others = [name for name in names if not name.startswith("T_") and name != TIME]
    return " ".join(
        [
            *([f"--temperature {temperatures}"] if temperatures else []),
            *(["--time S"] if TIME in names else []),
            *([f"a calibration without that effect: no option gives {', '.join(others)}"] if others else []),
        ]
    )
