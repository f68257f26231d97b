"""The model of a machine: effects, calibration, datum, curves, conditions."""
