"""A minimal PNG reader for screenshots: 8 bits per channel, colour, not interlaced."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np


def read_png(path: Path) -> np.ndarray:
    """Return (height, width, 3) of uint8."""
    data = path.read_bytes()
    if data[:8] != b"\x89PNG\r\n\x1a\n":
        raise ValueError(f"{path} is no PNG")
    at, packed, header = 8, b"", None
    while at < len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        kind, body = data[at + 4 : at + 8], data[at + 8 : at + 8 + length]
        header = struct.unpack(">IIBBBBB", body) if kind == b"IHDR" else header
        packed += body if kind == b"IDAT" else b""
        at += 12 + length
    if header is None or header[2:] not in ((8, 2, 0, 0, 0), (8, 6, 0, 0, 0)):
        raise ValueError(f"{path}: a kind of PNG this reader does not know: {header}")
    width, height, channels = header[0], header[1], 3 if header[3] == 2 else 4
    raw = np.frombuffer(zlib.decompress(packed), dtype=np.uint8).reshape(height, 1 + width * channels)
    picture = np.zeros((height, width * channels), dtype=np.uint8)
    above = np.zeros(width * channels, dtype=np.uint8)
    for row, (kind, line) in enumerate(zip(raw[:, 0], raw[:, 1:], strict=True)):
        above = picture[row] = _unfiltered(int(kind), line, above, channels)
    return picture.reshape(height, width, channels)[:, :, :3]


def _unfiltered(kind: int, line: np.ndarray, above: np.ndarray, channels: int) -> np.ndarray:
    if kind == 0:
        return line.copy()
    if kind == 1:
        return np.cumsum(line.reshape(-1, channels), axis=0, dtype=np.uint8).ravel()
    if kind == 2:
        return line + above
    found, up = [int(v) for v in line], [int(v) for v in above]
    for i in range(len(found)):
        left = found[i - channels] if i >= channels else 0
        if kind == 3:
            guess = (left + up[i]) // 2
        else:
            corner = up[i - channels] if i >= channels else 0
            distances = (abs(up[i] - corner), abs(left - corner), abs(left + up[i] - 2 * corner))
            guess = (left, up[i], corner)[distances.index(min(distances))]
        found[i] = (found[i] + guess) & 255
    return np.array(found, dtype=np.uint8)
