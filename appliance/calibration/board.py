"""Owns the board of the calibration in air: a ChArUco pattern, and its corners in a pair of images."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.calibration.air import MIN_CORNERS, BoardView

Image = NDArray[np.uint8]

SATURATED_DN = 254
MAX_SATURATED_SHARE = 0.05
MIN_SPREAD = 0.1
"""Least part of the image inside the corners' bounding box: a far board tells little and hides much."""


@dataclass(frozen=True, slots=True)
class BoardDesign:
    """A ChArUco board: squares across and down, and the printed sizes."""

    across: int = 15
    down: int = 12
    square_mm: float = 18.0
    marker_mm: float = 13.5
    dictionary: int = cv2.aruco.DICT_5X5_250

    def pattern(self) -> cv2.aruco.CharucoBoard:
        """OpenCV's board."""
        dictionary = cv2.aruco.getPredefinedDictionary(self.dictionary)
        return cv2.aruco.CharucoBoard((self.across, self.down), self.square_mm, self.marker_mm, dictionary)


@dataclass(frozen=True, slots=True)
class NoBoard:
    """Why a pair of images was not used, in a sentence for the person who holds the board."""

    reason: str


def find_board(name: str, left: Image, right: Image, design: BoardDesign) -> BoardView | NoBoard:
    """The corners that both images (h, w) uint8 show of the board, refined to subpixels."""
    detector = cv2.aruco.CharucoDetector(design.pattern())
    seen: dict[str, dict[int, NDArray[np.float64]]] = {}
    for side, image in (("left", left), ("right", right)):
        if float(np.mean(image >= SATURATED_DN)) > MAX_SATURATED_SHARE:
            return NoBoard(f"{name}: the {side} image is overexposed; less light, or turn the board out of the glare")
        corners, ids, _, _ = detector.detectBoard(image)
        if ids is None or len(ids) < MIN_CORNERS:
            count = 0 if ids is None else len(ids)
            return NoBoard(
                f"{name}: {count} corners in the {side} image, {MIN_CORNERS} are needed; "
                f"bring the whole board into view, sharp and evenly lit"
            )
        points = np.asarray(corners, np.float64).reshape(-1, 2)
        extent = np.ptp(points, axis=0)
        if float(extent[0] * extent[1]) < MIN_SPREAD * image.size:
            return NoBoard(f"{name}: the board is small in the {side} image; bring it nearer")
        seen[side] = {int(i): point for i, point in zip(np.ravel(ids), points, strict=True)}
    both = sorted(seen["left"].keys() & seen["right"].keys())
    if len(both) < MIN_CORNERS:
        return NoBoard(
            f"{name}: only {len(both)} corners are seen by both cameras, {MIN_CORNERS} are needed; "
            f"hold the board in the middle between them"
        )
    corners_mm = np.asarray(design.pattern().getChessboardCorners(), np.float64)[both]
    return BoardView(
        name, corners_mm, np.stack([seen["left"][i] for i in both]), np.stack([seen["right"][i] for i in both])
    )
