"""Fast evaluation: CasADi functions run by NumPy or compiled code, many rows per call, and independent tasks in parallel."""
