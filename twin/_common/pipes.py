"""Inputs that are no regular files: pipes that another program writes, and devices."""

from __future__ import annotations

import os
import select
from pathlib import Path
from time import monotonic, sleep
from typing import Final

from twin._common.errors import InputError

WRITER_S: Final = 5.0
"""Time to wait for a program that writes to a pipe, s."""


def is_readable_device(path: Path) -> bool:
    """Return whether a character device ends: a terminal, or the empty device."""
    if os.path.samefile(path, os.devnull):
        return True
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
    try:
        return os.isatty(descriptor)
    finally:
        os.close(descriptor)


def read_pipe(path: Path, most_bytes: int) -> bytes:
    """Return all that other programs write to a pipe; wait without limit for what they write, but not for one that writes.

    Args:
        path: the pipe.
        most_bytes: size beyond which it is refused.

    Raises:
        InputError: no program writes to it, or it is too large.
        OSError: it cannot be read.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    data, deadline, seen = bytearray(), monotonic() + WRITER_S, False
    try:
        while len(data) <= most_bytes:
            try:
                block = os.read(descriptor, 1 << 20)
            except BlockingIOError:  # a program has it open and has written nothing yet
                seen = True
                select.select([descriptor], [], [], 1.0)
                continue
            data += block
            seen = seen or bool(block)
            if not block and (seen or monotonic() > deadline):
                break
            if not block:  # no program has it open yet
                sleep(0.02)
    finally:
        os.close(descriptor)
    if not seen:
        raise InputError("a pipe to which no program writes", expected="a file, or a pipe with a writer", file=path)
    if len(data) > most_bytes:
        raise InputError("too large", expected=f"at most {most_bytes >> 20} MB", file=path)
    return bytes(data)
