"""Measurements: the measurement table, models of instruments, simulated readings, and the evaluations of ISO 230."""
