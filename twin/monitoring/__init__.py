"""Changes of a machine: two calibrations compared, and short check measurements watched over weeks.

Manuals: `twin doc compare`, `twin doc watch`.
"""

from twin.monitoring.compare import compare
from twin.monitoring.watch import WatchSettings, watch

__all__ = ["WatchSettings", "compare", "watch"]
