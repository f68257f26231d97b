"""A slider for each axis, with the machine in that position and the error at the tool there (ipywidgets)."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from twin.kinematics.forward import Kinematics
from twin.machine.calibration import Calibration
from twin.notebook.optional import optional
from twin.notebook.plots import plot_machine
from twin.uncertainty.at_tool import ToolUncertainty

if TYPE_CHECKING:
    import ipywidgets

TURN_DEG: Final = 360.0


def axis_sliders(kinematics: Kinematics) -> ipywidgets.Box:
    """Return sliders for the axes, with a drawing of the machine and the error at the tool in that position.

    The attribute ``sliders`` of the box holds them by axis name, ``error`` the text below the drawing.

    Args:
        kinematics: the machine with its errors and tool length.

    Raises:
        InputError: ipywidgets or matplotlib is not installed; the URDF has shapes that cannot be drawn.
    """
    widgets = optional("ipywidgets")
    machine = kinematics.machine
    nominal = Kinematics(machine, Calibration.zero(machine), tool_length_mm=kinematics.tool_length_mm)
    uncertainty = ToolUncertainty(kinematics)
    sliders: dict[str, Any] = {}
    for axis, (low, high) in zip(machine.axes, machine.limits / machine.scale[:, None], strict=True):
        low, high = max(low, -TURN_DEG if not axis.linear else low), min(high, TURN_DEG if not axis.linear else high)
        middle = float(np.clip((low + high) / 2.0 if axis.linear else 0.0, low, high))
        unit = "mm" if axis.linear else "°"
        sliders[axis.name] = widgets.FloatSlider(
            value=middle,
            min=float(low),
            max=float(high),
            step=max(axis.increment, 1e-3),
            description=f"{axis.name} / {unit}",
            continuous_update=False,
            readout_format=".3f",
        )
    picture, text = widgets.Image(format="png"), widgets.HTML()

    def show(_: Any = None) -> None:
        position = np.array([sliders[name].value for name in machine.names])
        picture.value = _png(kinematics, position)
        text.value = _error(kinematics, nominal, uncertainty, position)

    for slider in sliders.values():
        slider.observe(show, names="value")
    show()
    box = widgets.VBox([widgets.HBox([widgets.VBox(list(sliders.values())), picture]), text])
    box.sliders, box.error = sliders, text
    return box


def _png(kinematics: Kinematics, position: np.ndarray) -> bytes:
    from twin.display.figures import new_figure

    figure = new_figure(4.6, 4.2)
    plot_machine(kinematics, position, ax=figure.subplots())
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=80)
    return stream.getvalue()


def _error(kinematics: Kinematics, nominal: Kinematics, uncertainty: ToolUncertainty, position: np.ndarray) -> str:
    """Return the error at the tool in one position, in words."""
    rows = position[None]
    if kinematics.outside_domain(rows).any():
        return "outside the domain of the error motions: no error is known here"
    reached, meant = kinematics.forward(rows), nominal.forward(rows)
    error = (reached.point_mm - meant.point_mm)[0] * 1e3
    tilt = reached.tilt_urad(meant)[0]
    known = (
        f" ± {float(uncertainty.at(rows).expanded_um[0]):.1f} (U, 95 %)" if uncertainty.parameters else " (U unknown)"
    )
    x, y, z = error
    warnings = "; ".join(warning.title for warning in kinematics.calibration.warnings)
    return (
        f"<b>error of the tool point {np.linalg.norm(error):.1f}{known} µm</b>: x {x:+.1f}, y {y:+.1f}, z {z:+.1f} µm; tilt of the "
        f"tool axis about x {tilt[0]:+.1f}, about y {tilt[1]:+.1f} µrad" + (f"<br>{warnings}" if warnings else "")
    )
