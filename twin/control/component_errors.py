"""Component errors of every axis, for a control that has a kinematic model of the machine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import final

import numpy as np

from twin.control.design import (
    NEGLIGIBLE_SHARE,
    U_EVERY,
    URAD_PER_UM,
    Design,
    ProofOfTables,
    Share,
    Table,
    TablePlan,
    check_positions,
    share_depending_on,
)
from twin.control.nodes import Nodes, choose_nodes, nodes_at
from twin.control.request import Request
from twin.control.required import RequiredCorrections
from twin.machine.classes import BASIC
from twin.machine.control import ControlCurve, TableSummary
from twin.machine.control.curve import period_of
from twin.machine.control.volumetric import AxisErrors, VolumetricCorrection, rest_geometry
from twin.machine.effects import Effect
from twin.machine.error_names import component_names
from twin.machine.machine import Axis


@final
class ComponentErrors(Design[VolumetricCorrection]):
    """Compute the component errors in the error frame of every axis, location errors and squareness included."""

    correction = VolumetricCorrection

    def plan(
        self, required: RequiredCorrections, request: Request, old: VolumetricCorrection | None
    ) -> TablePlan[VolumetricCorrection]:
        """See `Design.plan`."""
        form, planned = request.form, list[tuple[AxisErrors, Nodes, np.ndarray, np.ndarray]]()
        limit = request.tolerance_um * np.array([1.0] * 3 + [URAD_PER_UM] * 3)
        proof = ProofOfTables(required, keep_all=request.unproven)
        before = {} if old is None else {one.axis: next(iter(one.curves.values())).at for one in old.errors}
        for axis in required.machine.axes:
            truth = _required_values(required, axis)
            low, high = required.range_of(axis)
            peaks = np.abs(truth(np.linspace(low, high, 501))).max(axis=0)
            used = [i for i in range(6) if peaks[i] > NEGLIGIBLE_SHARE * limit[i]]
            if not used:
                continue
            if axis.name in before:
                nodes = nodes_at(truth, np.array(before[axis.name]))
            else:
                nodes = choose_nodes(truth, low, high, limit, step=request.step, most=form.points)
            where, period = tuple(nodes.at.tolist()), period_of(axis)
            q = check_positions(where[0], where[-1])
            values, factors = truth(q), _factors(required, axis, q[::U_EVERY])
            contents = [
                TableSummary.over(name, where, 0.0, "um" if i < 3 else "urad")
                for i, name in enumerate(component_names(axis.name))
            ]
            used = [i for i in used if proof.keeps(contents[i], [axis.name], BASIC, values[:, i], factors[:, i])]
            if not used:
                continue
            curves = {i: ControlCurve(axis.name, where, tuple(nodes.values[:, i].tolist()), period) for i in used}
            planned.append((AxisErrors(axis.name, curves), nodes, q, values))
        correction = VolumetricCorrection(tuple(one[0] for one in planned), required.machine, required.tool_length_mm)

        def compared(back: VolumetricCorrection) -> tuple[Table, ...]:
            contents, read = iter(correction.contents()), {one.axis: one.curves for one in back.errors}
            found = []
            for own, nodes, q, meant in planned:
                for i in own.curves:
                    off, back_off = (
                        float(nodes.deviation[i]),
                        float(np.abs(meant[:, i] - read[own.axis][i].along(q)).max()),
                    )
                    found.append(Table(next(contents), off, form.rounding[i // 3], float(limit[i]), back_off))
            return tuple(found)

        return TablePlan(correction, compared, unproven=tuple(proof.unproven))

    def share(
        self, required: RequiredCorrections, effect: Effect, others: Sequence[Axis], request: Request
    ) -> tuple[Share, str]:
        """See `Design.share`."""
        return share_depending_on(others)


def _required_values(required: RequiredCorrections, axis: Axis) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function of an axis's component errors at the control's reference point: (n,) positions → (n, 6) µm and µrad."""
    rest = rest_geometry(required.machine)
    turn, lever = rest.turns[axis.name], rest.centre(axis) - rest.places[axis.name]

    def truth(q: np.ndarray) -> np.ndarray:
        own = required.frame_errors(axis, q)
        shift, spin = own[:, :3] @ turn.T, own[:, 3:] @ turn.T
        # µrad times mm is nm.
        return np.concatenate([shift + 1e-3 * np.cross(spin, lever), spin], axis=1)

    return truth


def _factors(required: RequiredCorrections, axis: Axis, q: np.ndarray) -> np.ndarray:
    """Return the factor (n, 6, r) of the covariance of the component errors of `_required_values`."""
    rest = rest_geometry(required.machine)
    turn, lever = rest.turns[axis.name], rest.centre(axis) - rest.places[axis.name]
    own = required.frame_error_factors(axis, q)
    shift, spin = (np.einsum("ij,njr->nir", turn, part) for part in (own[:, :3], own[:, 3:]))
    # µrad times mm is nm.
    across = 1e-3 * np.cross(spin.transpose(0, 2, 1), lever).transpose(0, 2, 1)
    return np.concatenate([shift + across, spin], axis=1)
