"""Owns the pictures of this measurement: one scene in both worlds, every scene by its water, what each family costs; drawn with OpenCV."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.patterns import Direction
from bench.outside.draws import scene_world
from bench.outside.scan import SEQUENCE, still
from bench.outside.world import chosen_exposure, expose
from bench.picture import FAINT, INK, write
from hw_sim.outside import ALL

PANEL_PX = 400, 300
TITLE_PX, GAP_PX = 30, 10
BEFORE, NOW = (190, 190, 190), (170, 120, 40)
"""Blue, green, red."""
ROW_PX, LABEL_PX, SPAN_PX, WIDTH_PX = 46, 170, 420, 1300
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


def draw_scenes(path: Path, before: Sequence[Mapping[str, Any]], now: Sequence[Mapping[str, Any]]) -> None:
    """Write a PNG: completeness and error over sigma of each scene by its water, before (grey) and now; hollow: refused."""
    width, height = WIDTH_PX // 2 - 90, 300
    image = np.full((height + 110, WIDTH_PX, 3), 255, np.uint8)
    axes = (("complete_percent", "completeness, %", 0.0, 100.0), ("error_over_sigma", "error over sigma", 0.0, 2.0))
    most_per_m = 2.0
    for k, (key, title, low, high) in enumerate(axes):
        left, top = 60 + k * (WIDTH_PX // 2), 40

        def at(
            per_m: float, value: float, left: int = left, top: int = top, low: float = low, high: float = high
        ) -> tuple[int, int]:
            share = (min(max(value, low), high) - low) / (high - low)
            return left + round(width * per_m / most_per_m), top + round(height * (1.0 - share))

        write(image, f"{title} (grey: the product before; hollow: refused)", (left, 24), 0.55)
        for mark in np.linspace(low, high, 5):
            cv2.line(image, at(0.0, mark), at(most_per_m, mark), FAINT, 1)
            write(image, f"{mark:g}", (left - 42, at(0.0, mark)[1] + 5), 0.42)
        for per_m in np.linspace(0.0, most_per_m, 5):
            write(image, f"{per_m:g}", (at(per_m, low)[0] - 8, top + height + 20), 0.42)
        write(image, "attenuation of the water, 1/m", (left, top + height + 46), 0.5)
        for rows, colour, size in ((before, BEFORE, 6), (now, NOW, 4)):
            for row in rows:
                if row[key] is not None:
                    place = at(float(row["attenuation_per_m"]), float(row[key]))
                    cv2.circle(image, place, size, colour, -1 if row["accepted"] else 1, cv2.LINE_AA)
    cv2.imwrite(str(path), image)


def draw_families(path: Path, before: Sequence[Mapping[str, Any]], now: Sequence[Mapping[str, Any]]) -> None:
    """Write a PNG: completeness and error over sigma of each family alone and of all together, before (grey) and now."""
    earlier = {str(row["name"]): row for row in before}
    image = np.full((ROW_PX * len(now) + 70, WIDTH_PX, 3), 255, np.uint8)
    panels = (("complete_percent", "completeness, %", 0.0, 100.0), ("error_over_sigma", "error over sigma", 0.0, 2.0))
    for k, (key, title, low, high) in enumerate(panels):
        left = LABEL_PX + k * (SPAN_PX + 140)
        write(image, f"{title} (grey: the product before)", (left, 24), 0.55)
        for mark in np.linspace(low, high, 5):
            x = left + int(SPAN_PX * (mark - low) / (high - low))
            cv2.line(image, (x, 36), (x, image.shape[0] - 26), FAINT, 1)
            write(image, f"{mark:g}", (x - 10, image.shape[0] - 8), 0.42)
        for place, row in enumerate(now):
            top = 40 + place * ROW_PX
            if k == 0:
                write(image, str(row["name"]), (12, top + 26))
            old = earlier.get(str(row["name"]), {}).get(key)
            for value, colour, shift in ((old, BEFORE, 2), (row[key], NOW, 20)):
                if value is None:
                    continue
                end = left + int(SPAN_PX * (min(max(float(value), low), high) - low) / (high - low))
                cv2.rectangle(image, (left, top + shift), (end, top + shift + 15), colour, -1)
                write(image, f"{value:.3g}", (end + 5, top + shift + 13), 0.42)
    cv2.line(image, (0, 34), (WIDTH_PX, 34), INK, 1)
    cv2.imwrite(str(path), image)
