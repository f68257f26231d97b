"""The machine running a program, as one HTML page that needs no network. Only `draw` imports meshcat."""

from twin.scene.draw import scene_html
from twin.scene.path import ScenePath

__all__ = ["ScenePath", "scene_html"]
