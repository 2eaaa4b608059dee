"""Draw one scene in the ordinary world and in the world ``outside``, with OpenCV."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.patterns import Direction
from bench.outside.draws import scene_world
from bench.outside.scan import SEQUENCE, still
from bench.outside.world import chosen_exposure, expose
from bench.picture import write
from hw_sim.outside import ALL

PANEL_PX = 400, 300
TITLE_PX, GAP_PX = 30, 10
ENHANCED_PERCENT = 99.5
Image = NDArray[np.uint8]


def draw_scene(path: Path, seed: int, number: int) -> None:
    """Write a PNG: the left camera's bright frame and a fringe along each direction, in the ordinary world and in the other one."""
    sines = [SEQUENCE.axis(direction).sine[0] for direction in Direction]
    rows = []
    for name, families in (("ordinary", ()), ("outside", ALL)):
        renderer = still(scene_world(seed, number, families, soft=False)).renderer()
        chosen = chosen_exposure(renderer, SEQUENCE)
        shots = expose(renderer, SEQUENCE, chosen, only=[SEQUENCE.bright, *sines], sides=("left",))["left"]
        titles = (f"{name}: bright frame, {chosen.label}", "fringes across the baseline", "fringes along it")
        rows.append(np.hstack([_titled(shot, title) for shot, title in zip(shots, titles, strict=True)]))
    cv2.imwrite(str(path), np.vstack(rows)[..., 0])


def _titled(shot: Image, title: str) -> Image:
    image = np.full((PANEL_PX[1] + TITLE_PX, PANEL_PX[0] + GAP_PX, 3), 255, np.uint8)
    bright = np.clip(shot.astype(float) * 235.0 / max(float(np.percentile(shot, ENHANCED_PERCENT)), 1.0), 0, 255)
    image[TITLE_PX:, : PANEL_PX[0]] = cv2.resize(bright.astype(np.uint8), PANEL_PX)[..., None]
    write(image, title, (4, TITLE_PX - 9))
    return image
