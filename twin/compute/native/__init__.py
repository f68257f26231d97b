"""Fast solution on one computer: CasADi functions as straight-line code, compiled to SIMD, or run by NumPy without a compiler.

Manual: `twin doc speed`.
"""
