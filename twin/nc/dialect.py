"""What the dialects share: bytes to lines, and a short way for plain blocks beside the general one."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable

from twin.nc.blocks import AxisWords, Dialect, Program, Reading, Rewrite
from twin.nc.text import read_lines


class TextDialect(Dialect):
    """A dialect of lines of text, most of them plain (`twin.nc.plain`)."""

    def read(self, data: bytes, source: str) -> Program:
        """Split bytes into lines; see `Dialect.read`."""
        return read_lines(data, source, self.name)

    def moves(self, program: Program, axes: AxisWords, *, tcp: bool) -> Reading:
        """Interpret a program; see `Dialect.moves`."""
        return self._moves(program, axes, tcp=tcp)

    def rewrite(self, program: Program, axes: AxisWords, reading: Reading, rewrites: Iterable[Rewrite]) -> str:
        """The text with moves replaced; see `Dialect.rewrite`."""
        return self._rewrite(program, axes, reading, rewrites)

    @abstractmethod
    def _moves(self, program: Program, axes: AxisWords, *, tcp: bool, short_way: bool = True) -> Reading:
        """As `moves`; tests read every block the general way and compare."""

    @abstractmethod
    def _rewrite(
        self,
        program: Program,
        axes: AxisWords,
        reading: Reading,
        rewrites: Iterable[Rewrite],
        *,
        short_way: bool = True,
    ) -> str:
        """As `rewrite`; tests write every block the general way and compare."""
