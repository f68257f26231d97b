"""Effects that make a real machine differ from its nominal kinematics, one file per effect; a model is an ordered tuple of effects.

To add an effect, write one file with its class and `Specification` and add it to `twin._common.families.EFFECTS`.
"""

from twin.machine.effects.base import Effect, Frame, Parameter, assemble, summed
from twin.machine.effects.control import ControlCorrection
from twin.machine.effects.cross_axis import CrossAxis
from twin.machine.effects.empirical import Empirical
from twin.machine.effects.entries import MACHINE_EFFECTS
from twin.machine.effects.error_motion import ErrorMotion
from twin.machine.effects.gravity_compliance import GravityCompliance
from twin.machine.effects.harmonic import Harmonic
from twin.machine.effects.location import AxisLocation
from twin.machine.effects.names import split_name, unit_of
from twin.machine.effects.payload import Payload
from twin.machine.effects.pitch_error import PitchError
from twin.machine.effects.reversal import Reversal
from twin.machine.effects.reversal_curve import ReversalCurve
from twin.machine.effects.specification import Specification
from twin.machine.effects.squareness import Squareness
from twin.machine.effects.table_load import TableLoad
from twin.machine.effects.thermal_drift import SteadyDrift, ThermalDrift
from twin.machine.effects.thermal_expansion import ThermalExpansion
from twin.machine.effects.thermal_growth import ThermalGrowth
from twin.machine.effects.zero_offset import ZeroOffset

__all__ = [
    "MACHINE_EFFECTS",
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
    "Specification",
    "Squareness",
    "SteadyDrift",
    "TableLoad",
    "ThermalDrift",
    "ThermalExpansion",
    "ThermalGrowth",
    "ZeroOffset",
    "assemble",
    "split_name",
    "summed",
    "unit_of",
]
