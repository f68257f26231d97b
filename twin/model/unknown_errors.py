"""Errors of a calibration that are not known, as effects with a prior.

An error that the readings did not determine is not zero. If the estimate kept it, because other errors refer to it, the covariance of
the calibration contains its prior already, with all correlations: what the readings did determine stays determined, and a combination
that moves no tool contributes nothing. If the estimate left it out, no other number of the calibration depends on it
(`twin.identification.unidentified`): it is independent of them, with mean zero and the plausible size of the machine file as standard
deviation. An unknown error motion has that standard deviation at every position of its axis.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Final, final

import casadi as ca
import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.messages import Message
from twin._common.provenance import NOMINAL_KINEMATICS, SourceWarning
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.calibration_file import UnidentifiedEntry
from twin.model.effects import AxisLocation, Effect, ErrorMotion, Squareness, assemble, split_name, summed
from twin.numerics.covariance import Covariance
from twin.numerics.curves import basis_named

NO_REFERENCE: Final = Message("the motions of the other axes, its reference, are not in these data")


def at_rest(axis: str) -> str:
    """Return the reason why no error of an axis was determined by readings during which it did not move."""
    return Message("{axis} did not move", axis=axis)


def not_measured(
    machine: Machine, measured: Collection[str], moved: Collection[str], why: str
) -> tuple[UnidentifiedEntry, ...]:
    """Return all errors of a machine that a method does not measure; ``why`` is the reason for those of axes that moved."""
    return tuple(
        UnidentifiedEntry(name=name, why=why if (axis := split_name(name)[2]) in moved else at_rest(axis))
        for name in (*machine.motion_names, *machine.squareness_names, *machine.location_names)
        if name not in measured
    )


def unknown_effects(calibration: Calibration) -> tuple[Effect, ...]:
    """Return an effect for every error of ``not_identifiable`` that the calibration's covariance does not contain.

    Its value is that of the calibration, or zero, and its first parameter stands for the unknown.
    """
    known = {name.partition("[")[0] for name in calibration.covariance.names}
    return tuple(
        _effect(error.name, calibration.machine) for error in calibration.not_identifiable if error.name not in known
    )


def prior_covariance(calibration: Calibration) -> Covariance:
    """Return the covariance of the parameters of `unknown_effects`: independent, the plausible sizes of the machine file."""
    effects = unknown_effects(calibration)
    sizes = [calibration.machine.plausible(effect.name) for effect in effects]
    names = tuple(effect.parameters[0].name for effect in effects)
    return Covariance(names, read_only(np.diag(np.square(sizes)) if sizes else np.zeros((0, 0))))


def _effect(name: str, machine: Machine) -> Effect:
    if name in machine.squareness_names:
        return Squareness(name, 0.0, machine.by_name[split_name(name)[2]])
    if name in machine.location_names:
        return AxisLocation(name, 0.0)
    axis = machine.by_name[split_name(name)[2]]
    return ErrorMotion(name, basis_named("power")(()), axis.domain, (0.0,), wrapped=axis.lower is None)


def nominal_locations(errors: Calibration) -> tuple[SourceWarning, ...]:
    """Return a warning of the locations that were not identified: kinematics hold the nominal value of each, or one that is a guess."""
    unknown = {error.name for error in errors.not_identifiable} | (set(errors.not_estimated) - set(errors.location))
    names = [name for name in errors.machine.location_names if name in unknown]
    return (NOMINAL_KINEMATICS.about(names),) if names else ()


def check_locations_identified(errors: Calibration) -> None:
    """Raise `InputError` if a location was not identified: the file would overwrite what the control's own cycle has calibrated."""
    for warning in nominal_locations(errors):
        why = {error.name: error.text for error in errors.not_identifiable}
        reason = why.get(warning.errors[0], "it was left out of the estimate")
        raise InputError(
            f"{', '.join(warning.errors)} were not identified: kinematics with them would hold values that are not measured",
            expected=f"the location of every rotary axis identified ({warning.errors[0]}: {reason}), or a file not measured in full",
            file=errors.path,
            setting="force",
        )


# --- The errors of a model as one vector, the input of `twin.machine.chain` -----------------------


def error_vector(
    machine: Machine, effects: tuple[Effect, ...], q: Any, channels: Mapping[str, Any] | None = None
) -> Any:
    """Return the errors (6·frames,) of a model at positions ``q`` (metres, radians); ``channels``: numbers or expressions by name."""
    return _vector(assemble(effects, machine.frames, _state(machine, q, channels or {})))


@final
class ErrorTerms:
    """Errors of the effects of a model as expressions, built once for all models that have some of these effects.

    Symbols are the positions ``q`` (axes,) in metres and radians and the ``varying`` channels; the ``constant`` ones are numbers.
    """

    def __init__(
        self, machine: Machine, effects: tuple[Effect, ...], constant: Mapping[str, float], varying: Sequence[str]
    ) -> None:
        self._frames = machine.frames
        self.q, self.channels = ca.SX.sym("q", len(machine.axes)), ca.SX.sym("approach", len(varying))
        named = dict(constant) | dict(zip(varying, ca.vertsplit(self.channels), strict=True))
        state = _state(machine, self.q, named)
        self._terms = [(effect.name, effect.frame, effect.components(state)) for effect in effects]

    def vector(self, names: Collection[str]) -> Any:
        """Return the errors (6·frames,) of the effects of these names."""
        terms = [(frame, components) for name, frame, components in self._terms if name in names]
        return _vector(summed(terms, self._frames))


def _state(machine: Machine, q: Any, channels: Mapping[str, Any]) -> dict[str, Any]:
    return {axis.name: q[i] / axis.scale for i, axis in enumerate(machine.axes)} | dict(channels)


def _vector(frames: list[list[Any]]) -> Any:
    return ca.vertcat(*[component for frame in frames for component in frame])
