"""Component errors of every axis, for a control that knows the machine."""

from __future__ import annotations

from collections.abc import Callable
from typing import final

import numpy as np

from twin.control.design import URAD_A_UM, WORTH, Acting, Check, Design, Plan, Share, depending, drawn
from twin.control.nodes import at, chosen
from twin.control.request import Request
from twin.control.wanted import Wanted
from twin.machine.control import Curve, TableFormat
from twin.machine.control.curve import period_of
from twin.machine.control.volumetric import AxisErrors, Volumetric, at_rest
from twin.machine.machine import Axis


@final
class ComponentErrors(Design[Volumetric]):
    """What acts in the error frame of every axis, its place and squareness included."""

    correction = Volumetric

    def plan(self, wanted: Wanted, request: Request, old: Volumetric | None) -> Plan[Volumetric]:
        """See `Design.plan`."""
        form, errors, checks = request.form, list[AxisErrors](), list[Check]()
        limit = request.tolerance_um * np.array([1.0] * 3 + [URAD_A_UM] * 3)
        before = {} if old is None else {one.axis: next(iter(one.curves.values())).at for one in old.errors}
        for axis in wanted.machine.axes:
            truth = _truth(wanted, axis)
            low, high = wanted.range_of(axis)
            peaks = np.abs(truth(np.linspace(low, high, 501))).max(axis=0)
            used = [i for i in range(6) if peaks[i] > WORTH * limit[i]]
            if not used:
                continue
            if axis.name in before:
                nodes = at(truth, np.array(before[axis.name]))
            else:
                nodes = chosen(truth, low, high, limit, step=request.step, most=form.points)
            where, period = tuple(nodes.at.tolist()), period_of(axis)
            curves = {i: Curve(axis.name, where, tuple(nodes.values[:, i].tolist()), period) for i in used}
            errors.append(AxisErrors(axis.name, curves))
            q = drawn(where[0], where[-1])
            meant = truth(q)
            checks += [
                Check(
                    float(nodes.off[i]), form.rounding[i // 3], float(limit[i]), _distance(axis.name, i, q, meant[:, i])
                )
                for i in used
            ]
        return Plan(Volumetric(tuple(errors), wanted.machine, wanted.tool_length_mm), tuple(checks))

    def share(self, error: Acting, form: TableFormat[Volumetric], *, products: bool) -> tuple[Share, str]:
        """See `Design.share`."""
        return depending(error.others)


def _distance(axis: str, component: int, q: np.ndarray, truth: np.ndarray) -> Callable[[Volumetric], float]:
    def distance(back: Volumetric) -> float:
        (curve,) = (one.curves[component] for one in back.errors if one.axis == axis)
        return float(np.abs(truth - curve.along(q)).max())

    return distance


def _truth(wanted: Wanted, axis: Axis) -> Callable[[np.ndarray], np.ndarray]:
    """Component errors of an axis at the point the control has them at: (n,) positions → (n, 6) µm and µrad."""
    rest = at_rest(wanted.machine)
    turn, lever = rest.turns[axis.name], rest.centre(axis) - rest.places[axis.name]

    def truth(q: np.ndarray) -> np.ndarray:
        own = wanted.frame_errors(axis, q)
        shift, spin = own[:, :3] @ turn.T, own[:, 3:] @ turn.T
        # µrad times mm are nanometres.
        return np.concatenate([shift + 1e-3 * np.cross(spin, lever), spin], axis=1)

    return truth
