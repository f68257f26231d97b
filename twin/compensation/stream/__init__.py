"""Compensation of programs of any length in bounded memory."""

from twin.compensation.stream.streamed import Streamed

__all__ = ["Streamed"]
