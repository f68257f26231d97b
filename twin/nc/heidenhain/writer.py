"""Writer of Heidenhain blocks: moves replaced, every other byte kept."""

from __future__ import annotations

from typing import final

from twin.nc.blocks import Kind, Rewrite
from twin.nc.emit import vector_texts
from twin.nc.heidenhain.block import PathBlock
from twin.nc.writer import Edit, Segments, WordWriter

VECTOR_DECIMALS = 7


@final
class HeidenhainWriter(WordWriter[PathBlock]):
    """Writer of a program block by block that keeps track of the values written.

    Args:
        source, axes, newline, style: as for `WordWriter`.

    Attributes:
        inserted: whether lines have been inserted among numbered blocks.
    """

    equals = ""
    signed = True
    inserted = False

    def block(self, block: PathBlock, segments: Segments | None) -> str:
        """Return the output for one block, with its move replaced if there are segments for it."""
        if block.unknown_axes:
            self.said.mark_unknown(block.unknown_axes)
        if block.tcp_switched:
            self._vector_text = None
        lines = [block.text]
        if segments is not None and block.moves:
            if block.words:
                self.lower = block.text[block.words[-1].value_start - 1].islower()
            lines = self.rewritten(block, segments)
            if block.unknown_axes and not block.tcp_switched:
                self.said.mark_unknown(block.unknown_axes)
        elif block.moves:
            self.record(block)
        self.inserted |= block.numbered and len(lines) > 1
        return "".join(lines)

    def _begin(self, block: PathBlock, rewrite: Rewrite, edits: list[Edit]) -> str:
        keyword = block.text[block.head_end : block.keyword_end]
        if rewrite.move.kind is Kind.ARC:
            keyword = "l" if keyword.islower() else "L"
        return keyword

    def _insert(self, block: PathBlock, begin: str, added: list[str], tool: list[str], edits: list[Edit]) -> str:
        text = block.text
        if tool and begin.upper() == "L":  # only LN blocks take a vector
            begin = "ln" if begin.islower() else "LN"
        if block.keyword and begin != text[block.head_end : block.keyword_end]:
            edits.append((block.head_end, block.keyword_end, begin))
        words = " ".join(added + tool)
        if words:
            at = max((word.end for word in block.words), default=block.keyword_end)
            if block.keyword or block.words:
                edits.append((at, at, f" {words}"))
            else:
                edits.append((at, at, f"L {words} "))
            if not block.keyword and block.words:
                edits.append((block.head_end, block.head_end, "L "))  # a paraxial block moves one axis only
        indent = text[: block.head_end] if block.numbered or not text[: block.head_end].strip() else ""
        return f"{indent}{begin if block.keyword else 'L'} "

    def _tails(self, block: PathBlock, rewrite: Rewrite, edits: list[Edit]) -> list[str]:
        return [block.rapid_text] * len(rewrite.positions) if block.rapid_text else []

    def _later(self, block: PathBlock, row: list[float], vector: list[float] | None) -> list[str]:
        words = self._missing(block, row, 0)
        if vector is not None:
            before = self._vector_text
            if block.keyword == "LN":
                self._vector_text = None  # an LN block has its vectors in full
            tool = self._vector(block, vector, None)
            if words or self._vector_text != before:
                words += [*block.normal_text, *tool]
        return words

    def _vector_words(self, vector: list[float]) -> tuple[str, str, str]:
        x, y, z = vector_texts(vector, VECTOR_DECIMALS, True)
        return (x.replace(".", ","), y.replace(".", ","), z.replace(".", ",")) if self.style.comma else (x, y, z)

    def _vector_names(self, block: PathBlock) -> tuple[str, ...]:
        return ("TX", "TY", "TZ")
