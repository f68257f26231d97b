"""Independent tasks on many processes: on this computer, or on a Dask cluster given by the address of its scheduler.

Manual: `twin doc many`.
"""

from twin.compute.parallel.run import Workers, map_as_completed, map_in_order
from twin.compute.parallel.tls import Tls

__all__ = ["Tls", "Workers", "map_as_completed", "map_in_order"]
