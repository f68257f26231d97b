"""Handle SIGTERM and SIGHUP like Ctrl-C: remove temporary files and stop child processes."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final, final

NAMES: Final = ("SIGTERM", "SIGHUP")


@final
class Received:
    """The signal that ended the command, if one did."""

    def __init__(self) -> None:
        self.number: int | None = None

    def interrupt(self, number: int, frame: FrameType | None) -> None:
        """Raise KeyboardInterrupt on the first signal; ignore later ones, so that the clean-up completes.

        Raises:
            KeyboardInterrupt: on the first signal.
        """
        if self.number is None:
            self.number = number
            raise KeyboardInterrupt

    @property
    def status(self) -> int:
        """Exit status of an interrupted command: 128 plus the signal's number; that of SIGINT if none was received."""
        return 128 + (signal.SIGINT if self.number is None else self.number)

    @property
    def reason(self) -> str:
        """Reason for the end of the command, in a few words."""
        return "interrupted" if self.number is None else f"ended by {signal.Signals(self.number).name}"


@contextmanager
def as_interrupt() -> Iterator[Received]:
    """Turn the signals into KeyboardInterrupt inside the context; a signal that is ignored, as under nohup, stays ignored."""
    received = Received()
    before = {}
    if threading.current_thread() is threading.main_thread():
        for name in NAMES:
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
                before[number] = signal.signal(number, received.interrupt)
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
