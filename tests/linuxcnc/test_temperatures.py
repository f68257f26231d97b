"""Temperatures from a file correct the machine while the control runs, and the record of the control comes back."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twin
from tests.linuxcnc.control import control, needs_linuxcnc, needs_root, skip_without_control
from twin.compensation.live import make_module, write_module
from twin.controls.linuxcnc import Ran
from twin.monitoring.record import ControlRecord, state_at

pytestmark = [needs_linuxcnc, needs_root]
MODULES = Path("/usr/lib/linuxcnc/modules")
PLACE = {"X": 300.0, "Y": 225.0, "Z": -100.0, "B": 0.0, "C": 0.0}
BED, SCALE = 12.0, 9.0
"""Growth of the tool side along z, µm/K, and expansion of the scale of X, µm/(m·K)."""
SETTINGS = "[TWIN]\nSENSORS = shop.csv\nRECORD = checks\nCOLUMNS = bed=Bett 1\nSTALE = 3\nEVERY = 1\nHIGH = 50\n"
PINS = ("twinkins.temperature-bed", "twinkins.temperature-X", "twinkins.stale", "twinlive.missing")


@pytest.fixture(scope="module")
def machine() -> twin.Machine:
    return twin.Machine.load("dmu50")


@pytest.fixture(scope="module")
def loaded(machine: twin.Machine, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Return the folder of the module, compiled into the control."""
    skip_without_control(tmp_path_factory.mktemp("plain"), machine)
    named = {"thermal_growth Z by bed": {"coefficient": BED}, "thermal_expansion X": {"coefficient": SCALE}}
    extra = tuple(twin.effect_named(*name.split(" ", 1), numbers, machine) for name, numbers in named.items())
    folder = tmp_path_factory.mktemp("thermal")
    write_module(make_module(replace(twin.Calibration.zero(machine), extra=extra)), folder)
    subprocess.run(["halcompile", "--install", "twinkins.c"], cwd=folder, check=True, capture_output=True)
    yield folder
    (MODULES / "twinkins.so").unlink()


def run(loaded: Path, folder: Path, machine: twin.Machine, actions: Sequence[Sequence[Any]], first: str) -> Ran:
    (folder / "twinlive.py").write_bytes((loaded / "twinlive.py").read_bytes())
    (folder / "shop.csv").write_text(first)
    (folder / "checks").mkdir()
    hal = [(loaded / name).read_text() for name in ("twinkins.hal", "twinlive.hal")]
    return control(
        folder,
        machine,
        actions,
        home=PLACE,
        kinematics="twinkins",
        hal="\n".join(hal).replace("timeout 5", "timeout 2"),
        ini=SETTINGS,
        pins=[f"twinkins-command-{i}" for i in range(len(machine.names))],
    )


def state(seconds: float) -> list[list[Any]]:
    """Wait, then read the pins and the positions."""
    return [["sleep", seconds], *(["hal", ["getp", pin]] for pin in PINS), ["position"]]


def error_um(
    joints: Sequence[float], bed: float, scale: float, axes: Sequence[float] = (*PLACE.values(),)
) -> list[float]:
    """Return the error of the tool along x and z: the joints less the axes, and how far the machine has grown (by hand)."""
    x, z = axes[0], axes[2]
    return [1e3 * (joints[0] - x) + SCALE * (scale - 20.0) * x * 1e-3, 1e3 * (joints[2] - z) + BED * (bed - 20.0)]


@pytest.mark.slow
def test_the_machine_grows_and_the_tool_stays(loaded: Path, machine: twin.Machine, tmp_path: Path) -> None:
    """Without correction, with it, with sensors that fail, without a new row, in order again, and after the component has ended."""
    row = "{};{};{}\n".format
    actions: list[list[Any]] = [["home"], ["write", "shop.csv", row(1, "26,00", "23")], *state(2.5)]
    actions += [["hal", ["setp", "twinkins.fade-rate", "10"]], ["hal", ["setp", "twinkins.enable", "1"]], *state(1.0)]
    for broken in (("", "23,5"), ("26", "85")):
        for _ in range(4):
            actions += [["write", "shop.csv", row(2, *broken)], ["sleep", 1.0]]
        actions += state(0.0)
    actions += state(5.0)
    actions += [["write", "shop.csv", "3;24,5;2"], *state(1.5), ["write", "shop.csv", "4,5\n"]]
    for _ in range(10):
        actions += [["write", "shop.csv", row(4, "24,5", "24,5")], ["sleep", 1.0]]
    actions += [*state(0.0), ["hal", ["stop"]], ["sleep", 3.0], ["hal", ["start"]], ["sleep", 2.0]]
    actions += [["hal", ["unloadusr", "twinlive"]], *state(4.0)[:4], state(0.0)[-1]]
    began = datetime.now()
    ran = run(loaded, tmp_path, machine, actions, "# logger\nNr;Bett 1;T_X_degC\n")
    pins = [text for text in ran.results("hal") if text]
    found = [pins[i : i + len(PINS)] for i in range(0, len(pins), len(PINS))]
    joints = [one["joints"] for one in ran.results("position")]
    before, on, no_bed, no_scale, silent, begun, again, dead = (np.array(one) for one in joints)
    assert found[:2] == [["26", "23", "FALSE", "0"]] * 2
    assert error_um(before, 26.0, 23.0) == pytest.approx([8.1, 72.0], abs=1e-3)
    assert error_um(on, 26.0, 23.0) == pytest.approx([0.0, 0.0], abs=0.01)
    # A sensor without a value keeps the last one, with a message; the other sensor is followed.
    assert found[2] == ["26", "23.5", "TRUE", "1"] and found[3] == ["26", "23.5", "TRUE", "1"]
    for one in (no_bed, no_scale, silent, begun):
        assert error_um(one, 26.0, 23.5) == pytest.approx([0.0, 0.0], abs=0.01)
    assert found[4] == found[5] == ["26", "23.5", "TRUE", "2"], "a line that is begun is no row"
    assert found[6] == ["24.5", "24.5", "FALSE", "0"]
    assert error_um(again, 24.5, 24.5) == pytest.approx([0.0, 0.0], abs=0.01)
    assert found[7] == ["24.5", "24.5", "TRUE"], "the module itself notices that the component has ended"
    assert error_um(dead, 24.5, 24.5) == pytest.approx([0.0, 0.0], abs=0.01)
    said = "\n".join(ran.said)
    for text in (
        "sensor bed: no number: ''; bed held at 26.0 degrees C",
        "sensor X: 85 is outside 0 to 50 degrees C; X held at 23.5 degrees C",
        "sensor bed: shop.csv: no new row for",
        "sensor bed, sensor X: in order again",
        "control: the servo thread does not run",
    ):
        assert text in said, text
    check_record(tmp_path / "checks", began)


def check_record(folder: Path, began: datetime) -> None:
    """The record of the control, read back as `twin watch` does."""
    (path,) = folder.iterdir()
    assert path.name == f"control_{began:%Y-%m-%d}.csv" and path.read_text().endswith("stopped\n")
    record = ControlRecord.load(path)
    assert abs((record.begin.replace(tzinfo=None) - began).total_seconds()) < 15.0
    whole = state_at([path], began, timedelta(minutes=2), utc=False)
    assert whole is not None and whole.on > 0.7 and 0.2 < whole.stale < 0.8
    assert whole.lowest_degC == {"bed": 24.5, "X": 23.0} and whole.highest_degC == {"bed": 26.0, "X": 24.5}
    rows = [line.split(",") for line in path.read_text().splitlines() if line[:1].isdigit()]
    assert [float(cell) for cell in rows[-1][1:6]] == list(PLACE.values()), "where the axes are meant to be"
    header = next(line for line in path.read_text().splitlines() if line.startswith("time_s")).split(",")
    last = dict(zip(header, rows[-1], strict=True))
    assert float(last["correction_Z_mm"]) == pytest.approx(-1e-3 * BED * 4.5, abs=2e-5)


def test_it_is_switched_on_by_homing(loaded: Path, machine: twin.Machine, tmp_path: Path) -> None:
    """As README.txt says, in place of the last line of the HAL file."""
    assert "net twinkins-homed motion.is-all-homed => twinkins.enable" in (loaded / "README.txt").read_text()
    (tmp_path / "live").mkdir()
    for name in ("twinkins.hal", "twinlive.hal", "twinlive.py"):
        text = (loaded / name).read_text()
        new = text.replace("setp twinkins.enable 0", "net twinkins-homed motion.is-all-homed => twinkins.enable")
        assert (new != text) == (name == "twinkins.hal")
        (tmp_path / "live" / name).write_text(new)
    ran = run(
        tmp_path / "live",
        tmp_path,
        machine,
        # Until the control has configured its joints, none of them is not homed, and the pin is true; nothing can move then.
        [
            ["sleep", 1.5],
            ["hal", ["getp", "twinkins.enable"]],
            ["home"],
            *state(4.0),
            ["hal", ["getp", "twinkins.fade"]],
        ],
        f"time,Bett 1,X\n{datetime.now().timestamp() + 4.0:.1f},26,23\n",
    )
    assert ran.results("hal")[0] == "FALSE"
    (found,) = ran.results("position")
    # Homing leaves the axes within a micrometre: the correction begins in the cycle in which the joints are still moved by themselves.
    assert np.allclose(np.array(found["axes"])[[0, 1, 2, 4, 5]], list(PLACE.values()), atol=1e-3)
    assert error_um(found["joints"], 26.0, 23.0, found["axes"]) == pytest.approx([0.0, 0.0], abs=0.001)
    assert ran.results("hal")[-1] == "1"
