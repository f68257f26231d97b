"""Effects of ISO blocks on the frame: work offset, tool in the spindle, and the length that the control adds."""

from __future__ import annotations

from typing import Any, Final

from twin.nc.iso import vocabulary
from twin.nc.iso.block import IsoBlock, Item
from twin.nc.modal import Interpreter

_LENGTH_ON: Final = frozenset({"43", "44", "43.4", "43.5", "234"})
_OF_TOOL: Final = frozenset("THD")
TOOL_CHANGE: Final = "M6"


class IsoFrame(Interpreter):
    """Work offset and tool.

    ``T`` selects a tool and ``M6`` puts it into the spindle. Its length acts from ``G43 H`` on (Fanuc, LinuxCNC) until ``G49``, or with
    its cutting edge ``D1`` until ``D0`` (SINUMERIK; for a tool called by name from the tool change on, as its machine data have it by
    default).
    """

    _next_tool = ""
    _length_by_h = _by_name = False

    def choose_offset(self, block: IsoBlock, code: str) -> None:
        """Select a work offset by its G code.

        Raises:
            InputError: ``G58`` and ``G59`` that shift coordinates.
        """
        if code in ("58", "59") and block.items and not any(span.name in "0123" for span in block.codes):
            raise self.error(f"coordinate transformation G{code}", vocabulary.NO_TRANSFORMATION, f"G{code}")
        if code in ("54.1", "154"):
            code += "".join(f" P{item.value.strip()}" for item in block.others if item.name == "P")
        self.select_offset(block, f"G{code}")

    def choose_tool(self, block: IsoBlock, words: frozenset[str]) -> None:
        """Apply the words for tool and length of a block; ``words``: its M words."""
        said = {item.name: item for item in block.others if item.name in _OF_TOOL}
        codes = {span.name for span in block.codes}
        if not (said or codes or words):
            return
        changes: dict[str, Any] = {}
        tool = self.frame.tool if self.tools_known else self._held_tool
        if "T" in said:
            self._next_tool, self._by_name = self._name_of(said["T"]), '"' in said["T"].value
        if TOOL_CHANGE in words:
            if not self._next_tool and self.tools_known:
                raise self.error("tool change without a tool", "T with a number or a name before M6")
            tool = changes["tool"] = self._next_tool or f"of line {self._line + 1}"
            if self._by_name:
                changes["length"] = tool
        changes |= self._length(said, codes, tool)
        if changes and self.tools_known:
            self.select(block, **changes)
        elif changes:
            length = changes.get("length", self._held_length)
            self.hold_tool(block, "" if tool == "0" else tool, "" if length == "0" else length)

    def _length(self, said: dict[str, Item], codes: set[str], tool: str) -> dict[str, str]:
        """Return the change of the length in force, empty if there is none."""
        if "44" in codes and self.tools_known:
            raise self.error("tool length by G44", "G43 with an H word, whose length is in the table of tools")
        height = self._name_of(said["H"]) if "H" in said else None
        in_force = self._length_by_h and (self.frame.length or self._held_length) and "49" not in codes
        if codes & _LENGTH_ON or (in_force and height not in (None, "0")):
            self._length_by_h = True
            if not (height or tool) and self.tools_known:
                raise self.error("tool length without a tool", "G43 with an H word, or a tool change before it")
            return {"length": height or tool}
        if "49" in codes or (self._length_by_h and height == "0"):
            return {"length": ""}
        if "D" in said and not self._length_by_h:
            edge = self._name_of(said["D"])
            return {
                "length": ""
                if edge == "0"
                else tool
                if edge == "1" and (tool or self.tools_known)
                else f"{tool} D{edge}"
            }
        return {}

    def _name_of(self, item: Item) -> str:
        """Return the number or the name of a tool, an offset of its length, or an edge."""
        text = item.value.strip()
        if text.startswith('"'):
            return text.strip('"')
        if not self.tools_known and self.value_of(text) != self.value_of(text):
            return text
        value = self.known_value(item.name, text, "a whole number, or a name in quotes")
        if value < 0 or value != int(value):
            raise self.error(f"{item.name} names no tool", "a whole number, or a name in quotes", text)
        return str(int(value))
