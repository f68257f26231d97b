"""What every package needs: errors with their place, files written whole, units, read-only arrays, distributions, threads."""
