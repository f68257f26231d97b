"""Sample data that come with `twin`, and the scripts that made them."""

from pathlib import Path
from typing import Final

PLANS: Final = (Path(__file__).parent / "thesis_plan.csv",)
"""Measurement plans that are found by their bare name."""
RECORDS: Final = tuple(Path(__file__).parent / name for name in ("warm_up.csv", "warm_up_later.csv"))
"""Records of a machine that warms up (simulated), fitted and later, that are found by their bare name."""
TABLES: Final = (Path(__file__).parent / "shop_table.csv",)
"""Tables of other programs that are found by their bare name."""
PARTS: Final = ("circle_diamond_square", "hemisphere", "plate_of_holes", "cone_frustum")
"""Names of the programs of test parts (``.nc``) and of the files of their features (``.part.yaml``)."""
