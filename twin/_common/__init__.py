"""Helpers used by every package: errors with file and line, atomic files, units, read-only arrays, distributions, threads."""
