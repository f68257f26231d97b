"""ISO 230-1 names of error motions, squareness and location: their parts, units and descriptions."""

from __future__ import annotations

from twin.machine.error_names import DIRECTIONS


def split_name(name: str) -> tuple[int, bool, str]:
    """Split an ISO 230-1 name: component index in ``XYZABC``, whether it describes the average line, axis name.

    ``E_C0Y`` → (5, True, "Y"); ``E_XX`` → (0, False, "X").
    """
    rest = name.removeprefix("E_")
    average = rest[1] == "0"
    return DIRECTIONS.index(rest[0]), average, rest[2:] if average else rest[1:]


def unit_of(name: str) -> str:
    """Return the unit of an ISO 230-1 name: ``um`` for a translation, ``urad`` for a rotation."""
    return "um" if split_name(name)[0] < 3 else "urad"


def axis_of(where: str) -> str:
    """Return the axis of a place, or the place itself if it has none: ``E_ZY by Z`` → Y."""
    first = where.split(" ")[0]
    return split_name(first)[2] if first.startswith("E_") else first


def direction_of(name: str) -> str:
    """Return the direction along or about which an ISO 230-1 name acts: x, y or z."""
    return "xyz"[split_name(name)[0] % 3]


def motion_in_words(name: str) -> str:
    """Describe an error motion in words: ``E_ZY`` → error of Y in z; ``E_BX`` → tilt of X about y."""
    component, average, axis = split_name(name)
    direction = direction_of(name)
    if average:
        return (
            f"axis of {axis} displaced along {direction}"
            if component < 3
            else f"axis of {axis} tilted about {direction}"
        )
    if DIRECTIONS[component] == axis:
        return f"position of {axis}" if component < 3 else f"angle of {axis}"
    return f"error of {axis} in {direction}" if component < 3 else f"tilt of {axis} about {direction}"
