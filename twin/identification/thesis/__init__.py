"""The thesis's method, kept as the baseline `twin identify` is compared with."""
