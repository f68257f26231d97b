"""Joint tables, compensated programs and live kinematics, executed by the control and compared with each other."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.linuxcnc.control import needs_linuxcnc, needs_root, skip_without_control
from tests.linuxcnc.methods import (
    NAMES,
    compensated,
    errors_um,
    executed,
    off_path_um,
    program,
    subject,
    with_kinematics,
)

pytestmark = [needs_linuxcnc, needs_root]


@pytest.mark.slow  # 2 min each
@pytest.mark.parametrize("name", NAMES)
def test_the_table_of_the_manual(name: str, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    one = subject(name, tmp_path)
    skip_without_control(tmp_path_factory.mktemp("plain"), one.machine)
    for title, (plain, tables, words, live) in errors_um(one, tmp_path).items():
        sizes = [f"{np.median(off):.3g} / {off.max():.3g}" for off in (plain, tables, words, live)]
        print(title, *sizes, sep=" | ")
        assert np.median(plain) > 30.0 and np.median(tables) > 0.5 * np.median(plain)
        assert np.median(words) < 1.0 and words.max() < 6.0
        assert np.median(live) < 0.005 and live.max() < 0.05


def test_a_sample_of_the_table(tmp_path: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    """One line of all axes on a machine with a head, compensated and with live kinematics; its path is that of the words."""
    one = subject(NAMES[1], tmp_path)
    skip_without_control(tmp_path_factory.mktemp("plain"), one.machine)
    name, text = next((name, text) for name, text in one.programs.items() if "across" in name)
    lines = text.splitlines()
    ends = np.array([[float(word[1:]) for word in re.findall(r"[XYZABC][-\d.]+", line)] for line in lines[1:3]])
    # A third of the way takes a third of the time.
    ends[1] = np.round(ends[0] + (ends[1] - ends[0]) / 3.0, 2)
    one = replace(one, programs={name: program(one.machine, ends, "F15000")})
    path = one.tip(np.linspace(*ends, 20001), False)
    folders = [tmp_path_factory.mktemp(name) for name in ("words", "live")]
    (words,) = executed(one, compensated(one, tmp_path), folders[0]).values()
    (live,) = with_kinematics(one, folders[1]).values()
    found = [off_path_um(path, one.tip(q[::3], True)) for q in (words, live)]
    print(*(f"{np.median(off):.3g} / {off.max():.3g}" for off in found), sep=" | ")
    plain = off_path_um(path, one.tip(np.linspace(*ends, 101), True))
    assert min(map(len, found)) > 60 and plain.min() > 10.0
    assert np.median(found[0]) < 1.2 and found[0].max() < 6.0
    assert np.median(found[1]) < 0.01 and found[1].max() < 0.05


@pytest.mark.slow  # half a minute each; `test_machines.py` executes programs with live kinematics in the default run
@pytest.mark.parametrize(("increment", "chord_mm"), [(0.001, 1e-3), (1e-5, 1e-5)])
def test_program_and_kinematics_move_the_motors_alike(
    increment: float, chord_mm: float, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """The same path in the motors, within the rounding of the words and the chords between them, whatever the increment."""
    one = subject(NAMES[2], tmp_path, increment=increment)
    skip_without_control(tmp_path_factory.mktemp("plain"), one.machine)
    one = replace(one, programs={name: text for name, text in one.programs.items() if "pocket" in name})
    folders = [tmp_path_factory.mktemp(name) for name in ("words", "live")]
    (words,) = executed(one, compensated(one, tmp_path, chord_mm), folders[0]).values()
    (live,) = with_kinematics(one, folders[1]).values()
    # Of all words of a line; of an arc its start and its centre as well.
    rounding = 0.5 * increment * (np.sqrt(len(one.machine.axes)) + 2.0 * np.sqrt(2.0)) + chord_mm
    for path, points in ((words, live), (live, words)):
        # The control cuts corners by a sixth of the acceleration times the period squared: 0.02 µm on the arc of 20 mm.
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        off = 1e-3 * off_path_um(path, points[1:-1][np.minimum(steps[1:], steps[:-1]) > 0.02])
        print(f"increment {increment} mm and °: {np.median(off):.2g} median, {off.max():.2g} largest")
        assert len(off) > 2000 and np.median(off) < 0.7 * increment + chord_mm and off.max() < rounding + 3e-5
