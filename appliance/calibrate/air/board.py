"""Owns the board of the calibration in air: a ChArUco pattern, and its corners in a pair of images."""

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

Those of one family begin alike: only how many markers they have differs.
"""

MAX_SATURATED_SHARE = 0.05
DARK_DN, BRIGHT_PERCENTILE = 40.0, 99.0
"""An image is dark when so much of it is below so many grey values: its noise then moves the corners."""
LEAST_MARKERS = 8
"""Fewer markers on a plane may be chance."""
LEAST_SQUARES = 4
"""Fewest markers of which anything is made."""
LEAST_SPREAD = 0.005
"""Least part of the image inside the corners' bounding box, below which they are too near together to tell anything."""
SMALL_SPREAD = 0.15
"""Part of the image inside the corners' bounding box below which somebody is told: a board that fills an eighth of the
picture is used, by what it tells, and tells a third as much of the lens as one that fills it."""
MIN_SPREAD = 0.1
"""Least part of the image inside the corners' bounding box: a far board tells little and hides much.

Of whoever holds the board it can be asked.
"""
THRESHOLD_WINDOWS = (300, 32)
"""Smallest and largest window for thresholds, as parts of the image's width: four between them find markers of any
size."""
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
    """The layout of OpenCV before 4.6: with an even number of squares down, the first square is a marker's, not a dark
    one."""

    @classmethod
    def parse(cls, text: str) -> BoardDesign:
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
        return cls(across, down, square_mm, marker_mm)

    def __str__(self) -> str:
        """Spell the board in the form that ``parse`` reads."""
        return f"{self.across}x{self.down}x{self.square_mm:g}x{self.marker_mm:g}"

    @property
    def family(self) -> str:
        """Name in ``FAMILIES``."""
        return next(
            name for name, sizes in FAMILIES.items() if self.dictionary in [dictionary_number(n) for _, n in sizes]
        )

    @property
    def markers(self) -> int:
        """Number of markers."""
        return self.across * self.down // 2

    def described(self) -> str:
        """Say in words what board it is."""
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
    """Reason why a pair of images was not used, in a sentence for the person who holds the board."""

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
    small, large = (max(low, image.shape[1] // part) for part, low in zip(THRESHOLD_WINDOWS, (3, 23), strict=True))
    settings = cv2.aruco.DetectorParameters()
    settings.adaptiveThreshWinSizeMin, settings.adaptiveThreshWinSizeMax = small, large
    settings.adaptiveThreshWinSizeStep = max((large - small) // 3, 1)
    whole = cv2.aruco.getPredefinedDictionary(dictionary_number(FAMILIES[family][-1][1]))
    dictionary = cv2.aruco.Dictionary(whole.bytesList[:first], whole.markerSize, whole.maxCorrectionBits)
    outlines, ids, _ = cv2.aruco.ArucoDetector(dictionary, settings).detectMarkers(image)
    if ids is None or len(ids) == 0:
        return Markers(np.empty(0, np.intp), np.empty((0, 4, 2)))
    return Markers(np.ravel(np.asarray(ids, np.intp)), np.asarray(outlines, np.float64).reshape(-1, 4, 2))


def find_board(
    name: str, images: Mapping[str, Image], design: BoardDesign, strict: bool
) -> tuple[BoardView, list[str]]:
    """Return the corners that each image (h, w) uint8 shows of the board, by camera; and why one shows none, in
    sentences.

    ``strict``: as for ``find_corners``.
    """
    seen: dict[str, dict[int, Array]] = {}
    reasons = []
    for side, image in images.items():
        found = find_corners(image, design, strict)
        if isinstance(found, NoBoard):
            reasons.append(f"{name}: {found.reason.format(side=side)}")
        else:
            seen[side] = found
    board_mm = np.asarray(design.pattern().getChessboardCorners(), np.float64)
    return BoardView.of(name, board_mm, seen.get("left"), seen.get("right")), reasons


def find_corners(image: Image, design: BoardDesign, strict: bool) -> dict[int, Array] | NoBoard:
    """Return the board's corners in one image (h, w) uint8: pixels (2,) by the corner's number in ``design``, refined
    to subpixels.

    ``strict``: glare and far boards are refused, since whoever holds the board can be told to hold it better; else a
    board of any size will do, as each corner counts as much as it tells. A reason has ``{side}`` where the camera's
    name belongs.
    """
    if strict and float(np.mean(image >= FULL_DN)) > MAX_SATURATED_SHARE:
        return NoBoard("the {side} image is overexposed; less light, or turn the board out of the glare")
    markers = find_markers(image, design.family, design.markers)
    at, numbers = _between(image, design, markers)
    if len(numbers) < MIN_CORNERS:
        if len(find_markers(flipped(image), design.family, design.markers).ids) >= max(LEAST_MARKERS, len(markers.ids)):
            return NoBoard("the {side} image is mirrored; give it as the camera saw it")
        if float(np.percentile(image, BRIGHT_PERCENTILE)) < DARK_DN:
            return NoBoard("the {side} image is dark; more light, or a longer exposure")
        return NoBoard(
            f"{len(numbers)} corners in the {{side}} image, {MIN_CORNERS} are needed; {len(markers.ids)} markers were "
            "seen; "
            f"bring the whole board into view, sharp and evenly lit"
        )
    if (spread := spread_of(at, image.shape)) < (MIN_SPREAD if strict else LEAST_SPREAD):
        return NoBoard(f"the board is small in the {{side}} image, {100 * spread:.2g} % of it; bring it nearer")
    return refined(image, design, at, numbers)


def _between(image: Image, design: BoardDesign, markers: Markers) -> tuple[Array, Numbers]:
    """Return corners (n, 2) between markers, good to some tenths of a pixel, and their numbers (n,)."""
    none = np.empty((0, 2)), np.empty(0, np.intp)
    if len(markers.ids) < LEAST_SQUARES:
        return none
    outlines = [np.asarray(o, np.float32)[None] for o in markers.outlines_px]
    ids = np.asarray(markers.ids, np.int32)[:, None]
    detector = cv2.aruco.CharucoDetector(design.pattern())
    corners, numbers, _, _ = detector.detectBoard(image, markerCorners=outlines, markerIds=ids)
    if numbers is None or len(numbers) == 0:
        return none
    return np.asarray(corners, np.float64).reshape(-1, 2), np.ravel(np.asarray(numbers, np.intp))


def spread_of(corners_px: Array, shape: tuple[int, ...]) -> float:
    """Return the part of an image (h, w) inside the bounding box of corners (n, 2)."""
    extent = np.ptp(corners_px, axis=0)
    return float(extent[0] * extent[1]) / (shape[0] * shape[1])


def dictionary_number(name: str) -> int:
    return int(getattr(cv2.aruco, name))


def flipped(image: Image) -> Image:
    return np.ascontiguousarray(image[:, ::-1])


def refined(image: Image, design: BoardDesign, corners: Array, ids: NDArray[np.intp]) -> dict[int, Array] | NoBoard:
    """Return each corner (n, 2) once more, by its number, with a window as large as the markers around it leave room
    for; those whose window would leave the image (h, w) are left out."""
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
