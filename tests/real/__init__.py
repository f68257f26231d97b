"""Machines and measurements of other authors, converted for `twin`."""

from __future__ import annotations

from pathlib import Path


def write_both(folder: Path, name: str, urdf: str, machine: str) -> Path:
    """Write a URDF and the machine file next to it; return the path of the machine file."""
    (folder / f"{name}.urdf").write_text(urdf, encoding="utf-8")
    path = folder / f"{name}.yaml"
    path.write_text(machine, encoding="utf-8")
    return path
