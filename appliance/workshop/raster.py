"""The step ``raster``: the picture must be upright, and its pixels must be those of the panel.

The upper left of the projector's picture must be the upper left of both images: projector and cameras look the same
way. A picture that is scaled to another raster gives some lines more of the panel's pixels than others, with the period
at which the two rasters meet (beating). Lines are compared by all of their light, so that a camera need not resolve
them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from appliance.base import png
from appliance.workshop.bench import MOST_FRAMES, Bench, Image, Shot, flat_pictures, lit_part, mean_levels
from appliance.workshop.finding import Finding, finding_of
from appliance.workshop.step import StepOutcome

QUARTERS = (0.25, 0.5, 0.75)
LINES = 24
"""Neighbouring lines, in either direction: they beat at least once where sizes differ by a twenty-fourth."""
MOST_BEATING = 0.03
"""Largest RMS difference of lines from a smooth course."""
OVER_NOISE = 3.0
"""Smallest ratio of the beating to the noise."""
MOST_NOISE = 0.05
LEAST_RESOLVED = 0.7
"""Camera pixels per projector pixel below which lines of one pixel beat with the camera's pixels."""
_CAPTIONS = {"checker": "A checker of single pixels: grey, without bars", "marker": "An L: upright, not mirrored"}
"""Captions of the photographs, for a person's eyes."""


class Orientation(Enum):
    """Orientation of a picture in an image."""

    UPRIGHT = "upright"
    MIRRORED = "mirrored left to right"
    UPSIDE_DOWN = "mirrored top to bottom"
    TURNED = "turned by 180°"
    ON_ITS_SIDE = "turned by 90°"
    UNSEEN = "not seen"


_ORIENTATION_REMEDIES = {
    Orientation.MIRRORED: "switch rear projection off in the projector",
    Orientation.UPSIDE_DOWN: "switch the projector's vertical flip off",
    Orientation.TURNED: "switch ceiling projection off, or turn the projector over",
    Orientation.ON_ITS_SIDE: "turn the projector, or the cameras, by 90°",
    Orientation.UNSEEN: "point the projector at what the cameras see, and light it",
}


@dataclass(frozen=True, slots=True)
class PictureView:
    """The projector's picture as one camera sees it."""

    orientation: Orientation
    scale_ratio: float | None
    """Width of the picture's second quarter over that of its third in the image; ``None``: unknown."""
    px_per_px: float | None = None
    """Camera pixels per projector pixel across."""


@dataclass(frozen=True, slots=True)
class LineLight:
    """Comparison of the lines of one direction."""

    beating: float
    """RMS difference from a smooth course, share of a line's light."""
    noise: float
    """RMS difference of two passes from their mean."""

    @property
    def is_measurable(self) -> bool:
        """True if there was enough light for a comparison."""
        return self.noise <= MOST_NOISE

    @property
    def is_scaled(self) -> bool:
        """True if lines differ, because the picture was scaled."""
        return self.is_measurable and self.beating > max(MOST_BEATING, OVER_NOISE * self.noise)


def measure_orientation(
    bench: Bench, shot: Shot, *, all_channels: bool
) -> tuple[dict[str, PictureView], dict[str, Image]]:
    """Determine the orientation of the picture in each camera's images, and photograph an L, by name.

    Raises BringupError, DeviceError.
    """
    # In one take, since the picture must not move between the halves that are compared.
    pictures = marker_pictures(bench.size_px)
    bench.load(pictures, all_channels=all_channels)
    frames = bench.take(range(len(pictures)), shot)
    views = {side: see_orientation(images, bench.size_px[0]) for side, images in frames.items()}
    return views, {f"marker_{side}": images[-1].copy() for side, images in frames.items()}


def measure_lines(bench: Bench, shot: Shot, *, all_channels: bool) -> tuple[dict[str, LineLight], dict[str, Image]]:
    """Compare single columns and single rows, by name; and photograph a checker, by name.

    Raises BringupError, DeviceError.
    """
    comparisons: dict[str, LineLight] = {}
    grey: dict[str, Image] = {}
    for name, rows in (("columns", False), ("rows", True)):
        pictures = [
            *flat_pictures(bench.size_px, (255, 0)),
            checker(bench.size_px),
            *line_pictures(bench.size_px, rows),
        ]
        bench.load(pictures, all_channels=all_channels)
        order = [0, 1, 2, *range(3, 3 + LINES)]
        # As often as fits into a take, since a single line has little light.
        repeats = (MOST_FRAMES - 3) // LINES
        order += [k for _ in range(repeats - 1) for k in range(3, 3 + LINES)]
        passes = []
        for _ in range(2):
            frames = bench.take(order, shot)
            light = np.mean([_line_light(images, repeats) for images in frames.values()], axis=0)
            passes.append(light)
        comparisons[name] = compare_lines(*passes)
        grey = {f"checker_{side}": images[2].copy() for side, images in frames.items()}
    return comparisons, grey


def _line_light(images: Image, repeats: int) -> NDArray[np.float64]:
    """Return the light of each line (LINES,), as a share of the mean line's."""
    part = lit_part(images[0], images[1], 0.2, 256.0)
    levels = mean_levels(images[3:], part) - float(images[1][part].mean())
    lines = levels.reshape(repeats, LINES).mean(axis=0)
    return np.asarray(lines / max(float(lines.mean()), 1e-9))


def marker_pictures(size_px: tuple[int, int]) -> list[NDArray[np.uint8]]:
    """Return white, black, left quarter, half and three quarters, upper half, and an L, each (h, w).

    The L is for a person's eyes.
    """
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


def see_orientation(frames: Image, width_px: int) -> PictureView:
    """Return the picture's orientation in a camera's images (7, h, w) of ``marker_pictures``."""
    white, black, first, half, third, upper = (frame.astype(np.float64) for frame in frames[:6])
    light = white - black
    is_lit = light > 0.3 * float(np.quantile(light, 0.99))
    if is_lit.mean() < 0.01 or float(np.quantile(light, 0.99)) < 8.0:
        return PictureView(Orientation.UNSEEN, None)

    def share(part: NDArray[np.float64]) -> NDArray[np.float64]:
        shares: NDArray[np.float64] = np.where(
            is_lit, np.clip((part - black) / np.where(is_lit, light, 1.0), 0.0, 1.0), 0.0
        )
        return shares

    # Centres of light instead of borders, which also work for a picture that is oblique, blurred or partly outside.
    left, top = share(half), share(upper)
    across, down = _towards(left, is_lit), _towards(top, is_lit)
    if abs(across[1]) > abs(across[0]) or abs(down[0]) > abs(down[1]):
        return PictureView(Orientation.ON_ITS_SIDE, None)
    orientation = {
        (True, True): Orientation.UPRIGHT,
        (False, True): Orientation.MIRRORED,
        (True, False): Orientation.UPSIDE_DOWN,
        (False, False): Orientation.TURNED,
    }[across[0] < 0.0, down[1] < 0.0]
    second, fourth = share(half) - share(first), share(third) - share(half)
    rows = is_lit.mean(axis=1) > 0.5 * is_lit.mean(axis=1).max()
    # Areas over whole rows give the width to a few hundredths of a pixel even with blurred borders.
    widths = [float(part[rows].sum()) for part in (second, fourth)]
    if min(widths) <= 1.0:
        return PictureView(orientation, None)
    return PictureView(orientation, widths[0] / widths[1], sum(widths) / float(rows.sum()) / (0.5 * width_px))


def _towards(part: NDArray[np.float64], is_lit: NDArray[np.bool_]) -> tuple[float, float]:
    """Return the vector from the other lit pixels to ``part``, (x, y) in px."""
    y, x = np.indices(part.shape)
    remaining = is_lit - part
    inside, outside = max(part.sum(), 1e-9), max(remaining.sum(), 1e-9)
    return (
        float((part * x).sum() / inside - (remaining * x).sum() / outside),
        float((part * y).sum() / inside - (remaining * y).sum() / outside),
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
    """Return a checker of single pixels (h, w): to the eye it must look grey, without bars or grids."""
    width, height = size_px
    return ((np.add.outer(np.arange(height), np.arange(width)) % 2) * 255).astype(np.uint8)


def compare_lines(first: NDArray[np.float64], second: NDArray[np.float64]) -> LineLight:
    """Compare the light of neighbouring lines in two passes, each (n,)."""
    mean = (first + second) / 2.0
    x = np.linspace(-1.0, 1.0, len(mean))
    # Lens and scene vary slowly, which a parabola follows; beating is faster.
    smooth = np.polyval(np.polyfit(x, mean, 2), x)
    # Relative to the mean line, since the brightness depends on the exposure.
    scale = max(float(np.abs(smooth).mean()), 1e-9)
    # The difference of two passes has twice the noise of their mean, in squares four times.
    noise = float(np.sqrt(np.mean(((first - second) / 2.0) ** 2))) / scale
    beating = float(np.sqrt(np.mean((mean - smooth) ** 2))) / scale
    return LineLight(float(np.sqrt(max(0.0, beating**2 - noise**2))), noise)


def judge(
    views: Mapping[str, PictureView], lines: Mapping[str, LineLight], photographs: Mapping[str, Image]
) -> StepOutcome:
    """Judge the picture as each camera sees it, and its single lines by direction.

    ``photographs`` are keyed by motif and side.
    """
    pictures = {}
    for name, image in photographs.items():
        motif, side = name.split("_")
        pictures[f"{name}.png"] = f"{_CAPTIONS[motif]} ({side} camera)", png(image)
    return StepOutcome((_orientation(views), raster_finding(lines, views)), {}, pictures)


def _orientation(views: Mapping[str, PictureView]) -> Finding:
    wrong = {side: view.orientation for side, view in views.items() if view.orientation is not Orientation.UPRIGHT}
    statement, remedy = "both cameras see the picture upright", ""
    limits = "upper left of the picture is upper left in both cameras"
    if wrong:
        side, how = next(iter(wrong.items()))
        statement, remedy = f"both cameras see the picture {how.value}", _ORIENTATION_REMEDIES[how]
        if len(wrong) < len(views):
            statement = f"camera.{side} alone sees the picture {how.value}: the camera turns it, not the projector"
            remedy = f"mount camera.{side} the right way round, and switch its ReverseX and ReverseY off"
    return finding_of("orientation", not remedy, statement, limits, remedy)


def raster_finding(lines: Mapping[str, LineLight], views: Mapping[str, PictureView]) -> Finding:
    """Return the finding on the picture's raster from single ``lines``, by direction.

    ``views`` have the size of the picture in each camera's images.
    """
    resolved = [ratio.px_per_px for ratio in views.values()]
    numbers: dict[str, float | None] = {
        **{f"{name}_beating_percent": 100.0 * line.beating for name, line in lines.items()},
        "camera_px_per_projector_px": min((ratio for ratio in resolved if ratio is not None), default=None),
    }
    scaled = [name for name, line in lines.items() if line.is_scaled]
    statement, remedy = "single lines are equally bright: the projector does not scale its picture", ""
    # An unknown result is no fault: the picture may be right, and the operator can look at the checker's photograph.
    if any(ratio is None or ratio < LEAST_RESOLVED for ratio in resolved) or not all(
        ratio.is_measurable for ratio in lines.values()
    ):
        statement = "scaling is not measurable: the cameras are too coarse, or the light is too weak"
    elif scaled:
        statement = f"single {' and '.join(scaled)} are not equally bright: the projector scales its picture"
        remedy = (
            "set width_px and height_px of [projector] to the raster of its panel, and keystone, zoom and overscan off"
        )
    return finding_of(
        "raster", not remedy, statement, f"single lines alike to {100.0 * MOST_BEATING:g} %", remedy, **numbers
    )
