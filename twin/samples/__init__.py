"""What comes with `twin` to try it on, and the scripts that made it."""

from pathlib import Path
from typing import Final

PLANS: Final = (Path(__file__).parent / "thesis_plan.csv",)
"""Measurement plans, found by their bare name."""
