"""Programs for controls: a touch probe finds the spheres of a plan, or a drift test runs by its schedule."""
