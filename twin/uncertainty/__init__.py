"""Uncertainty of the tool's pose: at given poses, as a budget of contributions, and by Monte Carlo simulation of machines."""
