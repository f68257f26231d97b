"""A slider for each axis, with the machine in that position and the error at the tool there (ipywidgets)."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from twin.kinematics.forward import Kinematics
from twin.notebook.field import ErrorsAtTool
from twin.notebook.optional import optional
from twin.notebook.plots import plot_machine

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
    errors = ErrorsAtTool(kinematics)
    warnings = "; ".join(warning.title for warning in kinematics.calibration.warnings)
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
        text.value = _error(errors, position) + (f"<br>{warnings}" if warnings else "")

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


def _error(errors: ErrorsAtTool, position: np.ndarray) -> str:
    """Return the error at the tool in one position, in words."""
    found = {name: float(value[0]) for name, (value, _, _) in errors.at(position[None]).items()}
    if np.isnan(found["distance"]):
        return "outside the domain of the error motions: no error is known here"
    known = f" ± {found['U']:.1f} (U, 95 %)" if "U" in found else " (U unknown)"
    return (
        f"<b>error of the tool point {found['distance']:.1f}{known} µm</b>: x {found['dx']:+.1f}, y {found['dy']:+.1f}, "
        f"z {found['dz']:+.1f} µm; tilt of the tool axis about x {found['tilt_a']:+.1f}, about y {found['tilt_b']:+.1f} µrad"
    )
