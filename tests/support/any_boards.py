"""Anybody's pictures of anybody's board: any dictionary and layout, through two pinholes, with OpenCV's own drawing of the board."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from tests.support.calibrating import Pose

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

WIDTH_PX, HEIGHT_PX = 720, 540
F_PX = 900.0
BASE_MM = 60.0
SHRINK = 3
"""Pictures are drawn finer and averaged: edges fall on parts of pixels."""
DOTS = 28
"""Dots of the drawing along a square: the modules of every dictionary are then whole dots or nearly so."""


@dataclass(frozen=True)
class Printed:
    """A board as somebody printed it."""

    across: int = 11
    down: int = 8
    square_mm: float = 15.0
    marker_mm: float = 11.25
    dictionary: int = cv2.aruco.DICT_5X5_1000
    legacy: bool = True

    def drawing(self) -> Image:
        """The print, dark on white, a square's width of paper all around it."""
        board = cv2.aruco.CharucoBoard(
            (self.across, self.down), self.square_mm, self.marker_mm, cv2.aruco.getPredefinedDictionary(self.dictionary)
        )
        board.setLegacyPattern(self.legacy)
        drawn = np.asarray(board.generateImage((self.across * DOTS, self.down * DOTS)), np.uint8)
        return np.asarray(np.pad(drawn, DOTS, constant_values=255), np.uint8)


@dataclass(frozen=True)
class Shot:
    """How a picture is taken: noise in grey values, and the blur's sigma in px."""

    noise_dn: float = 1.0
    blur_px: float = 0.5


def picture(printed: Printed, pose: Pose, side: str, seed: int, shot: Shot | None = None) -> Image:
    """Return the board (HEIGHT_PX, WIDTH_PX) as one of two parallel cameras sees it; the left one is the origin."""
    taken = shot or Shot()
    rng = np.random.default_rng([seed, side == "left"])
    R, t = pose.rotation, np.array(pose.at_mm) - [BASE_MM if side == "right" else 0.0, 0.0, 0.0]
    K = np.array([[F_PX, 0, (WIDTH_PX - 1) / 2], [0, F_PX, (HEIGHT_PX - 1) / 2], [0, 0, 1]])
    per_dot = printed.square_mm / DOTS
    middle = 0.5 * np.array([printed.across, printed.down]) * printed.square_mm
    # Dot centres in the board's frame, mm: the paper's rim begins a square before the print.
    first = (0.5 - DOTS) * per_dot - middle
    to_mm = np.array([[per_dot, 0, first[0]], [0, per_dot, first[1]], [0, 0, 1]])
    fine = np.array([[SHRINK, 0, (SHRINK - 1) / 2], [0, SHRINK, (SHRINK - 1) / 2], [0, 0, 1.0]])
    H = fine @ K @ np.column_stack([R[:, 0], R[:, 1], t]) @ to_mm
    size = (WIDTH_PX * SHRINK, HEIGHT_PX * SHRINK)
    big = cv2.warpPerspective(printed.drawing(), H, size, borderValue=90, flags=cv2.INTER_AREA)
    small = np.asarray(cv2.resize(big, (WIDTH_PX, HEIGHT_PX), interpolation=cv2.INTER_AREA), np.float64)
    seen = np.asarray(cv2.GaussianBlur(20.0 + 0.75 * small, (0, 0), taken.blur_px), np.float64)
    return np.asarray(np.clip(np.rint(seen + rng.normal(0.0, taken.noise_dn, seen.shape)), 0, 255), np.uint8)


def poses(count: int, seed: int, near_mm: float = 300.0, far_mm: float = 420.0) -> list[Pose]:
    """Boards as somebody holds them before both cameras, leant to every side."""
    rng = np.random.default_rng([seed, 17])
    found = []
    for k in range(count):
        z = float(rng.uniform(near_mm, far_mm))
        x, y = rng.uniform([-0.10, -0.06], [0.10, 0.06]) * z
        lean = 25.0 * np.array([np.cos(2.4 * k), np.sin(2.4 * k)]) + rng.normal(0.0, 3.0, 2)
        found.append(
            Pose((BASE_MM / 2 + float(x), float(y), z), (float(lean[0]), float(lean[1]), float(10 * rng.normal())))
        )
    return found


def write_pairs(folder: Path, printed: Printed, where: Sequence[Pose], name: str = "v{k}_{side}.png") -> None:
    """Write pictures of boards under names with ``{k}`` and ``{side}``, which may have folders in them."""
    for k, pose in enumerate(where):
        for side in ("left", "right"):
            path = folder / name.format(k=k, side=side)
            path.parent.mkdir(exist_ok=True)
            assert cv2.imwrite(str(path), picture(printed, pose, side, k))
