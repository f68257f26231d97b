"""Specification of a control's measuring programs, and the steps that every program consists of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from textwrap import wrap
from typing import Final, Literal, final

import numpy as np

from twin.machine.machine import Machine

PROBING_FEED: Final = 200.0
"""Feed of a contact, mm/min."""
APPROACH_FEED: Final = 3000.0
"""Feed next to the sphere, mm/min."""
WIDTH: Final = 72
"""Characters per line of comment."""


@final
@dataclass(frozen=True)
class ProgramStep:
    """One step of a measuring program."""

    # ``rapid``, ``feed``, ``probe`` (towards the sphere until contact); or without motion ``dwell``, ``spindle``, ``read`` (a reading
    # is due) and ``stop`` (until the operator continues)
    kind: Literal["rapid", "feed", "probe", "dwell", "spindle", "read", "stop"]
    position: np.ndarray  # (axes,) end position, mm and degrees; of a probing move the end of the search
    pose: int  # number of the pose, from 1
    contact: int = 0  # number of the contact, from 1; 0 for other steps
    # (3,) unit vector of a probing move along the linear axes in command order; zero for others
    direction: tuple[float, float, float] = (0.0, 0.0, 0.0)
    distance_mm: float = 0.0  # length of a probing move along it; 0 for others
    feed: float = APPROACH_FEED  # of a feed move, mm/min or degrees/min
    seconds: float = 0.0  # of a dwell
    rpm: float = 0.0  # new spindle speed; 0 stops it
    text: str = ""  # what the operator must know at a reading or a stop

    @property
    def moves(self) -> bool:
        """Whether it is a motion."""
        return self.kind in ("rapid", "feed", "probe")


@final
@dataclass(frozen=True)
class ProgramSteps:
    """Steps of a measuring program."""

    machine: Machine
    steps: tuple[ProgramStep, ...]  # the steps in order; the first come from an unknown position
    poses: int  # number of poses that are probed
    skipped: tuple[int, ...]  # numbers of the poses of the plan to which no path with clearance was found
    header: tuple[str, ...]  # comments, in words
    spheres: tuple[str, ...]  # names of the spheres, for the poses of the plan in order
    radii_mm: tuple[float, float]  # radius of the sphere and of the stylus ball
    tip_mm: tuple[float, float, float]  # (3,) the tip, from the spindle nose in the frame of the tool
    probing: bool = True  # whether there are contacts, which are logged

    @property
    def linear_names(self) -> tuple[str, ...]:
        """Names of the linear axes in command order."""
        return tuple(self.machine.axes[i].name for i in self.machine.linear)

    def convert(self, log: str, form: str) -> str:
        """Return the comment that says how the log becomes a measurement table, and that a calibration."""
        tip = ",".join(f"{value:g}" for value in self.tip_mm)
        return (
            f"The log becomes a measurement table with: twin convert {log} --format {form} --contacts 5 -o measured.csv - with "
            f"--tip {tip} if the tip is calibrated, with its own values: positions of the rotary axes need it. "
            "Then: twin identify measured.csv -o mine.yaml --only E_*0*"
        )

    def comments(self, *more: str) -> list[str]:
        """Return the lines of the header, wrapped."""
        return [line for text in (*self.header, *more) for line in wrap(ascii_text(text), WIDTH)]


@final
@dataclass(frozen=True)
class ProgramFormat:
    """A control's language of measuring programs."""

    name: str  # identifier
    title: str  # name of the control
    suffixes: tuple[str, ...]  # suffixes of the file name that select it
    source: str  # where the statements come from
    unverified: str  # what was not verified
    write: Callable[[ProgramSteps, str], str]  # function that returns the program's text from its steps and its name


class AxisWordsWriter:
    """Axis words of the axes whose written value changes; ``form``: function that returns a word from name and number."""

    def __init__(self, machine: Machine, form: Callable[[str, str], str]) -> None:
        self.machine = machine
        self.form = form
        self._last: dict[str, str] = {}

    def words(self, position: np.ndarray, *, remember: bool = True) -> list[str]:
        """Return the words of a position; it counts as reached only if ``remember``."""
        words = []
        for axis, value in zip(self.machine.axes, position, strict=True):
            if not np.isfinite(value):
                continue
            text = f"{value:.3f}".replace("-0.000", "0.000")
            if self._last.get(axis.name) != text:
                words.append(self.form(axis.name, text))
                if remember:
                    self._last[axis.name] = text
        return words

    def forget(self) -> None:
        """Write all linear axes the next time: after a contact the position is not known."""
        for i in self.machine.linear:
            self._last.pop(self.machine.axes[i].name, None)


def ascii_text(text: str) -> str:
    """Return a text in plain ASCII without brackets and quotes, for a comment in any language."""
    for old, new in (("µ", "u"), ("…", "..."), ("–", "-"), ("−", "-"), ("°", " deg"), (";", ",")):
        text = text.replace(old, new)
    plain = text.translate(str.maketrans("([{}])", "      ", "\"'%"))
    return " ".join(plain.encode("ascii", "replace").decode().split())
