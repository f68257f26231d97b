"""A benchmark of diagnosis for any method: files in, `diagnosis.json` out, scores.

Truth machines in plain numpy, which share no code with `twin` and are not linearised, measure themselves with something hidden in them.
Every case is a folder with the measurement table and what is hidden in it. See `python -m tests.benchmark --help`.
"""
