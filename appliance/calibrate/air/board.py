"""The ChArUco board of the air calibration, and the search for its corners in a pair of images."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.air.linearised import MIN_CORNERS, BoardView
from appliance.measure import FULL_DN

Array = NDArray[np.float64]
Numbers = NDArray[np.intp]
Image = NDArray[np.uint8]

FAMILIES: Mapping[str, tuple[tuple[int, str], ...]] = {
    "5X5": ((50, "DICT_5X5_50"), (100, "DICT_5X5_100"), (250, "DICT_5X5_250"), (1000, "DICT_5X5_1000")),
    "4X4": ((50, "DICT_4X4_50"), (100, "DICT_4X4_100"), (250, "DICT_4X4_250"), (1000, "DICT_4X4_1000")),
    "6X6": ((50, "DICT_6X6_50"), (100, "DICT_6X6_100"), (250, "DICT_6X6_250"), (1000, "DICT_6X6_1000")),
    "APRILTAG_36h11": ((587, "DICT_APRILTAG_36h11"),),
    "ARUCO_ORIGINAL": ((1024, "DICT_ARUCO_ORIGINAL"),),
    "7X7": ((50, "DICT_7X7_50"), (100, "DICT_7X7_100"), (250, "DICT_7X7_250"), (1000, "DICT_7X7_1000")),
    "ARUCO_MIP_36h12": ((250, "DICT_ARUCO_MIP_36h12"),),
    "APRILTAG_25h9": ((35, "DICT_APRILTAG_25h9"),),
    "APRILTAG_16h5": ((30, "DICT_APRILTAG_16h5"),),
    "APRILTAG_36h10": ((2320, "DICT_APRILTAG_36h10"),),
}
"""OpenCV's predefined dictionaries, the likely ones first.

Those of one family begin with the same markers and differ in their number.
"""

MAX_SATURATED_SHARE = 0.05
DARK_DN, BRIGHT_PERCENTILE = 40.0, 99.0
"""An image is dark if this percentile is below this grey value; noise then displaces the corners."""
LEAST_MARKERS = 8
"""Least number of markers that count as a board; fewer may lie on a plane by chance."""
LEAST_SQUARES = 4
"""Least number of markers between which corners are searched."""
LEAST_SPREAD = 0.005
"""Least share of the image inside the corners' bounding box: nearer together, they determine nothing."""
SMALL_SPREAD = 0.15
"""Share of the image inside the corners' bounding box below which there is a warning. A board that fills an eighth of
the image is used with its weight, and determines the lens a third as well as one that fills it."""
MIN_SPREAD = 0.1
"""Least share of the image inside the corners' bounding box while somebody holds the board and can bring it nearer."""
THRESHOLD_WINDOWS = (300, 32)
"""Image widths over the smallest and the largest window of the thresholds; four sizes find markers of any size."""
CLEAR_OF_MARKERS = 0.8
"""Share of the distance from a corner to the next marker that the window of its refinement may fill."""
LEAST_WINDOW_PX, LARGEST_WINDOW_PX = 2, 10
"""Limits of the half size of that window."""
SOFTENING = 0.125
"""Sigma of the Gaussian that smooths the image before, as a share of the window; it halves the effect of noise."""
REFINEMENT = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-3)
SIZES = {"squares": (3, 60), "millimetres": (1.0, 200.0)}


class BoardError(ValueError):
    """Error of a board description that cannot be read; the text says how it is written."""


@dataclass(frozen=True, slots=True)
class BoardDesign:
    """ChArUco board: squares across and down, and the printed sizes."""

    across: int = 15
    down: int = 12
    square_mm: float = 18.0
    marker_mm: float = 13.5
    dictionary: int = cv2.aruco.DICT_5X5_250
    legacy: bool = False
    """Layout of OpenCV before 4.6: with an even number of squares down, the first square has a marker and is not dark.
    """

    @classmethod
    def parse(cls, text: str) -> BoardDesign:
        """Read squares across and down, their size and that of the markers in mm from ``15x12x18.0x13.5``.

        Raises BoardError.
        """
        match = re.fullmatch(r"(\d+)x(\d+)x(\d+(?:\.\d+)?)x(\d+(?:\.\d+)?)", text)
        remedy = (
            "give ACROSSxDOWNxSQUARExMARKER, squares 3..60, sizes 1..200 mm, markers smaller; for example 15x12x18x13.5"
        )
        if match is None:
            raise BoardError(f"board {text}: no board; {remedy}")
        across, down, square_mm, marker_mm = int(match[1]), int(match[2]), float(match[3]), float(match[4])
        (fewest_squares, most_squares), (least_mm, largest_mm) = SIZES["squares"], SIZES["millimetres"]
        if not (
            fewest_squares <= across <= most_squares
            and fewest_squares <= down <= most_squares
            and least_mm <= marker_mm < square_mm <= largest_mm
        ):
            raise BoardError(f"board {text}: impossible; {remedy}")
        if across * down // 2 > 250:
            raise BoardError(f"board {text}: {across * down // 2} markers, the dictionary has 250; take fewer squares")
        return cls(across, down, square_mm, marker_mm)

    def __str__(self) -> str:
        """Spell the board in the form that ``parse`` reads."""
        return f"{self.across}x{self.down}x{self.square_mm:g}x{self.marker_mm:g}"

    @property
    def family(self) -> str:
        """Name of the dictionary family in ``FAMILIES``."""
        return next(
            name for name, sizes in FAMILIES.items() if self.dictionary in [dictionary_number(n) for _, n in sizes]
        )

    @property
    def markers(self) -> int:
        """Number of markers."""
        return self.across * self.down // 2

    def described(self) -> str:
        """Describe the board in words."""
        layout = "before OpenCV 4.6" if self.legacy else "since OpenCV 4.6"
        if self.down % 2:
            layout = "the same before and since OpenCV 4.6"
        name = dictionary_name(self.family, self)
        return f"{self.across}x{self.down} squares of {self.square_mm:g} mm, markers of {self.marker_mm:.3g} mm, {name}, layout {layout}"

    def pattern(self) -> cv2.aruco.CharucoBoard:
        """Return OpenCV's board."""
        dictionary = cv2.aruco.getPredefinedDictionary(self.dictionary)
        board = cv2.aruco.CharucoBoard((self.across, self.down), self.square_mm, self.marker_mm, dictionary)
        board.setLegacyPattern(self.legacy)
        return board


@dataclass(frozen=True, slots=True)
class NoBoard:
    """Reason why a pair of images was not used, as a sentence for the holder of the board."""

    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Markers:
    """Markers of one dictionary in one picture."""

    ids: Numbers
    """(n,)."""
    outlines_px: Array
    """(n, 4, 2): corners, clockwise from the marker's own first."""

    @property
    def centres_px(self) -> Array:
        """Middles of the outlines (n, 2)."""
        return np.asarray(self.outlines_px.mean(axis=1))


def dictionary_name(family: str, design: BoardDesign) -> str:
    """Return the name of the smallest dictionary of a family that has all the board's markers."""
    needed = design.across * design.down // 2
    return next((name for size, name in FAMILIES[family] if size >= needed), FAMILIES[family][-1][1])


def find_markers(image: Image, family: str, first: int | None = None) -> Markers:
    """Return the markers of a family in a picture (h, w) uint8; ``first``: only those with numbers below it."""
    smallest_px, largest_px = (
        max(low, image.shape[1] // part) for part, low in zip(THRESHOLD_WINDOWS, (3, 23), strict=True)
    )
    settings = cv2.aruco.DetectorParameters()
    settings.adaptiveThreshWinSizeMin, settings.adaptiveThreshWinSizeMax = smallest_px, largest_px
    settings.adaptiveThreshWinSizeStep = max((largest_px - smallest_px) // 3, 1)
    family_dictionary = cv2.aruco.getPredefinedDictionary(dictionary_number(FAMILIES[family][-1][1]))
    dictionary = cv2.aruco.Dictionary(
        family_dictionary.bytesList[:first], family_dictionary.markerSize, family_dictionary.maxCorrectionBits
    )
    outlines, ids, _ = cv2.aruco.ArucoDetector(dictionary, settings).detectMarkers(image)
    if ids is None or len(ids) == 0:
        return Markers(np.empty(0, np.intp), np.empty((0, 4, 2)))
    return Markers(np.ravel(np.asarray(ids, np.intp)), np.asarray(outlines, np.float64).reshape(-1, 4, 2))


def find_board(
    name: str, images: Mapping[str, Image], design: BoardDesign, strict: bool
) -> tuple[BoardView, list[str]]:
    """Return the corners of the board in each image (h, w) uint8, and the reasons for images without a board.

    ``images`` are by camera. ``strict``: as for ``find_corners``.
    """
    corners: dict[str, dict[int, Array]] = {}
    reasons = []
    for side, image in images.items():
        result = find_corners(image, design, strict)
        if isinstance(result, NoBoard):
            reasons.append(f"{name}: {result.reason.format(side=side)}")
        else:
            corners[side] = result
    board_mm = np.asarray(design.pattern().getChessboardCorners(), np.float64)
    return BoardView.of(name, board_mm, corners.get("left"), corners.get("right")), reasons


def find_corners(image: Image, design: BoardDesign, strict: bool) -> dict[int, Array] | NoBoard:
    """Return the subpixel positions (2,) of the board's corners in one image (h, w) uint8, by their number.

    ``strict`` rejects glare and far boards, for use while somebody holds the board and can hold it better. Otherwise a
    board of any size is used, because the adjustment weights each corner. A reason has ``{side}`` in place of the
    camera's name.
    """
    if strict and float(np.mean(image >= FULL_DN)) > MAX_SATURATED_SHARE:
        return NoBoard("the {side} image is saturated; use less light, or turn the board out of the glare")
    markers = find_markers(image, design.family, design.markers)
    corners_px, numbers = _corners_between(image, design, markers)
    if len(numbers) < MIN_CORNERS:
        if len(find_markers(mirror(image), design.family, design.markers).ids) >= max(LEAST_MARKERS, len(markers.ids)):
            return NoBoard("the {side} image is mirrored; give it as the camera recorded it")
        if float(np.percentile(image, BRIGHT_PERCENTILE)) < DARK_DN:
            return NoBoard("the {side} image is dark; use more light, or a longer exposure time")
        return NoBoard(
            f"{len(numbers)} corners in the {{side}} image, {MIN_CORNERS} are needed; {len(markers.ids)} "
            "markers are found; bring the whole board into view, sharp and evenly lit"
        )
    if (spread := spread_of(corners_px, image.shape)) < (MIN_SPREAD if strict else LEAST_SPREAD):
        return NoBoard(f"the board is small in the {{side}} image, {100 * spread:.2g} % of it; bring it nearer")
    return refine_corners(image, design, corners_px, numbers)


def _corners_between(image: Image, design: BoardDesign, markers: Markers) -> tuple[Array, Numbers]:
    """Return corners (n, 2) between markers, good to some tenths of a pixel, and their numbers (n,)."""
    nothing = np.empty((0, 2)), np.empty(0, np.intp)
    if len(markers.ids) < LEAST_SQUARES:
        return nothing
    outlines = [np.asarray(o, np.float32)[None] for o in markers.outlines_px]
    ids = np.asarray(markers.ids, np.int32)[:, None]
    detector = cv2.aruco.CharucoDetector(design.pattern())
    corners, numbers, _, _ = detector.detectBoard(image, markerCorners=outlines, markerIds=ids)
    if numbers is None or len(numbers) == 0:
        return nothing
    return np.asarray(corners, np.float64).reshape(-1, 2), np.ravel(np.asarray(numbers, np.intp))


def spread_of(corners_px: Array, shape: tuple[int, ...]) -> float:
    """Return the share of an image (h, w) inside the bounding box of corners (n, 2)."""
    extent = np.ptp(corners_px, axis=0)
    return float(extent[0] * extent[1]) / (shape[0] * shape[1])


def dictionary_number(name: str) -> int:
    return int(getattr(cv2.aruco, name))


def mirror(image: Image) -> Image:
    return np.ascontiguousarray(image[:, ::-1])


def refine_corners(
    image: Image, design: BoardDesign, corners: Array, ids: NDArray[np.intp]
) -> dict[int, Array] | NoBoard:
    """Return each corner (n, 2) refined, by its number, in a window as large as the markers around it allow.

    Corners whose window would leave the image (h, w) are left out.
    """
    flat_mm = np.asarray(design.pattern().getChessboardCorners(), np.float64)[ids, :2]
    to_px = np.asarray(cv2.findHomography(flat_mm, corners)[0], np.float64)
    if to_px.shape != (3, 3):
        return NoBoard("the corners in the {side} image lie in one row; bring the whole board into view")
    room_px = 0.5 * (design.square_mm - design.marker_mm) * _least_scale(to_px, flat_mm)
    half_px = np.clip((CLEAR_OF_MARKERS * room_px).astype(np.intp), LEAST_WINDOW_PX, LARGEST_WINDOW_PX)
    limit = np.array([image.shape[1] - 1, image.shape[0] - 1])
    inside = np.all((corners > half_px[:, None] + 2) & (corners < limit - half_px[:, None] - 2), axis=1)
    sigma_px = SOFTENING * float(np.median(half_px))
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), sigma_px)
    refined: dict[int, Array] = {}
    for size in np.unique(half_px[inside]):
        rows = np.flatnonzero(inside & (half_px == size))
        start = corners[rows].astype(np.float32).reshape(-1, 1, 2)
        refined_px = cv2.cornerSubPix(smooth, start, (int(size), int(size)), (-1, -1), REFINEMENT)
        for number, point in zip(ids[rows], np.asarray(refined_px, np.float64).reshape(-1, 2), strict=True):
            refined[int(number)] = point
    return refined


def _least_scale(to_px: Array, position_mm: Array) -> Array:
    """Return the fewest pixels per mm in any direction (n,) at positions (n, 2) on the board.

    ``to_px`` (3, 3) is the homography from mm to px.
    """
    homogeneous = np.concatenate([position_mm, np.ones((len(position_mm), 1))], 1)
    u, v, w = (homogeneous @ to_px.T).T
    slopes = np.stack(
        [
            np.stack([to_px[0, k] / w - u / w**2 * to_px[2, k] for k in (0, 1)], -1),
            np.stack([to_px[1, k] / w - v / w**2 * to_px[2, k] for k in (0, 1)], -1),
        ],
        -2,
    )
    return np.asarray(np.linalg.svd(slopes, compute_uv=False)[:, 1])
