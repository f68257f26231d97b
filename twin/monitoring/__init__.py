"""Changes of a machine: two calibrations compared, check measurements watched over weeks, a correction confirmed.

Manuals: `twin doc compare`, `twin doc watch`, `twin doc confirm`.
"""

from twin.monitoring.compare import compare
from twin.monitoring.confirmation import confirm
from twin.monitoring.watch import WatchSettings, watch
from twin.monitoring.written import written_values

__all__ = ["WatchSettings", "compare", "confirm", "watch", "written_values"]
