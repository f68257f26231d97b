"""The C file of the kinematics module: numbers of a machine and a calibration, the generated functions, and the module's own code."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Sequence
from importlib import resources
from pathlib import Path
from typing import Final

import casadi as ca
import numpy as np

from twin.compensation.live.graph import LiveCorrection

LETTERS: Final = "XYZABCUVW"
"""Words of a pose, in the order of LinuxCNC's ``EmcPose``."""


def c_file(live: LiveCorrection, name: str, header: Sequence[str], largest: np.ndarray) -> str:
    """Return the C file of the module ``name``."""
    own = resources.files("twin.compensation.live").joinpath("module.c").read_text(encoding="utf-8")
    return "\n".join(["/*", *(f" * {line}".rstrip() for line in header), " */", _numbers(live, name, largest), _generated(live), own])


def _generated(live: LiveCorrection) -> str:
    functions = [live.correction, live.to_workpiece, live.to_axes, ca.Function("twin_drives", [ca.SX.sym("c")], [ca.SX(0)])]
    with tempfile.TemporaryDirectory() as folder:
        generator = ca.CodeGenerator("generated.c", {"with_header": False, "casadi_real": "double"})
        for function in functions:
            generator.add(function)
        generator.generate(f"{folder}/")
        return Path(folder, "generated.c").read_text(encoding="utf-8")


def _numbers(live: LiveCorrection, name: str, largest: np.ndarray) -> str:
    machine = live.machine
    low, high = live.domains.T
    lines = [
        f'#define NAME "{name}"',
        f"#define AXES {len(machine.axes)}",
        f"#define CHANNELS {len(live.channels)}",
        "#define HISTORIES 0",
        _array("int", "WORD", "AXES", (LETTERS.index(axis.name) for axis in machine.axes)),
        _array("int", "LINEAR", "3", machine.linear),
        _array("double", "SCALE", "AXES", machine.scale),
        _array("double", "LARGEST", "AXES", largest),
        _array("double", "DOMAIN_LOW", "AXES", np.maximum(low, -1e30)),
        _array("double", "DOMAIN_HIGH", "AXES", np.minimum(high, 1e30)),
        _array("double", "REVERSAL_DISTANCE", "AXES", (0.001 for axis in machine.axes)),
        _array("double", "CHANNEL_LOW", "CHANNELS + 1", (-40.0,)),
        _array("double", "CHANNEL_HIGH", "CHANNELS + 1", (120.0,)),
        _array("double", "CHANNEL_RATE", "CHANNELS + 1", (0.1,)),
        _array("double", "CHANNEL_START", "CHANNELS + 1", (20.0,)),
        'static const char *const CHANNEL_NAME[CHANNELS + 1] = {""};',
        _array("int", "HISTORY_SETTLED", "HISTORIES + 1", (0,)),
        _array("double", "HISTORY_CONSTANT", "HISTORIES + 1", (1.0,)),
    ]
    return "\n".join(lines) + "\n"


def _array(kind: str, name: str, size: str, values: Iterable[float]) -> str:
    return f"static const {kind} {name}[{size}] = {{{', '.join(f'{value!r}' if kind == 'int' else repr(float(value)) for value in values)}}};"
