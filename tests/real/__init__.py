"""Machines and measurements of others, as `twin` reads them."""

from __future__ import annotations

from pathlib import Path


def write_both(folder: Path, name: str, urdf: str, machine: str) -> Path:
    """A URDF and the machine file beside it, whose path is returned."""
    (folder / f"{name}.urdf").write_text(urdf, encoding="utf-8")
    path = folder / f"{name}.yaml"
    path.write_text(machine, encoding="utf-8")
    return path
