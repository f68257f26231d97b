"""Error motion of one axis that grows with the position of another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, final

from twin._common.messages import Message
from twin.machine.error_names import DIRECTIONS
from twin.machine.machine import Machine
from twin.model.effects.base import Effect, Frame, Payload, axis_of, direction_of, split_name
from twin.model.effects.specification import EXTENDED, Advice, Drawing, Specification, State, linear_axes


@final
class CrossAxis(Effect):
    """An error motion that grows with another linear axis: e = c·q_axis·q_by (translation), e = c·q_by (rotation), q in m."""

    def __init__(self, name: str, by: str, coefficient: float) -> None:
        self.name = f"cross_axis:{name} by {by}"
        self.by = by
        self.coefficient = coefficient
        self._component, _, self._axis = split_name(name)
        self.frame = Frame(self._axis, "motion")
        self.units = (("coefficient", "um/m2" if self._component < 3 else "urad/m"),)

    def derivatives(self, positions: Mapping[str, Any]) -> tuple[Mapping[int, Any], ...]:
        """See `Effect.derivatives`."""
        other = 1e-3 * positions[self.by]
        return ({self._component: other * 1e-3 * positions[self._axis] if self._component < 3 else other},)


def _make(machine: Machine, where: str, numbers: Mapping[str, float], payloads: Sequence[Payload]) -> CrossAxis:
    name, _, by = where.partition(" by ")
    if name not in machine.motion_names or by not in machine.by_name:
        raise CROSS_AXIS.no_place(machine, where)
    return CrossAxis(name, by, numbers["coefficient"])


def _places(machine: Machine) -> tuple[str, ...]:
    return tuple(
        f"{motion} by {axis}" for motion in machine.motion_names for axis in machine.by_name if axis != motion[3:]
    )


def _candidates(machine: Machine, state: State) -> tuple[list[str], list[tuple[str, str]]]:
    axes = linear_axes(machine)
    return [f"E_{way}{axis} by {by}" for axis in axes for by in axes if by != axis for way in DIRECTIONS], []


def _title(where: str) -> str:
    name, _, by = where.partition(" by ")
    component, _, axis = split_name(name)
    if DIRECTIONS[component] == axis:
        return Message("positioning of {axis} changes with {by}", axis=axis, by=by)
    if component < 3:
        return Message(
            "straightness of {axis} in {direction} changes with {by}", axis=axis, direction=direction_of(name), by=by
        )
    return Message("tilt of {axis} about {direction} changes with {by}", axis=axis, direction=direction_of(name), by=by)


def _is_translation(where: str) -> bool:
    return split_name(where.split(" ")[0])[0] < 3


CROSS_AXIS: Final = Specification(
    name="cross_axis",
    kind="machine",
    title=_title,
    family="errors of one axis that change with the position of another",
    advice=Advice(
        "Service: preload and wear of the guideways of both axes, levelling, overhang at the ends of the travel.",
        f"{EXTENDED}.",
        "Do not correct one axis by itself: the correction would be right at only one position of the other axis.",
    ),
    evidence=lambda fit: Message("the error of one axis grows with the position of another"),
    parameters=("coefficient",),
    # 10 mrad per metre: a guideway that turns by more over the travel of another axis jams. For a translation, µm/m² is µrad/m.
    limits={"um/m2": 10_000.0, "urad/m": 10_000.0},
    places=_places,
    open_places=True,
    expected=lambda machine: "an error motion and an axis, such as E_ZY by Z",
    make=_make,
    candidates=_candidates,
    drawing=Drawing(
        # A translation is plotted against its own axis (at three positions of the other), a rotation against the other.
        columns=lambda where: (axis_of(where) if _is_translation(where) else where.partition(" by ")[2],),
        split=lambda where: where.split(" by ")[1] if _is_translation(where) else "",
        spread=True,
    ),
)
