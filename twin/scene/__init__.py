"""The machine running a program, as one HTML page that needs no network. Only `draw` imports meshcat."""

from twin.scene.draw import scene_html
from twin.scene.path import ScenePath
from twin.scene.program import Scene, draw_program

__all__ = ["Scene", "ScenePath", "draw_program", "scene_html"]
