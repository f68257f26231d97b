"""Volumetric compensation inside the control: kinematics with errors, executed by the control in every cycle.

Manual: `twin doc control`.
"""

from twin.compensation.live.folder import (
    LiveKinematics,
    Proof,
    earlier_of,
    errors_while_on,
    held_by_module,
    make_module,
    outputs_of,
    write_module,
)

__all__ = [
    "LiveKinematics",
    "Proof",
    "earlier_of",
    "errors_while_on",
    "held_by_module",
    "make_module",
    "outputs_of",
    "write_module",
]
