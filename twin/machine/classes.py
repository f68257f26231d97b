"""Classes of ISO/TR 16907."""

from __future__ import annotations

from typing import Final, Literal, get_args

BasicClass = Literal["L-POS", "L-STR", "L-SQU", "L-ANG", "R-POS", "R-RAX", "R-POR", "R-ANG"]
BASIC: Final[tuple[str, ...]] = get_args(BasicClass)
"""Basic classes: every error motion belongs to exactly one of them."""
COMBINED: Final = {
    "L-VOL": ("L-POS", "L-STR", "L-SQU", "L-ANG"),
    "L-VOL+": ("L-POS", "L-STR", "L-SQU", "L-ANG", "FOR"),
    "R-VOL": ("R-POS", "R-RAX", "R-POR", "R-ANG"),
    "R-VOL+": ("R-POS", "R-RAX", "R-POR", "R-ANG", "FOR"),
}
NAMES: Final = (*BASIC, *COMBINED, "FOR")
