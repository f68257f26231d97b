"""Benchmark of diagnosis methods: each reads files and writes `diagnosis.json`, which is scored.

Measurements are simulated on truth machines with hidden errors. These are written in plain NumPy, share no code with `twin` and are not
linearised. Every case is a folder with the measurement table and the hidden errors. See `python -m tests.scored_cases --help`.
"""
