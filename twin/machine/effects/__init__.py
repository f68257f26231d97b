"""What makes a machine differ from its drawing, one small class an effect; a model is an ordered tuple of them."""

from twin.machine.effects.along import PitchError, Reversal, ReversalCurve, ZeroOffset
from twin.machine.effects.base import Effect, Frame, Parameter, assemble, split_name, unit_of
from twin.machine.effects.control import ControlCorrection
from twin.machine.effects.coupled import CrossAxis, Harmonic, TableLoad
from twin.machine.effects.empirical import Empirical
from twin.machine.effects.error_motion import ErrorMotion
from twin.machine.effects.load import GravityCompliance, Payload
from twin.machine.effects.location import AxisLocation
from twin.machine.effects.squareness import Squareness
from twin.machine.effects.thermal import SteadyDrift, ThermalDrift, ThermalExpansion, ThermalGrowth

__all__ = [
    "AxisLocation",
    "ControlCorrection",
    "CrossAxis",
    "Effect",
    "Empirical",
    "ErrorMotion",
    "Frame",
    "GravityCompliance",
    "Harmonic",
    "Parameter",
    "Payload",
    "PitchError",
    "Reversal",
    "ReversalCurve",
    "Squareness",
    "SteadyDrift",
    "TableLoad",
    "ThermalDrift",
    "ThermalExpansion",
    "ThermalGrowth",
    "ZeroOffset",
    "assemble",
    "split_name",
    "unit_of",
]
