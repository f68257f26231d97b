"""TLS files for the connection to a cluster."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import final


@final
@dataclass(frozen=True)
class Tls:
    """PEM files with which a Dask scheduler and this computer authenticate each other; the connection is encrypted.

    Attributes:
        ca_file: the certificate authority that signed the scheduler's certificate.
        certificate: of this computer, signed by an authority that the scheduler accepts.
        key: of that certificate; None if the certificate file contains it.
    """

    ca_file: Path
    certificate: Path
    key: Path | None = None
