"""The DMU 50 with its axes in another order in the machine file: the same machine, with the columns of its commands permuted."""

from __future__ import annotations

from pathlib import Path

from twin.machine.machine import Machine

ORDER = ("C", "Z", "Y", "B", "X")
"""No axis keeps its place, and neither the linear nor the rotary ones keep their order."""


def reordered(folder: Path, order: tuple[str, ...] = ORDER) -> Machine:
    """Return the machine with its axes in another order."""
    source = Machine.load("dmu50")
    lines = source.path.read_text(encoding="utf-8").splitlines()
    of = {line.split("name:")[1].split(",")[0].strip(): line for line in lines if line.startswith("  - {name:")}
    rows = iter(order)
    text = "\n".join(of[next(rows)] if line in of.values() else line for line in lines) + "\n"
    text = text.replace("urdf: dmu50.urdf", f"urdf: {source.urdf}")
    text = text.replace("calibration: dmu50", f"calibration: {source.path.parent / 'dmu50'}")
    path = folder / "reordered.yaml"
    path.write_text(text, encoding="utf-8")
    return Machine.load(path)


def columns(machine: Machine, order: tuple[str, ...] = ORDER) -> list[int]:
    """Return the columns of the original's commands, in the other order."""
    return [machine.names.index(name) for name in order]
