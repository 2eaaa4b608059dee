"""Owns what tests of pictures share: a rig before a scene, and one exposure of it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hw_sim.optics.projector import LightSlice
from hw_sim.rendering.render import Renderer
from hw_sim.rendering.sensor import OFFSET_DN
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth

FACING = Scene(object="plane", pose=(0.0, 0.0, 522.5, 0.0, 0.0, 0.0), texture="none", noise=False, ambient=0.0)
"""A grey plane in the middle of the volume, and no light but the projector's."""


def renderer(scene: Scene, width_px: int = 400, kind: str = "nominal", seed: int = 3) -> Renderer:
    return Renderer(draw_truth(kind, seed, width_px, width_px * 3 // 4, scene.index), scene)


def pattern(codes: int | NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    """(768, 1024) uint8 of one code, or of a row of codes."""
    return np.ascontiguousarray(np.broadcast_to(np.rint(codes).astype(np.uint8), (768, 1024)))


def shot(
    r: Renderer,
    light: int | NDArray[np.uint8] | list[LightSlice] | None,
    exposure_s: float = 0.012,
    *,
    side: str = "left",
    time_s: float = 0.0,
    clock_s: float = 0.0,
    lasers: tuple[bool, bool] = (False, False),
    gain_db: float = 0.0,
    seed: int = 1,
) -> NDArray[np.float64]:
    """Grey values above the sensor's offset; ``light``: a code, a picture, slices of light, or the projector is off."""
    slices = [] if light is None else light if isinstance(light, list) else None
    if slices is None:
        slices = [LightSlice(pattern(light) if isinstance(light, int) else light, exposure_s)]  # type: ignore[arg-type]
    return r.expose(side, slices, time_s, exposure_s, gain_db, lasers, seed, clock_s).astype(float) - OFFSET_DN
