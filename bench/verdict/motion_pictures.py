"""Pictures of the verdict on motion: predicted over true added noise, ROC curves and drift maps, drawn with OpenCV."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.measure.verdicts.motion.judge import MOST_ADDED, MotionJudgement
from bench.picture import write
from bench.verdict.motion_cases import KINDS
from bench.verdict.motion_figures import DISTURBANCES, GROUPS, HARMFUL, HARMLESS, LOST, roc_table

Image = NDArray[np.uint8]
Scan = Mapping[str, Any]
INK, FAINT, GRID = (40, 40, 40), (225, 225, 225), (240, 240, 240)
COLOURS = {
    "lateral": (170, 120, 40),
    "axial": (40, 110, 220),
    "rotation": (60, 140, 60),
    "tremor": (150, 60, 150),
    "acceleration": (120, 120, 120),
    "fish": (160, 160, 40),
}
LEAST_PERCENT, MOST_PERCENT = 0.03, 500.0
_SIDE, _GAP, _LEFT, _TOP = 170, 44, 110, 70


def draw_scatter(path: Path, scans: Sequence[Scan]) -> None:
    """Write a PNG of the added noise of each motion: predicted over true, both logarithmic."""
    size, left, top = 640, 90, 50
    image: Image = np.full((size + top + 70, size + left + 190, 3), 255, np.uint8)

    def at(percent: float) -> float:
        share = np.log(np.clip(percent, LEAST_PERCENT, MOST_PERCENT) / LEAST_PERCENT)
        return float(share / np.log(MOST_PERCENT / LEAST_PERCENT) * size)

    def x_of(percent: float) -> int:
        return left + round(at(percent))

    def y_of(percent: float) -> int:
        return top + size - round(at(percent))

    band = (x_of(100.0 * HARMLESS), x_of(100.0 * HARMFUL))
    image[top : top + size, band[0] : band[1]] = GRID
    for percent in (0.1, 1.0, 10.0, 100.0):
        cv2.line(image, (left, y_of(percent)), (left + size, y_of(percent)), FAINT, 1)
        cv2.line(image, (x_of(percent), top), (x_of(percent), top + size), FAINT, 1)
        write(image, f"{percent:g} %", (left - 62, y_of(percent) + 5))
        write(image, f"{percent:g} %", (x_of(percent) - 18, top + size + 22))
    cv2.line(image, (left, top + size), (left + size, top), FAINT, 1)
    limit = 100.0 * MOST_ADDED
    cv2.line(image, (left, y_of(limit)), (left + size, y_of(limit)), INK, 1)
    write(image, f"refused above {limit:.0f} %", (left + size + 6, y_of(limit) + 5), 0.45)
    for scan in scans:
        predicted = scan["moving"]["added_percent"]
        if predicted is not None and scan["added_percent"] is not None:
            place = (x_of(scan["added_percent"]), y_of(predicted))
            lost = scan["lost_percent"] > 100.0 * LOST
            cv2.circle(image, place, 4, COLOURS[scan["kind"]], -1 if lost else 1, cv2.LINE_AA)
    for row, kind in enumerate(KINDS):
        cv2.circle(image, (left + 20, top + 20 + 22 * row), 4, COLOURS[kind], 2, cv2.LINE_AA)
        write(image, kind, (left + 32, top + 25 + 22 * row))
    write(
        image,
        "Noise that movement adds: predicted from the fringes' drift (up) against the truth (across)",
        (20, 28),
        0.55,
    )
    write(image, "grey: 5 to 10 %, either is right; filled: over 10 % of the points lost", (left, top + size + 50))
    cv2.imwrite(str(path), image)


def draw_roc(path: Path, scans: Sequence[Scan]) -> None:
    """Write a PNG: a panel for each group of textures (down) and kind of movement (across), then one for each disturbance."""
    table = roc_table(scans)
    rows = [(group, [(kind, f"{group} {kind}") for kind in KINDS]) for group in GROUPS]
    for first in range(0, len(DISTURBANCES), len(KINDS)):
        rows.append(("", [(name, name) for name in DISTURBANCES[first : first + len(KINDS)]]))
    image: Image = np.full(
        (_TOP + len(rows) * (_SIDE + _GAP) + 10, _LEFT + len(KINDS) * (_SIDE + _GAP), 3), 255, np.uint8
    )
    write(image, "ROC: share of negatives (across), share of positives (up), 0 to 1", (20, 26), 0.55)
    for name, colour, x in (
        ("harmful told from harmless", COLOURS["axial"], 560),
        ("moving told from still", COLOURS["lateral"], 830),
    ):
        cv2.line(image, (x, 21), (x + 24, 21), colour, 2)
        write(image, name, (x + 30, 26))
    for row, (group, panels) in enumerate(rows):
        y0 = _TOP + row * (_SIDE + _GAP)
        write(image, group, (10, y0 + _SIDE // 2))
        for column, (title, key) in enumerate(panels):
            x0 = _LEFT + column * (_SIDE + _GAP)
            write(image, title, (x0, y0 - 10))
            _panel(image, x0, y0, table[key])
    cv2.imwrite(str(path), image)


def _panel(image: Image, x0: int, y0: int, curves: Mapping[str, Any]) -> None:
    cv2.rectangle(image, (x0, y0), (x0 + _SIDE, y0 + _SIDE), FAINT, 1)
    cv2.line(image, (x0, y0 + _SIDE), (x0 + _SIDE, y0), GRID, 1)
    for k, (name, colour) in enumerate((("harm", COLOURS["axial"]), ("seen", COLOURS["lateral"]))):
        curve = curves[name]
        points = [
            (x0 + round(f * _SIDE), y0 + _SIDE - round(t * _SIDE))
            for f, t in zip(curve["false"], curve["true"], strict=True)
        ]
        if points:
            cv2.polylines(image, [np.array(points, np.int32)], False, colour, 2, cv2.LINE_AA)
        area = "none" if curve["area"] is None else f"{curve['area']:.3f}"
        write(image, f"{area} of {curve['positives']}", (x0 + 62, y0 + _SIDE - 30 + 18 * k), 0.4)


def draw_maps(path: Path, rows: Sequence[tuple[str, Image, MotionJudgement]]) -> None:
    """Write a PNG with the left bright image of each scan, the drift E over the pattern, and the ripple over noise."""
    width, height, gap, top = 320, 240, 16, 34
    image: Image = np.full((40 + len(rows) * (height + top + gap), 3 * (width + gap) + gap, 3), 255, np.uint8)
    titles = ("left image", "drift E: red away, blue nearer", "ripple over noise: white 0, red 1")
    for column, title in enumerate(titles):
        write(image, title, (gap + column * (width + gap), 26))
    for row, (name, bright, judgement) in enumerate(rows):
        y = 40 + row * (height + top + gap)
        write(image, f"{name}: {judgement.judgement.verdict.text}", (gap, y + 22))
        drift = judgement.harm.drift_px
        scale = float(np.nanpercentile(np.abs(drift), 95)) or 1.0
        with np.errstate(invalid="ignore"):
            ripple = np.nan_to_num(judgement.harm.ripple_mm / judgement.harm.noise_mm)
        pictures = (
            cv2.cvtColor(cv2.resize(bright, (width, height), interpolation=cv2.INTER_AREA), cv2.COLOR_GRAY2BGR),
            _coloured(drift / scale, judgement.harm.weight > 0.0, width, height),
            _coloured(ripple, judgement.harm.weight > 0.0, width, height),
        )
        for column, picture in enumerate(pictures):
            x = gap + column * (width + gap)
            image[y + top : y + top + height, x : x + width] = picture
    cv2.imwrite(str(path), image)


def _coloured(values: NDArray[np.float64], is_valid: NDArray[np.bool_], width: int, height: int) -> Image:
    """Return −1 as blue, 0 as white, 1 as red; grey where no value is valid."""
    strength = np.clip(np.nan_to_num(np.abs(values)), 0.0, 1.0)[..., None]
    end = np.where(values[..., None] > 0.0, np.array([60.0, 60.0, 210.0]), np.array([200.0, 110.0, 40.0]))
    colour = np.where(is_valid[..., None], 255.0 + strength * (end - 255.0), 190.0)
    return np.asarray(cv2.resize(colour.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST), np.uint8)
