"""The machine and its errors: machine file, calibration, error motions, effects, conditions and correction tables of its control."""
