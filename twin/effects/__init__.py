"""What makes a machine differ from its drawing, one small class an effect; a model is an ordered tuple of them."""

from twin.effects.along import PitchError, Reversal, ReversalCurve, ZeroOffset
from twin.effects.base import Effect, Frame, Parameter, assemble, split_name, unit_of
from twin.effects.control import ControlCorrection
from twin.effects.coupled import CrossAxis, Harmonic, TableLoad
from twin.effects.empirical import Empirical
from twin.effects.error_motion import ErrorMotion
from twin.effects.load import GravityCompliance, Payload
from twin.effects.location import AxisLocation
from twin.effects.squareness import Squareness
from twin.effects.thermal import SteadyDrift, ThermalDrift, ThermalExpansion, ThermalGrowth

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
