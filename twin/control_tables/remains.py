"""What tables leave: the error at the tool over the volume, and the error motions they do not carry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, final

import numpy as np

from twin.budget import drawn_sides, known_volume
from twin.calibration import Calibration
from twin.channels import Listening
from twin.control_tables.wanted import Wanted, step_back
from twin.effects import ControlCorrection, Effect
from twin.kinematics import Kinematics, Poses, rms_and_max

Share = Literal["whole", "line", "no"]
STEPS: Final = 2
"""Of the linear axes, so that what they can take out is gone to a nanometre."""

SOME_BEYOND: Final = 0.01
ALL_BEYOND: Final = 0.99
"""Share of an error that lies where no linear axis moves the point; products of two errors are a thousandth."""


@final
@dataclass(frozen=True)
class Left:
    """The error at the tool over the volume.

    Attributes:
        rms_um, max_um: of the point.
        tilt_rms_urad: of the tool axis, about x and about y.
    """

    rms_um: float
    max_um: float
    tilt_rms_urad: tuple[float, float]


@final
@dataclass(frozen=True)
class Remains:
    """Before, after the tables, after a compensated program on top of them.

    Attributes:
        before, tables, program: the errors; ``program`` is None for a machine that runs none.
        poses: over how many.
        at_limits: of these, in how many an axis would have to leave its range to correct the rest.
    """

    before: Left
    tables: Left
    program: Left | None
    poses: int
    at_limits: int


def remains(wanted: Wanted, calibration: Calibration) -> Remains:
    """The error at the tool as the control with its tables leaves it.

    Args:
        wanted: the machine, its errors alone, tool length and conditions.
        calibration: the same errors under the control with its tables; none whose channel nobody gave.
    """
    with_tables = wanted.under(calibration)
    q = known_volume(calibration)
    sides, goal = drawn_sides(q), wanted.meant.forward(q)
    program, limited = _program(wanted, with_tables, q, sides, goal) if wanted.machine.runs_programs else (None, 0)
    return Remains(
        _left(wanted.under(wanted.calibration).forward(q, sides), goal),
        _left(with_tables.forward(q, sides), goal),
        program,
        len(q),
        limited,
    )


def _program(
    wanted: Wanted, with_tables: Kinematics, q: np.ndarray, sides: np.ndarray, goal: Poses
) -> tuple[Left, int]:
    """What a program leaves that corrects the point for what the tables leave, and at how many poses an axis has no room for it."""
    machine, commands, limited = wanted.machine, q.copy(), np.zeros(len(q), dtype=bool)
    linear = list(machine.linear)
    limits = np.array([wanted.range_of(machine.axes[i]) for i in linear])
    for _ in range(STEPS):
        step = commands[:, linear] + step_back(with_tables, commands, sides, goal.point_mm)
        commands[:, linear] = np.clip(step, *limits.T)
        limited = np.abs(commands[:, linear] - step).max(axis=1) > 1e-6
    return _left(with_tables.forward(commands, sides), goal), int(limited.sum())


def _left(reached: Poses, goal: Poses) -> Left:
    off = np.linalg.norm(reached.point_mm - goal.point_mm, axis=1) * 1e3
    tilt, _ = rms_and_max(reached.tilt_urad(goal))
    return Left(float(np.sqrt(np.mean(off**2))), float(off.max()), tilt)


@final
@dataclass(frozen=True)
class Carried:
    """One error of the calibration, and what the format does with it.

    Attributes:
        name: of the error.
        iso_class: its class.
        share: ``whole``; ``line``: where the other axes stand as the tables have them, elsewhere in part; ``no``.
        why: in words, where it is not whole.
    """

    name: str
    iso_class: str
    share: Share
    why: str


def carried(wanted: Wanted, kind: str, classes: frozenset[str], *, products: bool) -> tuple[Carried, ...]:
    """Every error of the calibration."""
    return tuple(
        Carried(effect.name, iso_class, *_share(effect, iso_class, wanted, kind, products=products))
        if iso_class in classes
        else Carried(effect.name, iso_class, "no", "not in --scope")
        for effect in wanted.calibration.effects
        if not isinstance(effect, ControlCorrection)
        for iso_class in (wanted.class_of(effect),)
    )


def _share(effect: Effect, iso_class: str, wanted: Wanted, kind: str, *, products: bool) -> tuple[Share, str]:
    axis = wanted.machine.by_name[effect.frame.axis]
    heard = _Heard(wanted)
    effect.components(heard)
    others = sorted(name for name in heard.used if name != axis.name and name in wanted.machine.by_name)
    directed = f"approach_{axis.name}" in heard.asked
    if kind in ("isg", "grid") and directed:
        return "no", "the format has no directions: the mean of both is taken"
    if kind == "grid":
        if not axis.linear:
            return "no", "an error of a rotary axis: a grid knows X, Y and Z only"
        rotary = [name for name in others if not wanted.machine.by_name[name].linear]
        return ("line", f"depends on {' '.join(rotary)} too") if rotary else ("whole", "")
    if kind == "isg":
        return ("line", f"depends on {' '.join(others)} too") if others else ("whole", "")
    if not axis.linear:
        if iso_class != "R-POS":
            return "no", "moves the point in a direction that turns with the rotary axes"
        return ("line", f"depends on {' '.join(others)} too") if others else ("whole", "")
    if kind == "linuxcnc" and iso_class in ("L-STR", "L-SQU"):
        return "no", "moves other axes than its own: the format has no such tables"
    beyond = wanted.beyond(effect)
    if beyond > ALL_BEYOND:
        return "no", "no linear axis moves the point that way"
    if beyond > SOME_BEYOND:
        return "line", f"no linear axis moves the point the way of {100.0 * beyond:.0f} % of it"
    if others:
        return "line", f"depends on {' '.join(others)} too"
    if iso_class == "L-ANG" and kind == "linuxcnc":
        return "line", "along its own axis only, and there with the lever of the reference position"
    if iso_class == "L-ANG" and not (kind == "siemens" and products):
        return "line", "with the lever of the reference position"
    return "whole", ""


@final
class _Heard(dict[str, Any]):
    """One pose that remembers which axes, and which channels beside, an effect asks for."""

    def __init__(self, wanted: Wanted) -> None:
        self._source = Listening(wanted.machine)
        super().__init__(self._source)
        self.used: set[str] = set()

    def __contains__(self, name: object) -> bool:
        return True

    def __getitem__(self, name: str) -> Any:
        self.used.add(name)
        return self._source[name]

    @property
    def asked(self) -> Mapping[str, None]:
        """Channels beside the positions."""
        return dict.fromkeys(self._source.asked)
