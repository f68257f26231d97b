"""Commands of tool-tip words, in closed form, lead the tool tip of the nominal machine to the words."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twin.compensation.programs.words import Setup, Tilt, WordSpace
from twin.machine.machine import Machine


@pytest.mark.parametrize("name", ["dmu50", "trunnion_ac", "xyzbc_trunnion"])
@pytest.mark.parametrize("tilted", [False, True])
@pytest.mark.parametrize("count", [300, 60_000])
def test_the_commands_reach_the_words(name: str, tilted: bool, count: int) -> None:
    machine = Machine.load(name)
    tilt = Tilt(
        Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix(),
        np.array([3.0, -5.0, 7.0]),
        np.array([20.0, 30.0]),
        stays=False,
    )
    setup = Setup(work_offset={machine.names[-1]: 5.0}, work_origin_mm=(1.0, 2.0, 3.0))
    space = WordSpace(machine, setup, 90.0, tilt if tilted else None)
    rng = np.random.default_rng(4)
    words = np.hstack([rng.uniform(-60.0, 60.0, (count, 3)), rng.uniform(-40.0, 80.0, (count, 2))])
    tcp = rng.random(count) < 0.8
    words[rng.random(count) < 0.01, 0] = np.nan
    commands = space.commands(words, tcp)
    tips = np.full(count, True) if tilted else tcp
    known = ~np.isnan(words[:, 0])
    assert (~known).any() and np.isnan(commands[~known & tips]).any(axis=1).all()
    turn, origin = (tilt.rotation, tilt.origin_mm) if tilted else (np.eye(3), np.array([1.0, 2.0, 3.0]))
    reached = space.nominal.forward(commands[known & tips])
    assert np.allclose(reached.point_mm, words[known & tips, :3] @ turn.T + origin, rtol=0.0, atol=1e-9)
    standing = words[:, 3:] + space.offset[3:]
    assert np.allclose(np.sort(commands[:, machine.rotary]), np.sort(standing), rtol=0.0, atol=1e-12)
