"""Comparison with other packages in the same run: `tests.benchmarks.peers.run`."""
