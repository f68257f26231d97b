"""Error at the tool in tool centre point mode: nominal, with the kinematics, with the tables, with a compensated program."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from twin._common.json_form import json_form
from twin.control.remains import PointUncertainty, VolumeError, or_unknown, volume_error
from twin.control.required import RequiredCorrections
from twin.kinematics.forward import Poses
from twin.machine.calibration import Calibration
from twin.machine.control import ControlSection
from twin.uncertainty.at_tool import DEFINITION

BEFORE: Final = "before"
CONSTANTS: Final = "with_kinematics"
TABLES: Final = "with_kinematics_and_tables"
PROGRAM: Final = "with_program"
TITLES: Final = {
    BEFORE: "nominal kinematics in the control",
    CONSTANTS: "with the kinematics",
    TABLES: "with the kinematics and the tables",
    PROGRAM: "and a compensated program, in least increments",
}


@final
@dataclass(frozen=True)
class Stages:
    """Error that remains at the tool after every stage of the correction.

    Attributes:
        poses: number of poses.
        errors: error by stage; the stage of tables is absent without tables, that of the program for a machine that runs none.
        uncertainty: uncertainty of the point, the same in all stages.
    """

    poses: int
    errors: dict[str, VolumeError]
    uncertainty: PointUncertainty

    def to_lines(self) -> list[str]:
        """Return the stages as text, one line each below a header."""
        u = self.uncertainty
        spread = f"{or_unknown(u.rms_um):>11}  {or_unknown(u.max_um):>11}"
        lines = [
            f"Error of the tool centre point in tool centre point mode over the volume ({self.poses} poses), µm",
            f"{'':<52}{'RMS':>9}  {'largest':>9}  {'± U (RMS)':>11}  {'± U (max)':>11}  {'expected RMS':>12}",
        ]
        lines += [
            f"  {TITLES[name]:<50}{one.rms_um:>9.2f}  {one.max_um:>9.2f}  {spread}  {or_unknown(one.expected_rms_um):>12}"
            for name, one in self.errors.items()
        ]
        if not np.isfinite(u.rms_um):
            return [
                *lines,
                "  U is unknown: the calibration gives no uncertainty. The error that really remains may have any size.",
            ]
        lines.append(f"  {DEFINITION}; it comes from the calibration, and no stage reduces it.")
        lines += [f"  {u.unknown_text}"] if u.unknown else []
        if u.without_uncertainty:
            lines.append(f"  U is a lower bound: no uncertainty is given for {' '.join(u.without_uncertainty)}.")
        return lines

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object; unknown numbers are null."""
        return {"poses": self.poses, **json_form(self.errors), "uncertainty": self.uncertainty.to_dict()}


def stages_of(required: RequiredCorrections, known: Calibration, section: ControlSection) -> Stages:
    """Return the error after every stage, from the files in the control as read back.

    Args:
        required: the machine, tool length and conditions.
        known: the errors, without effects whose channel is not given.
        section: kinematics of the control, and tables if there are any.
    """
    machine = required.machine
    alone = ControlSection("uncorrected", (), section.kinematics)
    kinds = {BEFORE: None, CONSTANTS: alone, TABLES: section} if section.tables else {BEFORE: None, CONSTANTS: alone}
    models = {
        name: required.kinematics_with(known.with_control(one).with_transformation()) for name, one in kinds.items()
    }
    at = required.volume
    uncertainty = PointUncertainty.of(models[BEFORE], at.q, at.sides)
    reached = {name: model.forward(at.q, at.sides) for name, model in models.items()}
    errors = {name: volume_error(poses, at.goal, uncertainty) for name, poses in reached.items()}
    if machine.runs_programs:
        last, linear = TABLES if section.tables else CONSTANTS, list(machine.linear)

        def reach(commands: np.ndarray) -> Poses:
            return models[last].forward(commands, at.sides)

        commands, _ = required.corrected_commands(reach, reached[last])
        increments = np.array([machine.axes[i].increment for i in linear])
        commands[:, linear] = np.round(commands[:, linear] / increments) * increments
        errors[PROGRAM] = volume_error(reach(commands), at.goal, uncertainty)
    return Stages(len(at.q), errors, uncertainty)
