"""The thesis's identification method, kept as the baseline for comparison with `twin identify`."""
