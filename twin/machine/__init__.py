"""The machine and what is known of it: machine file, calibration, error motions, effects, conditions, tables of its control."""
