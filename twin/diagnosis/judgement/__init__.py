"""Conclusions from the selected causes: sizes, alternatives, probabilities, gain, and what to measure next."""
