"""Files by which computers of a cluster know each other."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import final


@final
@dataclass(frozen=True)
class Tls:
    """Files (PEM) by which a Dask scheduler and this computer know each other; their connection is encrypted.

    Attributes:
        ca_file: the certificate authority that signed the scheduler's certificate.
        certificate: of this computer, signed by the authority that the scheduler knows.
        key: of that certificate; None where the certificate's file holds it.
    """

    ca_file: Path
    certificate: Path
    key: Path | None = None
