"""How the numbers are reckoned fast: CasADi functions as NumPy or compiled code, points in batches, tasks side by side."""
