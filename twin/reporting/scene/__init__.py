"""Animation of the machine running a program, as one self-contained HTML page. Only `draw` and `viewer` import meshcat."""

from twin.reporting.scene.draw import scene_html
from twin.reporting.scene.path import ScenePath
from twin.reporting.scene.program import Scene, draw_program

__all__ = ["Scene", "ScenePath", "draw_program", "scene_html"]
