"""Errors that remain with compensation tables in the control, for every format, computed as by ``twin control``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

from twin._common.errors import InputError
from twin._common.json_form import json_form
from twin.control import CorrectedShare, RemainingErrors, Request, account_of, make
from twin.kinematics.forward import Kinematics
from twin.machine.calibration import Calibration
from twin.machine.control import TableSum, table_formats


@final
@dataclass(frozen=True)
class TablesLeft:
    """Errors that remain with the tables of one format.

    Attributes:
        kind: name of the format; only formats with tables of single axes, not the volumetric ones ``isg`` and ``grid``.
        at: positions of the other axes while one moves, by axis; mm, degrees.
        tool_length_mm: tool length for which the tables are made.
        remains: the error at the tool with them.
        carried: every error of the calibration, and the part of it that the format compensates.
    """

    kind: str
    at: Mapping[str, float]
    tool_length_mm: float
    remains: RemainingErrors
    carried: tuple[CorrectedShare, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return the content for JSON."""
        return json_form(self, rename={"kind": "format", "remains": "error_at_tool"}, leave_out=("carried",))


def tables_left(
    real: Kinematics, errors: Calibration, missing: Mapping[str, tuple[str, ...]]
) -> tuple[TablesLeft, ...]:
    """Make the tables of every format and return the remaining errors, the most effective format first.

    The result is empty if the control has tables already, the estimate did not converge or there are no errors. Formats that cannot
    hold tables of this machine are omitted.

    Args:
        real: machine, errors that can be evaluated under the conditions, tool length, conditions.
        errors: the calibration as given.
        missing: effects omitted for want of a channel, by channel.
    """
    if errors.control is not None or not errors.settled or real.calibration.empty:
        return ()
    found: list[TablesLeft] = []
    required = None
    for form in table_formats():
        if form.correction is not TableSum:
            continue
        request = Request(form.name, tool_length_mm=real.tool_length_mm, conditions=real.conditions)
        try:
            made = make(real.machine, real.calibration, request, required)
        except InputError:
            continue
        required = made.required
        account = account_of(made, errors, real.calibration, missing)
        found.append(TablesLeft(form.name, made.required.at, real.tool_length_mm, account.remains, account.carried))
    return tuple(sorted(found, key=lambda one: -one.remains.reduction))
