"""Mathematics independent of any machine: rotations, curve bases, covariances, observability."""
