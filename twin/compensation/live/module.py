"""The kinematics module for LinuxCNC: the correction of the axes as CasADi functions without branches, and the C file made of them.

The correction c takes the position n that a program means to the command n + c(n) at which the machine with its errors holds tip and
tool axis where the machine without errors holds them at n. It is an explicit function: a fixed number of Newton steps with the
derivatives of the machine without errors. Its time is constant, and each step leaves about a thousandth of the errors.

Near a singular position the rotary axes would need a turn δ/σ that grows without limit (δ the tilt of the tool axis, σ the smaller
singular value of its derivative by the rotary axes). There the turn is damped, δσ/(σ² + λ²) with λ² = λ₀²(1 − (σ/ε)²)² for σ < ε. For
σ ≥ ε the orientation is corrected in full. The slope of the turn is at most about δ/λ₀²; λ₀ follows from the largest δ so that
n → n + c(n) remains invertible: the forward kinematics exists everywhere, and nothing jumps.

The C file holds numbers of a machine, the generated functions and the own code of the module, for LinuxCNC 2.9 (``kinematics.h`` and
``hal.h`` of linuxcnc-uspace-dev). Beside it, a HAL component in Python supplies its temperatures; the control starts and ends it and
the Python of the system runs it, so that the computer of the control needs nothing of twin.

References:
    - Y. Nakamura, H. Hanafusa: Inverse kinematic solutions with singularity robustness for robot manipulator control, J. Dyn. Sys.,
      Meas., Control 108 (1986) 163-171 (damping that depends on the distance from the singular position).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Any, Final, final

import casadi as ca
import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.families import LIVE_FORMATS
from twin._common.files import scratch_folder
from twin._common.records import APPROACH, RECORD_OF_CONTROL, SPEED, TIME, is_temperature, sensor_of
from twin.machine.chain import branches
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.effects.base import LOAD, HistoryShift
from twin.model.effects.empirical import channel_name
from twin.model.unknown_errors import ErrorTerms

STEPS: Final = 3
"""Newton steps: errors of 100 µm leave 0.1 nm after the second; the third is for large turns near a singular position."""
STEEPEST: Final = 0.7
"""Slope of the damped turn by a position at σ = 0, rad/rad: below 1, n → n + c(n) is invertible."""
REGION: Final = 2.0
"""ε in units of λ₀: the slope does not exceed `STEEPEST` by much anywhere between."""


@final
@dataclass(frozen=True)
class Damping:
    """Damping of the turn of the rotary axes near singular positions."""

    factor: float  # λ₀
    region: float  # ε, the singular value from which the orientation is corrected in full

    @classmethod
    def for_tilt(cls, largest_rad: float) -> Damping:
        """Return the damping for errors that tilt the tool axis by at most ``largest_rad``."""
        factor = float(np.sqrt(max(largest_rad, 1e-9) / STEEPEST))
        return cls(factor, REGION * factor)


@final
class LiveCorrection:
    """Functions of one machine with its errors, for three linear axes and at most two rotary ones, else `InputError`.

    All positions are metres and radians, axes in command order. ``channels`` are the directions of approach (axes,), then ``plain``,
    those that the control must supply, then the outputs of the ``lags``. ``errors``: (positions, channels) → errors
    (6·frames,).
    """

    def __init__(self, calibration: Calibration, plain: Sequence[str], damping: Damping) -> None:
        self.machine: Machine = calibration.machine
        self.plain, self.damping = tuple(plain), damping
        machine = self.machine
        if len(machine.linear) != 3 or len(machine.rotary) > 2:
            raise InputError(
                f"{machine.name} has {len(machine.linear)} linear and {len(machine.rotary)} rotary axes",
                expected="three linear axes and at most two rotary ones",
                file=machine.path,
            )
        machine.check_tool_along_z()
        self.calibration, effects = calibration, calibration.effects
        self.histories = tuple(effect for effect in effects if isinstance(effect, HistoryShift))
        # The derivatives by the other parameters do not enter the errors.
        unused = {name: 0.0 for effect in self.histories for name in effect.factor_channels[1:]}
        varying = [*(f"{APPROACH}{axis.name}" for axis in machine.axes), *self.plain]
        self.lags = tuple(lag for effect in self.histories for lag in effect.lags)
        varying += [lag.channel for lag in self.lags]
        terms = ErrorTerms(machine, effects, unused, varying)
        errors = terms.vector({effect.name for effect in effects})
        self.errors = ca.Function("errors", [terms.q, terms.channels], [errors])
        self.channel_count = len(varying)

    @cached_property
    def domains(self) -> np.ndarray:
        """(axes, 2) positions at which the errors are known, metres and radians; beyond them they keep the values of the ends."""
        bounds = np.array(self.calibration.domains())
        for i, axis in enumerate(self.machine.axes):
            if axis.lower is None:
                bounds[i] = -np.inf, np.inf
            else:
                bounds[i] = self.range_of(axis.name, *bounds[i])
        return read_only(bounds * self.machine.scale[:, None])

    def range_of(self, name: str, low: float, high: float) -> tuple[float, float]:
        """Return the part of the range of an axis (mm, degrees) or a channel over which effects with a range were measured."""
        for effect in self.calibration.bounded:
            for column, (lowest, highest) in effect.ranges.items():
                if channel_name(column) == name:
                    low, high = max(low, lowest), min(high, highest)
        return low, high

    @cached_property
    def correction(self) -> ca.Function:
        """(n (axes,), channels, tool (3,), orientation) → c (axes,).

        ``tool``: offsets of the tip from the spindle nose as the control counts them, metres: x, y and the length. ``orientation``: the
        share of the rotary axes' turn, 0 to 1.
        """
        machine = self.machine
        rotary, linear = list(machine.rotary), list(machine.linear)
        n, channels = ca.SX.sym("n", len(machine.axes)), ca.SX.sym("channels", self.channel_count)
        tool, orientation = ca.SX.sym("tool", 3), ca.SX.sym("orientation")
        goal, target = self._tip_and_axis(n, None, tool)
        by = ca.jacobian(goal, n)
        inverse, by_turn = ca.inv(by[:, linear]), by[:, rotary]
        across = self._across(n)
        held = ca.SX.sym("held", 3, 2)
        tilt_by = ca.substitute(ca.jacobian(held.T @ target, n)[:, rotary], held, across)
        turn, shift = ca.SX.zeros(len(rotary)), ca.SX.zeros(3)
        for _ in range(STEPS):
            q = ca.SX(n)
            q[linear] += shift
            q[rotary] += orientation * turn
            tip, pointing = self._tip_and_axis(q, self._errors_at(q, channels), tool)
            before = turn
            if rotary:
                # What the present turn has done is added again: the damped solution is that of the whole turn.
                turn = _damped(tilt_by, tilt_by @ (orientation * turn) - across.T @ pointing, self.damping)
            shift = shift - inverse @ (tip - goal + by_turn @ (orientation * (turn - before)))
        c = ca.SX.zeros(len(machine.axes))
        c[linear], c[rotary] = shift, orientation * turn
        names = ["n", "channels", "tool", "orientation"]
        return ca.Function("twin_correction", [n, channels, tool, orientation], [ca.cse(ca.densify(c))], names, ["c"])

    @cached_property
    def slopes(self) -> ca.Function:
        """(n, channels, tool) → σ, the smaller singular value (1,), and the derivatives (axes, axes) of c by n; for checks."""
        n, channels, tool, _ = self.correction.sx_in()
        by = ca.jacobian(self.correction(n, channels, tool, 1.0), n)
        _, target = self._tip_and_axis(n, None, tool)
        turning = ca.jacobian(target, n)[:, list(self.machine.rotary)]
        squares = ca.sumsqr(turning)
        smaller = squares
        if len(self.machine.rotary) == 2:
            determinant = ca.det(turning.T @ turning)
            smaller = 0.5 * (squares - ca.sqrt(ca.fmax(squares * squares - 4.0 * determinant, 0.0)))
        return ca.Function("slopes", [n, channels, tool], [ca.densify(ca.sqrt(ca.fmax(smaller, 0.0))), ca.densify(by)])

    @cached_property
    def to_workpiece(self) -> ca.Function:
        """(n (axes,), tool (3,)) → p (3,): the nominal tip, in the directions of the linear axes and equal to them at rotary zero."""
        n, tool = ca.SX.sym("n", len(self.machine.axes)), ca.SX.sym("tool", 3)
        tip, _ = self._tip_and_axis(n, None, tool)
        return ca.Function("twin_to_workpiece", [n, tool], [ca.cse(ca.densify(self._along_linear(tip)))])

    @cached_property
    def to_axes(self) -> ca.Function:
        """(p instead of the linear axes, rotary axes: (axes,); tool (3,)) → positions (3,) of the linear axes."""
        n, tool = ca.SX.sym("n", len(self.machine.axes)), ca.SX.sym("tool", 3)
        linear = list(self.machine.linear)
        at_rest = ca.SX(n)
        at_rest[linear] = 0.0
        by = ca.jacobian(self._along_linear(self._tip_and_axis(n, None, tool)[0]), n)[:, linear]
        start = self._along_linear(self._tip_and_axis(at_rest, None, tool)[0])
        # The tip is linear in the linear axes.
        found = ca.inv(ca.substitute(by, n, at_rest)) @ (n[linear] - start)
        return ca.Function("twin_to_axes", [n, tool], [ca.cse(ca.densify(found))])

    @cached_property
    def drives(self) -> ca.Function:
        """Function of the channels: the inputs of the lags (lags,); one zero if there are none."""
        channels = ca.SX.sym("channels", self.channel_count)
        first = len(self.machine.axes)
        state = dict(zip(self.plain, ca.vertsplit(channels)[first:], strict=False))
        inputs = [source for effect in self.histories for source in effect.driven(state)] or [0.0]
        return ca.Function("twin_drives", [channels], [ca.densify(ca.vertcat(*inputs))])

    def _errors_at(self, q: Any, channels: Any) -> Any:
        inside = [
            ca.fmin(ca.fmax(q[i], low), high) if np.isfinite(low) and np.isfinite(high) else q[i]
            for i, (low, high) in enumerate(self.domains)
        ]
        return self.errors(ca.vertcat(*inside), channels)

    def _tip_and_axis(self, q: Any, errors: Any, tool: Any) -> tuple[Any, Any]:
        """Return tip and tool axis in the work frame; ``errors`` None: nominal."""
        tool_side, work_side = branches(self.machine, q, errors)
        return work_side.into(*tool_side.carried(-tool, ca.vertcat(0.0, 0.0, 1.0)))

    def _across(self, n: Any) -> Any:
        """Return two directions (3, 2) across the nominal tool axis: x and y of the tool frame."""
        tool_side, work_side = branches(self.machine, n, None)
        directions = (ca.vertcat(1.0, 0.0, 0.0), ca.vertcat(0.0, 1.0, 0.0))
        return ca.horzcat(*(work_side.into(*tool_side.carried(ca.SX.zeros(3), one))[1] for one in directions))

    def _along_linear(self, tip: Any) -> Any:
        """Return a point of the work frame as positions of the linear axes at rotary zero, for a tool of no length."""
        n = ca.SX.sym("n", len(self.machine.axes))
        start, _ = self._tip_and_axis(n, None, ca.SX.zeros(3))
        at_zero = ca.Function("at_zero", [n], [start, ca.jacobian(start, n)[:, list(self.machine.linear)]])
        place, by = at_zero(np.zeros(len(self.machine.axes)))
        return ca.DM(np.linalg.inv(np.array(by))) @ (tip - place)


def _damped(a: Any, b: Any, damping: Damping) -> Any:
    """Return Aᵀ(A Aᵀ + λ²)⁻¹ b, the damped solution of A x = b, for A (2, 1) or (2, 2)."""
    squares = ca.sumsqr(a)
    if a.shape[1] == 1:
        return a.T @ b / (squares + _square_of_damping(squares, damping))
    determinant = a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
    smaller = 0.5 * (squares - ca.sqrt(ca.fmax(squares * squares - 4.0 * determinant * determinant, 0.0)))
    matrix = a @ a.T + _square_of_damping(smaller, damping) * ca.SX.eye(2)
    adjugate = ca.vertcat(ca.horzcat(matrix[1, 1], -matrix[0, 1]), ca.horzcat(-matrix[1, 0], matrix[0, 0]))
    return a.T @ (adjugate @ b) / (matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0])


def _square_of_damping(smaller: Any, damping: Damping) -> Any:
    """Return λ² at the square of the smaller singular value."""
    share = ca.fmax(1.0 - smaller / damping.region**2, 0.0)
    return damping.factor**2 * share * share


# --- The C file, and the component that supplies its temperatures ---------------------------------

NAME: Final = "twinkins"
"""Name of the module and prefix of its pins."""
COMPONENT: Final = "twinlive"
"""Name of the component that supplies the temperatures, and prefix of its pins."""
FORMAT: Final = LIVE_FORMATS[0]
LETTERS: Final = "XYZABCUVW"
"""Words of a pose, in the order of LinuxCNC's ``EmcPose``."""
ENDLESS: Final = 1e30
REVERSAL_MM: Final = 0.001
"""Way back after which an axis counts as approaching from the other side, mm or degrees."""


@final
@dataclass(frozen=True)
class SuppliedChannel:
    """A channel that the control supplies."""

    name: str  # as effects use it: ``T_X_degC``, ``spindle_rpm``, ``time_s``, ``load_kg``
    pin: str  # name of the pin, without the prefix
    unit: str  # of the pin
    start: float  # value while nothing is connected
    low: float  # low, high: of a value beyond, the last one within is used, and the pin ``out-of-range`` reports it
    high: float
    rate: float  # largest change per second while the correction is on: a sensor that fails must not make the axes jump


def channel_of(name: str) -> SuppliedChannel:
    """Return the pin of a channel. Raises `InputError`: a channel that has no pin."""
    if is_temperature(name):
        return SuppliedChannel(name, f"temperature-{sensor_of(name)}", "degC", 20.0, 0.0, 60.0, 0.2)
    known = {
        SPEED: SuppliedChannel(name, "spindle-speed", "1/min", 0.0, 0.0, 1e6, 1e6),
        TIME: SuppliedChannel(name, "time", "s since the start of the measurement's clock", 0.0, 0.0, 1e8, 1e8),
        LOAD: SuppliedChannel(name, "load", "kg", 0.0, 0.0, 1e5, 50.0),
    }
    if name not in known:
        raise InputError(
            "an error depends on a channel for which the module has no pin",
            expected="temperatures, spindle_rpm, time_s, load_kg",
            value=name,
        )
    return known[name]


def channels_of(live: LiveCorrection) -> tuple[SuppliedChannel, ...]:
    """Return the pins that a correction needs, with the ranges over which all errors are known; `InputError` if a channel has none."""
    found = []
    for one in map(channel_of, live.plain):
        low, high = live.range_of(one.name, one.low, one.high)
        found.append(replace(one, low=low, high=high, start=min(max(one.start, low), high)))
    return tuple(found)


def c_file(live: LiveCorrection, largest: np.ndarray, header: Sequence[str]) -> str:
    """Return the C file; ``largest``: (axes,) bound of the correction of every axis, metres and radians."""
    own = resources.files("twin.compensation.live").joinpath("module.c").read_text(encoding="utf-8")
    comment = ["/*", *(f" * {line.replace('*/', '* /')}".rstrip() for line in header), " */"]
    return "\n".join([*comment, _numbers(live, largest), _generated(live), own])


def component_file(live: LiveCorrection, header: Sequence[str]) -> str:
    """Return the HAL component in Python that supplies the temperatures and writes the record; ``header``: lines of its comment."""
    own = resources.files("twin.compensation.live").joinpath("twinlive.txt").read_text(encoding="utf-8")
    sensors = {sensor_of(one.name): (one.pin, one.low, one.high) for one in temperatures_of(live)}
    numbers = {
        "MACHINE": live.machine.name,
        "KINEMATICS": NAME,
        "RECORD_OF": RECORD_OF_CONTROL,
        "AXES": [(axis.name, "mm" if axis.linear else "deg") for axis in live.machine.axes],
        "SENSORS": sensors,
    }
    comment = ["#!/usr/bin/python3", *(f"# {line}".rstrip() for line in header)]
    return "\n".join([*comment, *(f"{name} = {value!r}" for name, value in numbers.items()), own])


def temperatures_of(live: LiveCorrection) -> tuple[SuppliedChannel, ...]:
    """Return the pins that hold temperatures."""
    return tuple(one for one in channels_of(live) if is_temperature(one.name))


def _generated(live: LiveCorrection) -> str:
    generator = ca.CodeGenerator("generated.c", {"with_header": False, "casadi_real": "double"})
    for function in (live.correction, live.to_workpiece, live.to_axes, live.drives):
        generator.add(function)
    with scratch_folder() as folder:
        generator.generate(f"{folder}/")
        return Path(folder, "generated.c").read_text(encoding="utf-8")


def _numbers(live: LiveCorrection, largest: np.ndarray) -> str:
    machine, channels = live.machine, channels_of(live)
    low, high = np.clip(live.domains, -ENDLESS, ENDLESS).T
    of_channels, pins = ("CHANNELS + 1",), ", ".join([*(f'"{one.pin}"' for one in channels), "0"])
    lines = [
        f'#define NAME "{NAME}"',
        f"#define AXES {len(machine.axes)}",
        f"#define CHANNELS {len(channels)}",
        f"#define HISTORIES {len(live.lags)}",
        "/* All numbers in metres and radians but where a unit is given. */",
        _array("int", "WORD", "AXES", (LETTERS.index(axis.name) for axis in machine.axes)),
        _array("int", "LINEAR", "3", machine.linear),
        _array("double", "SCALE", "AXES", machine.scale),
        _array("double", "LARGEST", "AXES", largest),
        _array("double", "DOMAIN_LOW", "AXES", low),
        _array("double", "DOMAIN_HIGH", "AXES", high),
        _array("double", "REVERSAL_DISTANCE", "AXES", (REVERSAL_MM for _ in machine.axes), "mm, degrees"),
        _array("double", "CHANNEL_LOW", *of_channels, (*(one.low for one in channels), 0.0)),
        _array("double", "CHANNEL_HIGH", *of_channels, (*(one.high for one in channels), 0.0)),
        _array("double", "CHANNEL_RATE", *of_channels, (*(one.rate for one in channels), 0.0), "per second"),
        _array("double", "CHANNEL_START", *of_channels, (*(one.start for one in channels), 0.0)),
        _array("int", "HISTORY_SETTLED", "HISTORIES + 1", (*(one.starts_settled for one in live.lags), 0)),
        _array("double", "HISTORY_CONSTANT", "HISTORIES + 1", (*(one.time_constant for one in live.lags), 1.0), "s"),
        f"static const char *const CHANNEL_NAME[CHANNELS + 1] = {{{pins}}};",
    ]
    return "\n".join(lines) + "\n"


def _array(kind: str, name: str, size: str, values: Iterable[float], unit: str = "") -> str:
    numbers = ", ".join(str(int(value)) if kind == "int" else repr(float(value)) for value in values)
    return f"static const {kind} {name}[{size}] = {{{numbers}}};{f'  /* {unit} */' if unit else ''}"
