"""What tables in the machine's control would leave, format by format: the same computation as ``twin control`` prints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

from twin._common.errors import InputError
from twin._common.json_form import json_form
from twin.control import Carried, Remains, Request, account_of, make
from twin.kinematics.forward import Kinematics
from twin.machine.calibration import Calibration
from twin.machine.control import FORMATS, Terms


@final
@dataclass(frozen=True)
class TablesLeft:
    """What the tables of one format leave.

    Attributes:
        kind: the format, one with tables of single axes: the volumetric ones, ``isg`` and ``grid``, are left to ``twin control``.
        at: where the other axes stand while one moves: mm, degrees by axis.
        tool_length_mm: the tool length they are made for.
        remains: the error at the tool with them.
        carried: every error of the calibration, and what the format does with it.
    """

    kind: str
    at: Mapping[str, float]
    tool_length_mm: float
    remains: Remains
    carried: tuple[Carried, ...]

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return json_form(self, rename={"kind": "format", "remains": "error_at_tool"}, leave_out=("carried",))


def tables_left(
    real: Kinematics, errors: Calibration, missing: Mapping[str, tuple[str, ...]]
) -> tuple[TablesLeft, ...]:
    """Make the tables of every format and return what they leave, the best first.

    Nothing where the control has tables already, where the estimate did not converge, and of a format that cannot hold tables of this
    machine.

    Args:
        real: machine, the errors that are known under the conditions, tool length, conditions.
        errors: the calibration as given.
        missing: effects left out for want of a channel.
    """
    if errors.control is not None or not errors.settled or real.calibration.empty:
        return ()
    found = []
    for form in FORMATS:
        if form.correction is not Terms:
            continue
        request = Request(form.name, tool_length_mm=real.tool_length_mm, conditions=real.conditions)
        try:
            made = make(real.machine, real.calibration, request)
        except InputError:
            continue
        account = account_of(made, errors, real.calibration, missing)
        found.append(TablesLeft(form.name, made.required.at, real.tool_length_mm, account.remains, account.carried))
    return tuple(sorted(found, key=lambda one: -one.remains.reduction))
