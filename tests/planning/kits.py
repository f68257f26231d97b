"""Kits for tests of planning, and one-slide machines for which visibility can be computed by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np

from tests.real import write_both
from tests.truth import hidden
from twin.machine.machine import Machine
from twin.measurement.instruments import Instrument, LaserTracker
from twin.measurement.simulate import Station
from twin.planning.kit import Kit, Seconds, Target

Carrier = Literal["tool", "work"]
SECONDS = Seconds(point=15.0, aim=20.0, target=30.0, station=900.0)
_URDF = """<?xml version="1.0"?>
<robot name="bench">
  <link name="bed">{shape}</link>
  <joint name="slide_joint" type="prismatic">
    <parent link="bed"/><child link="slide"/>
    <axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="0" velocity="1"/>
  </joint>
  <link name="slide">{moving}</link>
</robot>
"""
_MACHINE = """schema: twin.machine/1
name: bench
urdf: bench.urdf
axes:
  - {name: X, joint: slide_joint, kind: linear, range: [-300, 300], increment: 0.001}
frames: {tool: slide, work: bed}
"""


def bench(folder: Path, shape: str = "", moving: str = "") -> Machine:
    """Return a machine with a slide along x, with a shape (URDF ``geometry``) on the bed and another on the slide."""

    def drawn(text: str) -> str:
        return f"<visual>{text}</visual>" if text else ""

    return Machine.load(
        str(write_both(folder, "bench", _URDF.format(shape=drawn(shape), moving=drawn(moving)), _MACHINE))
    )


def kit(
    machine: Machine,
    stations: Mapping[str, Sequence[float]],
    targets: Mapping[str, tuple[Carrier, Sequence[float]]],
    *,
    facing: Sequence[float] | None = None,
    acceptance_deg: float = 30.0,
    known: bool = False,
    instruments: tuple[Instrument, ...] = (LaserTracker(),),
    seconds: Seconds = SECONDS,
    opaque: bool = True,
) -> Kit:
    """Return a kit; stations are origins in mm or rows of `Measurements.station_pose`; ``facing`` None: aimed by hand."""
    poses = {name: np.concatenate([pose, np.zeros(6 - len(pose))]) for name, pose in stations.items()}
    return Kit(
        source="a test",
        instruments=instruments,
        stations=MappingProxyType({name: Station.at(pose) for name, pose in poses.items()}),
        stations_known=frozenset(),
        targets=MappingProxyType(
            {
                name: Target(
                    side,
                    (float(place[0]), float(place[1]), float(place[2])),
                    known,
                    None if facing is None else (float(facing[0]), float(facing[1]), float(facing[2])),
                    float(np.radians(acceptance_deg)),
                )
                for name, (side, place) in targets.items()
            }
        ),
        seconds=seconds,
        speeds=np.array([100.0 if axis.linear else 15.0 for axis in machine.axes]),
        ranges=np.array([[0.0, 360.0] if axis.lower is None else [axis.lower, axis.upper] for axis in machine.axes]),
        opaque=opaque,
    )


def of_hidden(machine: Machine, *, known: bool = False) -> Kit:
    """Return the kit of `tests.truth.hidden`, so that its machine can carry out a plan."""
    return kit(
        machine,
        {name: [*origin, *np.degrees(turn)] for name, (origin, turn) in hidden.STATIONS.items()},
        {name: ("tool" if side == "tool" else "work", place) for name, (side, place) in hidden.TARGETS.items()},
        known=known,
    )


_SLIDES = """<?xml version="1.0"?>
<robot name="slides">
  <link name="bed"/>
  <joint name="x_joint" type="prismatic">
    <parent link="bed"/><child link="carriage"/>
    <axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="0" velocity="1"/>
  </joint>
  <link name="carriage"/>
  <joint name="z_joint" type="prismatic">
    <parent link="carriage"/><child link="ram"/>
    <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="0" velocity="1"/>
  </joint>
  <link name="ram"/>
</robot>
"""
_SLIDES_FILE = """schema: twin.machine/1
name: slides
urdf: slides.urdf
axes:
  - {name: X, joint: x_joint, kind: linear, range: [0, 400], increment: 0.001}
  - {name: Z, joint: z_joint, kind: linear, range: [-300, 0], increment: 0.001}
frames: {tool: ram, work: bed}
"""


def slides(folder: Path) -> tuple[Machine, Kit]:
    """Return a machine with carriage and ram, and a kit with three reflectors and three stations: identified in half a second."""
    machine = Machine.load(str(write_both(folder, "slides", _SLIDES, _SLIDES_FILE)))
    stations = {"front": (200.0, -1800.0, -150.0), "side": (2000.0, -500.0, -100.0), "above": (500.0, -700.0, 1700.0)}
    targets: dict[str, tuple[Carrier, Sequence[float]]] = {
        "T": ("tool", (100.0, 0.0, -40.0)),
        "U": ("tool", (-60.0, 90.0, -120.0)),
        "V": ("tool", (-50.0, -90.0, -60.0)),
    }
    return machine, kit(machine, stations, targets)
