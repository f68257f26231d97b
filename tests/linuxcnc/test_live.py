"""The kinematics module with errors, executed by the control itself.

The control's joints follow the positions by two servo periods, and are smoothed, (x₋₁ + 4x₀ + x₁)/6, by its cubic interpolation
(``cubic.h``): what the axes were told is smoothed in the same way before it is compared.
"""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twin
from tests.linuxcnc.control import LETTERS, Ran, control, needs_linuxcnc, needs_root
from twin.compensation.live.folder import FILES, make, write

pytestmark = [needs_linuxcnc, needs_root, pytest.mark.xdist_group("linuxcnc")]
MODULES = Path("/usr/lib/linuxcnc/modules")
LAG = 2
TOOL = 120.0
HOME = {"X": 250.0, "Y": 225.0, "Z": -100.0, "B": 20.0, "C": 0.0}
ON = [["hal", ["setp", "twinkins.enable", "1"]], ["sleep", 1.3]]


@pytest.fixture(scope="module")
def machine() -> twin.Machine:
    return twin.Machine.load("dmu50")


@pytest.fixture(scope="module")
def errors(machine: twin.Machine) -> twin.Calibration:
    """The bundled errors, and such as depend on the direction, on temperatures and on the spindle."""
    named = {
        "reversal Y": {"size": 9.0},
        "thermal_growth Z by bed": {"coefficient": 12.0},
        "thermal_expansion X": {"coefficient": 9.0},
        "spindle_growth Z": {"amplitude": 20.0, "exponent": 1.5, "time_constant": 2.0, "highest_rpm": 12000.0},
    }
    extra = tuple(twin.effect_named(*name.split(" ", 1), numbers, machine) for name, numbers in named.items())
    return replace(twin.Calibration.default(machine), extra=extra)


@pytest.fixture(scope="module")
def loaded(errors: twin.Calibration, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Return the folder of the module, compiled into the control."""
    folder = tmp_path_factory.mktemp("live")
    write(make(errors, tool_length_mm=TOOL), folder)
    assert {path.name for path in folder.iterdir()} == set(FILES)
    subprocess.run(["halcompile", "--install", "twinkins.c"], cwd=folder, check=True, capture_output=True)
    yield folder
    (MODULES / "twinkins.so").unlink()


def run(folder: Path, tmp_path: Path, machine: twin.Machine, actions: Sequence[Sequence[Any]]) -> Ran:
    signals = [f"twinkins-command-{i}" for i in range(len(machine.names))]
    return control(
        tmp_path,
        machine,
        actions,
        home={name: HOME.get(name, 0.0) for name in machine.names},
        kinematics="twinkins",
        hal=(folder / "twinkins.hal").read_text(),
        pins=[*signals, *(f"axis.{name.lower()}.pos-cmd" for name in machine.names)],
        tools=f"T1 P1 Z{TOOL}\nT2 P2 X3 Y-2 Z80\n",
    )


def told(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return joints and axes (n, axes) at the same time."""
    half = samples.shape[1] // 2
    axes = samples[:-LAG, half:]
    return samples[LAG:, :half][1:-1], (axes[:-2] + 4.0 * axes[1:-1] + axes[2:]) / 6.0


def sides(axes: np.ndarray, back: float = 0.001) -> tuple[np.ndarray, np.ndarray]:
    """Return the sides (n, axes) from which positions are approached, and where all have been the same for longer than a change of sides takes, 0.1 s."""
    found, held = np.zeros(axes.shape), np.zeros(axes.shape)
    for column in range(axes.shape[1]):
        side, mark, since = 0.0, axes[0, column], 0
        for row, value in enumerate(axes[:, column]):
            if (value - mark) * side > 0.0 or (side == 0.0 and abs(value - mark) > back):
                side, mark, since = (side or np.sign(value - mark)), value, (since if side else row)
            elif side and (mark - value) * side > back:
                side, mark, since = -side, value, row
            found[row, column], held[row, column] = side, row - since
    return found, held.min(axis=1) > 110


def off(
    machine: twin.Machine, errors: twin.Calibration, samples: np.ndarray, conditions: twin.Conditions
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return error of the tip (µm) and tilt (µrad) over a motion, and the error without the module.

    Left out: the beginning, where no axis has moved yet, and 0.1 s after every reversal, during which the correction changes sides.
    """
    joints, axes = told(samples)
    approach, settled = sides(axes)
    settled &= np.all(approach != 0.0, axis=1)
    joints, axes, approach = joints[settled], axes[settled], approach[settled]
    real = twin.Kinematics(machine, errors, tool_length_mm=TOOL, conditions=conditions)
    nominal = twin.Kinematics(machine, twin.Calibration.zero(machine), tool_length_mm=TOOL)
    meant, reached, plain = nominal.forward(axes), real.forward(joints, approach), real.forward(axes, approach)
    distances = [1e3 * np.linalg.norm(one.point_mm - meant.point_mm, axis=1) for one in (reached, plain)]
    return distances[0], np.linalg.norm(reached.tilt_urad(meant), axis=1), distances[1]


def test_a_program_in_axis_words_is_cut_right_without_being_compensated(
    loaded: Path, machine: twin.Machine, errors: twin.Calibration, tmp_path: Path
) -> None:
    text = Path(twin.__file__).with_name("samples").joinpath("cone_frustum.nc").read_text()
    lines = [line for line in text.splitlines() if not line.startswith(("%", "O")) and "T1" not in line]
    (tmp_path / "part.ngc").write_text("\n".join(lines) + "\n")
    actions = [
        ["home"],
        ["hal", ["unlinkp", "twinkins.tool-z"]],
        ["hal", ["setp", "twinkins.tool-z", f"{TOOL}"]],
        ["hal", ["setp", "twinkins.temperature-bed", "26"]],
        ["hal", ["setp", "twinkins.temperature-X", "23"]],
        *ON,
        ["record", "part.txt"],
        ["mdi", "G0 X250 Y225 Z-100 B10 C-170"],
        ["program", "part.ngc"],
        ["stop"],
        ["hal", ["getp", "twinkins.out-of-range"]],
        ["hal", ["getp", "twinkins.update.time"]],
        ["hal", ["getp", "servo-thread.time"]],
    ]
    ran = run(loaded, tmp_path, machine, actions)
    conditions = twin.Conditions(temperature_degC={"bed": 26.0, "X": 23.0}, spindle_rpm=0.0, time_s=0.0)
    distance, tilt, plain = off(machine, errors, ran.samples("part.txt"), conditions)
    print(len(distance), np.percentile(distance, [50, 99, 100]), np.percentile(tilt, [50, 99, 100]), plain.mean(), ran.results("hal")[-3:])
    assert len(distance) > 20000 and plain.mean() > 25.0
    assert np.median(distance) < 0.002 and distance.max() < 0.02
