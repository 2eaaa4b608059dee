"""Owns the board of the calibration in air: a ChArUco pattern, and its corners in a pair of images."""

from __future__ import annotations

import re
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.air.linearised import MIN_CORNERS, BoardView
from appliance.measure import FULL_DN

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

MAX_SATURATED_SHARE = 0.05
DARK_DN, BRIGHT_PERCENTILE = 40.0, 99.0
"""An image is dark when so much of it is below so many grey values: its noise then moves the corners."""
MIN_SPREAD = 0.1
"""Least part of the image inside the corners' bounding box: a far board tells little and hides much."""
THRESHOLD_WINDOWS = (60, 30)
"""Markers are looked for with thresholds over windows of these parts of the image's width."""
CLEAR_OF_MARKERS = 0.8
"""Part of the way from a corner to the next marker that the window of its refinement may fill."""
LEAST_WINDOW_PX, LARGEST_WINDOW_PX = 2, 10
"""Half sizes of that window."""
SOFTENING = 0.125
"""Gaussian sigma, as a part of the window, by which the image is softened before: it halves what noise does."""
REFINEMENT = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-3)
SIZES = {"squares": (3, 60), "millimetres": (1.0, 200.0)}


class BoardError(ValueError):
    """A board cannot be described that way; the text says how it is done."""


@dataclass(frozen=True, slots=True)
class BoardDesign:
    """A ChArUco board: squares across and down, and the printed sizes."""

    across: int = 15
    down: int = 12
    square_mm: float = 18.0
    marker_mm: float = 13.5
    dictionary: int = cv2.aruco.DICT_5X5_250
    legacy: bool = False
    """The layout of OpenCV before 4.6: with an even number of squares down, the first square is a marker's, not a dark one."""

    def __str__(self) -> str:
        """Spell the board in the form that ``parse_board`` reads."""
        return f"{self.across}x{self.down}x{self.square_mm:g}x{self.marker_mm:g}"

    @property
    def corners(self) -> int:
        """Inner corners."""
        return (self.across - 1) * (self.down - 1)

    def pattern(self) -> cv2.aruco.CharucoBoard:
        """Return OpenCV's board."""
        dictionary = cv2.aruco.getPredefinedDictionary(self.dictionary)
        board = cv2.aruco.CharucoBoard((self.across, self.down), self.square_mm, self.marker_mm, dictionary)
        board.setLegacyPattern(self.legacy)
        return board


def parse_board(text: str) -> BoardDesign:
    """Read ``15x12x18.0x13.5``: squares across and down, their size and the markers' in mm. Raises BoardError."""
    found = re.fullmatch(r"(\d+)x(\d+)x(\d+(?:\.\d+)?)x(\d+(?:\.\d+)?)", text)
    remedy = (
        "give ACROSSxDOWNxSQUARExMARKER, squares 3..60, sizes 1..200 mm, markers smaller; for example 15x12x18x13.5"
    )
    if found is None:
        raise BoardError(f"board {text}: not understood; {remedy}")
    across, down, square_mm, marker_mm = int(found[1]), int(found[2]), float(found[3]), float(found[4])
    (fewest, most), (least, largest) = SIZES["squares"], SIZES["millimetres"]
    if not (fewest <= across <= most and fewest <= down <= most and least <= marker_mm < square_mm <= largest):
        raise BoardError(f"board {text}: impossible; {remedy}")
    if across * down // 2 > 250:
        raise BoardError(f"board {text}: {across * down // 2} markers, the dictionary has 250; take fewer squares")
    return BoardDesign(across, down, square_mm, marker_mm)


@dataclass(frozen=True, slots=True)
class NoBoard:
    """Reason why a pair of images was not used, in a sentence for the person who holds the board."""

    reason: str


def find_board(name: str, left: Image, right: Image, design: BoardDesign) -> BoardView | NoBoard:
    """Return the corners that both images (h, w) uint8 show of the board, refined to subpixels."""
    seen: dict[str, dict[int, Array]] = {}
    for side, image in (("left", left), ("right", right)):
        found = find_corners(image, design)
        if isinstance(found, NoBoard):
            return NoBoard(f"{name}: {found.reason.format(side=side)}")
        seen[side] = found
    both = sorted(seen["left"].keys() & seen["right"].keys())
    if len(both) < MIN_CORNERS:
        return NoBoard(
            f"{name}: only {len(both)} corners are seen by both cameras, {MIN_CORNERS} are needed; "
            f"hold the board in the middle between them, with nothing before it"
        )
    corners_mm = np.asarray(design.pattern().getChessboardCorners(), np.float64)[both]
    return BoardView(
        name, corners_mm, np.stack([seen["left"][i] for i in both]), np.stack([seen["right"][i] for i in both])
    )


def find_corners(image: Image, design: BoardDesign) -> dict[int, Array] | NoBoard:
    """Return the board's corners in one image (h, w) uint8: pixels (2,) by the corner's number in ``design``.

    A reason has ``{side}`` where the camera's name belongs.
    """
    if float(np.mean(image >= FULL_DN)) > MAX_SATURATED_SHARE:
        return NoBoard("the {side} image is overexposed; less light, or turn the board out of the glare")
    corners, ids = _detected(image, design)
    if len(ids) < MIN_CORNERS:
        if float(np.percentile(image, BRIGHT_PERCENTILE)) < DARK_DN:
            return NoBoard("the {side} image is dark; more light, or a longer exposure")
        return NoBoard(
            f"{len(ids)} corners in the {{side}} image, {MIN_CORNERS} are needed; "
            f"bring the whole board into view, sharp and evenly lit"
        )
    extent = np.ptp(corners, axis=0)
    if float(extent[0] * extent[1]) < MIN_SPREAD * image.size:
        return NoBoard("the board is small in the {side} image; bring it nearer")
    return refined(image, design, corners, ids)


def _detected(image: Image, design: BoardDesign) -> tuple[Array, NDArray[np.intp]]:
    """Return corners (n, 2), good to some tenths of a pixel, and their numbers (n,)."""
    small, large = (max(3, image.shape[1] // part) for part in THRESHOLD_WINDOWS)
    settings = cv2.aruco.DetectorParameters()
    settings.adaptiveThreshWinSizeMin, settings.adaptiveThreshWinSizeMax = small, large
    settings.adaptiveThreshWinSizeStep = max(large - small, 1)
    # OpenCV's own windows are for small markers: who has none of the right size is at least told so.
    for chosen in (settings, cv2.aruco.DetectorParameters()):
        detector = cv2.aruco.CharucoDetector(design.pattern(), cv2.aruco.CharucoParameters(), chosen)
        corners, ids, _, _ = detector.detectBoard(image)
        if ids is not None and len(ids) >= MIN_CORNERS:
            break
    if ids is None or len(ids) == 0:
        return np.empty((0, 2)), np.empty(0, np.intp)
    return np.asarray(corners, np.float64).reshape(-1, 2), np.ravel(np.asarray(ids, np.intp))


def refined(image: Image, design: BoardDesign, corners: Array, ids: NDArray[np.intp]) -> dict[int, Array] | NoBoard:
    """Return each corner (n, 2) once more, by its number, with a window as large as the markers around it leave room for;
    those whose window would leave the image (h, w) are left out."""
    flat_mm = np.asarray(design.pattern().getChessboardCorners(), np.float64)[ids, :2]
    to_px = np.asarray(cv2.findHomography(flat_mm, corners)[0], np.float64)
    if to_px.shape != (3, 3):
        return NoBoard("the corners in the {side} image lie in one row; bring the whole board into view")
    room_px = 0.5 * (design.square_mm - design.marker_mm) * _least_scale(to_px, flat_mm)
    half = np.clip((CLEAR_OF_MARKERS * room_px).astype(np.intp), LEAST_WINDOW_PX, LARGEST_WINDOW_PX)
    limit = np.array([image.shape[1] - 1, image.shape[0] - 1])
    inside = np.all((corners > half[:, None] + 2) & (corners < limit - half[:, None] - 2), axis=1)
    sigma_px = SOFTENING * float(np.median(half))
    soft = cv2.GaussianBlur(image.astype(np.float32), (0, 0), sigma_px)
    found: dict[int, Array] = {}
    for size in np.unique(half[inside]):
        these = np.flatnonzero(inside & (half == size))
        start = corners[these].astype(np.float32).reshape(-1, 1, 2)
        fine = cv2.cornerSubPix(soft, start, (int(size), int(size)), (-1, -1), REFINEMENT)
        for number, point in zip(ids[these], np.asarray(fine, np.float64).reshape(-1, 2), strict=True):
            found[int(number)] = point
    return found


def _least_scale(to_px: Array, at_mm: Array) -> Array:
    """Return the fewest pixels per mm in any direction (n,) at places (n, 2) of the board, whose homography is given."""
    ones = np.concatenate([at_mm, np.ones((len(at_mm), 1))], 1)
    u, v, w = (ones @ to_px.T).T
    slopes = np.stack(
        [
            np.stack([to_px[0, k] / w - u / w**2 * to_px[2, k] for k in (0, 1)], -1),
            np.stack([to_px[1, k] / w - v / w**2 * to_px[2, k] for k in (0, 1)], -1),
        ],
        -2,
    )
    return np.asarray(np.linalg.svd(slopes, compute_uv=False)[:, 1])
