"""Where a reflector really is: on the tool side or on the work side of the machine with errors, in the base frame.

The one prediction that simulating, identifying and diagnosing share.
"""

from __future__ import annotations

from functools import cached_property
from typing import final

import casadi as ca
import numpy as np

from twin.batch import BatchFunction
from twin.calibration import Calibration
from twin.kinematics import Kinematics
from twin.machine import Machine
from twin.measurement import CARRIERS
from twin.symbolic import Pose, frame_pose
from twin.units import MM


@final
class Observation:
    """Reflectors carried by one machine with one calibration.

    Args:
        machine: the machine.
        calibration: its errors.

    A place on the tool side is in the frame of the spindle nose (no tool length), on the work side in the work frame.
    """

    def __init__(self, machine: Machine, calibration: Calibration) -> None:
        self.machine = machine
        self.kinematics = Kinematics(machine, calibration, tool_length_mm=0.0)

    def points_mm(self, positions: np.ndarray, carrier: np.ndarray, places_mm: np.ndarray) -> np.ndarray:
        """Reflectors in the base frame.

        Args:
            positions: (n, axes) commands, mm and degrees.
            carrier: (n,) ``tool`` or ``work``.
            places_mm: (n, 3) place of each reflector on its carrier.

        Returns:
            (n, 3) mm.

        Raises:
            InputError: as `Kinematics.forward`: a position no curve covers.
        """
        q = self.kinematics.check(positions) * self.machine.scale
        points = np.empty((len(q), 3))
        for side in CARRIERS:
            rows = carrier == side
            if np.any(rows):
                (found,) = self._carried[side](q[rows], places_mm[rows] * MM)
                points[rows] = found / MM
        return points

    @cached_property
    def _carried(self) -> dict[str, BatchFunction]:
        frames = {"tool": self.machine.tool_frame, "work": self.machine.work_frame}
        return {side: BatchFunction(self._function(frame)) for side, frame in frames.items()}

    def _function(self, frame: int) -> ca.Function:
        q = ca.SX.sym("q", len(self.machine.axes))
        place = ca.SX.sym("place", 3)
        pose = frame_pose(self.machine, frame, q, self.kinematics.errors(q))
        point = pose.then(Pose(ca.SX.eye(3), place)).translation
        return ca.Function("carried", [q, place], [point])
