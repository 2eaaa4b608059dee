"""Owns the step ``raster``: whether the picture lies upright for both cameras, and each of its pixels is one of the
projector's panel.

The upper left of the projector's picture must be the upper left of both images: projector and cameras look the same
way. A picture that is scaled to another raster gives some lines more of the panel's pixels than others, with the period
at which the two rasters meet (beating). Lines are judged by all of their light, so that it does not matter whether a
camera resolves them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from appliance.base import png
from appliance.workshop.bench import MOST_FRAMES, Bench, Image, Shot, flat_pictures, lit_part, mean_levels
from appliance.workshop.finding import Finding, judged
from appliance.workshop.step import StepOutcome

QUARTERS = (0.25, 0.5, 0.75)
LINES = 24
"""Lines next to each other, in either direction: they beat at least once where sizes differ by a twenty-fourth."""
MOST_BEATING = 0.03
"""Largest RMS difference of lines from a smooth course."""
OVER_NOISE = 3.0
"""And so many times what two passes differ by."""
MOST_NOISE = 0.05
LEAST_RESOLVED = 0.7
"""Camera pixels per projector pixel below which lines of one pixel fall between the camera's, and beat with those."""
_SHOWN = {"checker": "A checker of single pixels: grey, without bars", "marker": "An L: upright, not mirrored"}
"""Captions of the photographs, for a person's eyes."""


class Orientation(Enum):
    """Orientation of a picture in an image."""

    UPRIGHT = "upright"
    MIRRORED = "mirrored left to right"
    UPSIDE_DOWN = "mirrored top to bottom"
    TURNED = "turned by 180°"
    ON_ITS_SIDE = "turned by 90°"
    UNSEEN = "not seen"


_TURNED_BACK = {
    Orientation.MIRRORED: "switch rear projection off in the projector",
    Orientation.UPSIDE_DOWN: "switch the projector's vertical flip off",
    Orientation.TURNED: "switch ceiling projection off, or turn the projector over",
    Orientation.ON_ITS_SIDE: "turn the projector, or the cameras, by 90°",
    Orientation.UNSEEN: "point the projector at what the cameras see, and light it",
}


@dataclass(frozen=True, slots=True)
class SeenPicture:
    """The projector's picture as one camera sees it."""

    orientation: Orientation
    scale_ratio: float | None
    """Width of the second quarter of the picture over that of the third, as the camera sees them; ``None``: not told.
    """
    px_per_px: float | None = None
    """Camera pixels per projector pixel across."""


@dataclass(frozen=True, slots=True)
class LineLight:
    """Lines of one direction, compared."""

    beating: float
    """RMS difference from a smooth course, share of a line's light."""
    noise: float
    """RMS difference of two passes from their mean."""

    @property
    def told(self) -> bool:
        """True where there was light enough to tell."""
        return self.noise <= MOST_NOISE

    @property
    def scaled(self) -> bool:
        """True where lines differ: the picture was scaled."""
        return self.told and self.beating > max(MOST_BEATING, OVER_NOISE * self.noise)


def measure_orientation(
    bench: Bench, shot: Shot, *, all_channels: bool
) -> tuple[dict[str, SeenPicture], dict[str, Image]]:
    """Tell which way round each camera sees the picture, and photograph an L, by name.

    Raises BringupError, DeviceError.
    """
    # In one take: nothing must move between the halves that are compared.
    pictures = marker_pictures(bench.size_px)
    bench.load(pictures, all_channels=all_channels)
    frames = bench.take(range(len(pictures)), shot)
    seen = {side: see_orientation(images, bench.size_px[0]) for side, images in frames.items()}
    return seen, {f"marker_{side}": images[-1].copy() for side, images in frames.items()}


def measure_lines(bench: Bench, shot: Shot, *, all_channels: bool) -> tuple[dict[str, LineLight], dict[str, Image]]:
    """Compare single columns and single rows, by name; and photograph a checker, by name.

    Raises BringupError, DeviceError.
    """
    found: dict[str, LineLight] = {}
    grey: dict[str, Image] = {}
    for name, rows in (("columns", False), ("rows", True)):
        pictures = [
            *flat_pictures(bench.size_px, (255, 0)),
            checker(bench.size_px),
            *line_pictures(bench.size_px, rows),
        ]
        bench.load(pictures, all_channels=all_channels)
        order = [0, 1, 2, *range(3, 3 + LINES)]
        # As often as a take holds them: a single line is little light.
        turns = (MOST_FRAMES - 3) // LINES
        order += [k for _ in range(turns - 1) for k in range(3, 3 + LINES)]
        passes = []
        for _ in range(2):
            frames = bench.take(order, shot)
            light = np.mean([_line_light(images, turns) for images in frames.values()], axis=0)
            passes.append(light)
        found[name] = compare_lines(*passes)
        grey = {f"checker_{side}": images[2].copy() for side, images in frames.items()}
    return found, grey


def _line_light(images: Image, turns: int) -> NDArray[np.float64]:
    """Return the light of each line (LINES,), as a share of the mean line's."""
    part = lit_part(images[0], images[1], 0.2, 256.0)
    levels = mean_levels(images[3:], part) - float(images[1][part].mean())
    lines = levels.reshape(turns, LINES).mean(axis=0)
    return np.asarray(lines / max(float(lines.mean()), 1e-9))


def marker_pictures(size_px: tuple[int, int]) -> list[NDArray[np.uint8]]:
    """Return white, black, the left quarter, half and three quarters, the upper half, and an L for a person's eyes,
    each (h, w)."""
    width, height = size_px
    white, black = np.full((height, width), 255, np.uint8), np.zeros((height, width), np.uint8)
    pictures = [white, black]
    for share in QUARTERS:
        part = black.copy()
        part[:, : round(share * width)] = 255
        pictures.append(part)
    upper = black.copy()
    upper[: height // 2] = 255
    letter = black.copy()
    # An L is the same neither mirrored nor turned.
    letter[height // 8 : -height // 8, width // 8 : width // 4] = 255
    letter[-height // 4 : -height // 8, width // 8 : width // 2] = 255
    return [*pictures, upper, letter]


def see_orientation(frames: Image, width_px: int) -> SeenPicture:
    """Tell from a camera's images (7, h, w) of ``marker_pictures`` of that width which way round they lie."""
    white, black, first, half, third, upper = (frame.astype(np.float64) for frame in frames[:6])
    light = white - black
    lit = light > 0.3 * float(np.quantile(light, 0.99))
    if lit.mean() < 0.01 or float(np.quantile(light, 0.99)) < 8.0:
        return SeenPicture(Orientation.UNSEEN, None)

    def share(part: NDArray[np.float64]) -> NDArray[np.float64]:
        found: NDArray[np.float64] = np.where(lit, np.clip((part - black) / np.where(lit, light, 1.0), 0.0, 1.0), 0.0)
        return found

    # Centres of light instead of borders: they tell the side however oblique, blurred or partly outside the picture
    # lies.
    left, top = share(half), share(upper)
    across, down = _towards(left, lit), _towards(top, lit)
    if abs(across[1]) > abs(across[0]) or abs(down[0]) > abs(down[1]):
        return SeenPicture(Orientation.ON_ITS_SIDE, None)
    found = {
        (True, True): Orientation.UPRIGHT,
        (False, True): Orientation.MIRRORED,
        (True, False): Orientation.UPSIDE_DOWN,
        (False, False): Orientation.TURNED,
    }[across[0] < 0.0, down[1] < 0.0]
    second, fourth = share(half) - share(first), share(third) - share(half)
    rows = lit.mean(axis=1) > 0.5 * lit.mean(axis=1).max()
    # Areas over whole rows: to a few hundredths of a pixel, however blurred the borders are.
    widths = [float(part[rows].sum()) for part in (second, fourth)]
    if min(widths) <= 1.0:
        return SeenPicture(found, None)
    return SeenPicture(found, widths[0] / widths[1], sum(widths) / float(rows.sum()) / (0.5 * width_px))


def _towards(part: NDArray[np.float64], lit: NDArray[np.bool_]) -> tuple[float, float]:
    """Return where ``part`` lies against the rest of what is lit, (x, y) in px."""
    y, x = np.indices(part.shape)
    rest = lit - part
    inside, outside = max(part.sum(), 1e-9), max(rest.sum(), 1e-9)
    return (
        float((part * x).sum() / inside - (rest * x).sum() / outside),
        float((part * y).sum() / inside - (rest * y).sum() / outside),
    )


def line_pictures(size_px: tuple[int, int], rows: bool) -> list[NDArray[np.uint8]]:
    """Return ``LINES`` pictures (h, w), each with one bright column, or row, of the middle."""
    width, height = size_px
    pictures = []
    for k in range(LINES):
        picture = np.zeros((height, width), np.uint8)
        if rows:
            picture[(height - LINES) // 2 + k] = 255
        else:
            picture[:, (width - LINES) // 2 + k] = 255
        pictures.append(picture)
    return pictures


def checker(size_px: tuple[int, int]) -> NDArray[np.uint8]:
    """Return a checker of single pixels (h, w), for a person's eyes: it must look grey, without bars or grids in it."""
    width, height = size_px
    return ((np.add.outer(np.arange(height), np.arange(width)) % 2) * 255).astype(np.uint8)


def compare_lines(first: NDArray[np.float64], second: NDArray[np.float64]) -> LineLight:
    """Compare the light of neighbouring lines in two passes, each (n,)."""
    mean = (first + second) / 2.0
    x = np.linspace(-1.0, 1.0, len(mean))
    # The lens and the scene make a slow course, which a parabola follows; what beats does not.
    smooth = np.polyval(np.polyfit(x, mean, 2), x)
    # Relative to the mean line: how bright lines are is the exposure's business.
    scale = max(float(np.abs(smooth).mean()), 1e-9)
    # Two passes differ by twice the noise of their mean, in squares by four times.
    noise = float(np.sqrt(np.mean(((first - second) / 2.0) ** 2))) / scale
    beating = float(np.sqrt(np.mean((mean - smooth) ** 2))) / scale
    return LineLight(float(np.sqrt(max(0.0, beating**2 - noise**2))), noise)


def judge(
    seen: Mapping[str, SeenPicture], lines: Mapping[str, LineLight], photographs: Mapping[str, Image]
) -> StepOutcome:
    """Judge the picture as each camera sees it, and its single lines by direction; ``photographs`` are keyed by what
    and side."""
    pictures = {}
    for name, image in photographs.items():
        what, side = name.split("_")
        pictures[f"{name}.png"] = f"{_SHOWN[what]} ({side} camera)", png(image)
    return StepOutcome((_orientation(seen), raster_finding(lines, seen)), {}, pictures)


def _orientation(seen: Mapping[str, SeenPicture]) -> Finding:
    wrong = {side: one.orientation for side, one in seen.items() if one.orientation is not Orientation.UPRIGHT}
    said, remedy = "both cameras see the picture upright", ""
    limits = "upper left of the picture is upper left in both cameras"
    if wrong:
        side, how = next(iter(wrong.items()))
        said, remedy = f"both cameras see the picture {how.value}", _TURNED_BACK[how]
        if len(wrong) < len(seen):
            said = f"camera.{side} alone sees the picture {how.value}: it is the camera that turns it"
            remedy = f"mount camera.{side} the right way round, and switch its ReverseX and ReverseY off"
    return judged("orientation", not remedy, said, limits, remedy)


def raster_finding(lines: Mapping[str, LineLight], seen: Mapping[str, SeenPicture]) -> Finding:
    """Return what single ``lines``, by direction, say of the picture's raster, by cameras that have ``seen`` the
    picture so large."""
    resolved = [one.px_per_px for one in seen.values()]
    numbers: dict[str, float | None] = {
        **{f"{name}_beating_percent": 100.0 * line.beating for name, line in lines.items()},
        "camera_px_per_projector_px": min((one for one in resolved if one is not None), default=None),
    }
    scaled = [name for name, line in lines.items() if line.scaled]
    said, remedy = "single lines are equally bright: each pixel is one of the panel's", ""
    # Not told is no fault: the picture may be right, and the checker's photograph is on the page for a person.
    if any(one is None or one < LEAST_RESOLVED for one in resolved) or not all(one.told for one in lines.values()):
        said = "whether the picture is scaled cannot be told by cameras this coarse, or in so little light"
    elif scaled:
        said = f"single {' and '.join(scaled)} are not equally bright: the projector scales its picture"
        remedy = (
            "set width_px and height_px of [projector] to the raster of its panel, and keystone, zoom and overscan off"
        )
    return judged("raster", not remedy, said, f"single lines alike to {100.0 * MOST_BEATING:g} %", remedy, **numbers)
