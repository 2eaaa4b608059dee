"""The warm-up: an empty image that compiles the kernels of every image before the world opens.

``PIECES`` can be compiled in parallel, the longest first. Kernels for fish, particles, uneven light and other rare
effects are not included: they are compiled on first use, in a second or two.
"""

from __future__ import annotations

import numpy as np

from hw_sim.optics.projector import LightSlice
from hw_sim.rendering.render import Renderer
from hw_sim.rendering.stage import Stage
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig, draw_truth

PIECES = (
    ("simulated images", "hw_sim.rendering.warm:see_in_the_dark"),
    ("simulated shadows", "hw_sim.rendering.warm:cast_shadows"),
    ("simulated light and water", "hw_sim.rendering.warm:see_by_the_projector"),
)
"""Purpose and function of each piece."""
_SIZE_PX = (64, 48)
_EXPOSURE_S = 0.012


def see_in_the_dark() -> None:
    """Run the kernels of an image with only lasers and ambient light."""
    _expose(())


def cast_shadows() -> None:
    """Run the kernels of the shadow map and the cameras' geometry."""
    stage, scene = Stage(_truth()), Scene()
    stage.shadows(stage.pose(scene, 0.0))
    stage.table("left")


def see_by_the_projector() -> None:
    """Run the remaining kernels: the projector's light, backscatter, and the true view."""
    renderer = _expose((LightSlice(np.zeros((768, 1024), np.uint8), _EXPOSURE_S),))
    renderer.view("left", 0.0)
    renderer.surface(0.0).distance_mm(np.zeros((1, 3)))


def _expose(light: tuple[LightSlice, ...]) -> Renderer:
    renderer = Renderer(_truth(), Scene())
    renderer.expose("left", light, 0.0, _EXPOSURE_S, 0.0, (True, True), 1)
    return renderer


def _truth() -> TrueRig:
    scene = Scene()
    return draw_truth("realistic", 1, *_SIZE_PX, scene.water.index)
