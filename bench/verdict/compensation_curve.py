"""Picture of the effect of compensation over the speed of motion; drawn with OpenCV."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.picture import write

Rows = Sequence[Mapping[str, Any]]
Image = NDArray[np.uint8]
INK, FAINT, BAND = (40, 40, 40), (225, 225, 225), (238, 245, 238)
BEFORE, EXACT, CALIBRATED = (150, 150, 150), (170, 120, 40), (40, 110, 220)
LEAST, MOST = 0.5, 100.0
"""Of the errors over that at rest; logarithmic."""
AS_AT_REST = 1.2
_WIDTH, _HEIGHT, _LEFT, _TOP, _GAP = 300, 320, 60, 50, 36


def draw_curve(path: Path, rows: Rows) -> None:
    """Write a PNG: a panel for each direction, error over that at rest against speed.

    Filled marks are shown compensated; for rings the attempt was given up and the plain cloud is shown.
    """
    ways = list(dict.fromkeys(row["name"].split()[0] for row in rows))
    most_mm_s = max(row["speed_mm_s"] for row in rows)
    image: Image = np.full((_TOP + _HEIGHT + 100, _LEFT + len(ways) * (_WIDTH + _GAP) + 10, 3), 255, np.uint8)
    for number, direction in enumerate(ways):
        mine = sorted(
            (row for row in rows if row["name"].split()[0] == direction), key=lambda row: float(row["speed_mm_s"])
        )
        _panel(image, _LEFT + number * (_WIDTH + _GAP), direction, mine, most_mm_s)
    for k, (what, colour) in enumerate(
        (("nothing done", BEFORE), ("compensated, exact rig", EXACT), ("compensated, calibrated rig", CALIBRATED))
    ):
        x, y = _LEFT + k * 250, _TOP + _HEIGHT + 70
        cv2.circle(image, (x, y), 5, colour, -1, cv2.LINE_AA)
        write(image, what, (x + 12, y + 5), 0.45)
    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), image):
        raise OSError(f"{path} cannot be written")


def _panel(image: Image, left: int, direction: str, rows: Rows, most_mm_s: float) -> None:
    def place(speed_mm_s: float, error: float) -> tuple[int, int]:
        share = np.log(np.clip(error, LEAST, MOST) / LEAST) / np.log(MOST / LEAST)
        return left + round(_WIDTH * speed_mm_s / most_mm_s), _TOP + _HEIGHT - round(_HEIGHT * float(share))

    cv2.rectangle(image, place(0.0, AS_AT_REST), place(most_mm_s, LEAST), BAND, -1)
    for error in (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0):
        cv2.line(image, place(0.0, error), place(most_mm_s, error), FAINT, 1)
        if left == _LEFT:
            write(image, f"{error:g}", (left - 40, place(0.0, error)[1] + 5), 0.45)
    for speed in np.arange(0.0, most_mm_s + 1.0, 20.0):
        cv2.line(image, place(speed, LEAST), place(speed, MOST), FAINT, 1)
        write(image, f"{speed:g}", (place(speed, LEAST)[0] - 8, _TOP + _HEIGHT + 20), 0.45)
    write(image, f"{direction}, mm/s: rms over that at rest", (left, _TOP - 16), 0.5)
    for kind, colour in (("exact", EXACT), ("calibrated", CALIBRATED)):
        mine = [row for row in rows if row["calibration"] == kind]
        for values, key in ((BEFORE, "before"), (colour, "after")):
            points = np.array([place(row["speed_mm_s"], row[key]) for row in mine], np.int32)
            cv2.polylines(image, [points], False, values, 1, cv2.LINE_AA)
            for point, row in zip(points, mine, strict=True):
                filled = -1 if key == "before" or row["used"] else 1
                cv2.circle(image, (int(point[0]), int(point[1])), 4, values, filled, cv2.LINE_AA)
