"""Independent tasks on many processes: those of this computer, or a Dask cluster by naming its scheduler."""

from twin.parallel.run import Workers, finished, in_order

__all__ = ["Workers", "finished", "in_order"]
