"""What makes a machine differ from its drawing, one small class an effect; a model is an ordered tuple of them."""

from twin.effects.base import Effect, Frame, Parameter, assemble, split_name
from twin.effects.error_motion import ErrorMotion
from twin.effects.location import AxisLocation
from twin.effects.squareness import Squareness

__all__ = ["AxisLocation", "Effect", "ErrorMotion", "Frame", "Parameter", "Squareness", "assemble", "split_name"]
