"""Fit displacements to temperatures and spindle speed over time, and state the expected error of predictions.

Manual: `twin doc thermal`.
"""

from twin.thermal.fit import fit_thermal
from twin.thermal.model import ThermalModel, ThermalPrediction, ThermalTerm, load_model, save_model
from twin.thermal.record import ThermalRecord

__all__ = [
    "ThermalModel",
    "ThermalPrediction",
    "ThermalRecord",
    "ThermalTerm",
    "fit_thermal",
    "load_model",
    "save_model",
]
