"""Picture of the accuracy of sigma: actual over expected error, and the distribution of residuals; drawn with OpenCV.

``python -m bench.verdict.uncertainty_picture bench/out/verdict.json docs/pictures/uncertainty.png``
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

SIDE_PX, LEFT_PX, TOP_PX = 460, 90, 60
INK, FAINT, BAND = (40, 40, 40), (225, 225, 225), (235, 245, 235)
BLUE, RED = (170, 120, 40), (60, 60, 200)
LOW_UM, HIGH_UM = 10.0, 600.0
FONT = cv2.FONT_HERSHEY_SIMPLEX
Image = NDArray[np.uint8]


def draw_uncertainty(path: Path, data: Mapping[str, Any]) -> None:
    """Write a PNG of the data of ``uncertainty.measure``: reliability on the left, scan by scan on the right."""
    image: Image = np.full((SIDE_PX + 2 * TOP_PX + 20, 2 * (SIDE_PX + LEFT_PX) + 40, 3), 255, np.uint8)
    _reliability(image[:, : SIDE_PX + LEFT_PX + 20], data["reliability"])
    _scans(image[:, SIDE_PX + LEFT_PX + 20 :], data["scans"])
    cv2.imwrite(str(path), image)


def _reliability(image: Image, bins: Sequence[Mapping[str, float]]) -> None:
    def at(um: float) -> float:
        return SIDE_PX * math.log(um / LOW_UM) / math.log(HIGH_UM / LOW_UM)

    def place(expected: float, actual: float) -> tuple[int, int]:
        return round(LEFT_PX + at(expected)), round(TOP_PX + SIDE_PX - at(actual))

    corners = [
        place(LOW_UM, 0.9 * LOW_UM), place(HIGH_UM, 0.9 * HIGH_UM), place(HIGH_UM, 1.1 * HIGH_UM),
        place(LOW_UM, 1.1 * LOW_UM),
    ]  # fmt: skip
    cv2.fillPoly(image, [np.array(corners, np.int32)], BAND)
    for um in (10.0, 20.0, 50.0, 100.0, 200.0, 500.0):
        cv2.line(image, place(um, LOW_UM), place(um, HIGH_UM), FAINT, 1)
        cv2.line(image, place(LOW_UM, um), place(HIGH_UM, um), FAINT, 1)
        _write(image, f"{um:g}", (place(um, LOW_UM)[0] - 10, TOP_PX + SIDE_PX + 20))
        _write(image, f"{um:g}", (LEFT_PX - 40, place(LOW_UM, um)[1] + 5))
    cv2.line(image, place(LOW_UM, LOW_UM), place(HIGH_UM, HIGH_UM), INK, 1, cv2.LINE_AA)
    for sigma_bin in bins:
        cv2.circle(image, place(sigma_bin["expected_um"], sigma_bin["rms_um"]), 5, BLUE, -1, cv2.LINE_AA)
        cv2.circle(image, place(sigma_bin["expected_um"], sigma_bin["rms_trimmed_um"]), 5, RED, 1, cv2.LINE_AA)
    _write(image, "Error (rms, um) against sigma (um); band: 10 %", (LEFT_PX - 60, 25), 0.55)
    _write(image, "filled: all points; ring: without the largest 0.3 %", (LEFT_PX - 60, 47), 0.45)
    _write(image, "sigma of the points, um", (LEFT_PX + 130, TOP_PX + SIDE_PX + 45))


def _scans(image: Image, scans: Sequence[Mapping[str, Any]]) -> None:
    objects = list(dict.fromkeys(scan["object"] for scan in scans))

    def down(rms: float) -> int:
        return round(TOP_PX + SIDE_PX * (1.5 - min(max(rms, 0.5), 1.5)))

    right = LEFT_PX + SIDE_PX - 60
    cv2.rectangle(image, (LEFT_PX - 40, down(1.1)), (right, down(0.9)), BAND, -1)
    for rms in (0.6, 0.8, 1.0, 1.2, 1.4):
        cv2.line(image, (LEFT_PX - 40, down(rms)), (right, down(rms)), INK if rms == 1.0 else FAINT, 1)
        _write(image, f"{rms:g}", (LEFT_PX - 75, down(rms) + 5))
    step = (right - LEFT_PX + 40) / max(1, len(objects))
    for k, name in enumerate(objects):
        mine = [scan for scan in scans if scan["object"] == name and scan["points"]]
        for n, scan in enumerate(mine):
            x = round(LEFT_PX - 40 + step * (k + 0.15 + 0.7 * (n + 0.5) / len(mine)))
            cv2.circle(image, (x, down(scan["rms"])), 4, BLUE, -1, cv2.LINE_AA)
            cv2.circle(image, (x, down(scan["rms_trimmed"])), 4, RED, 1, cv2.LINE_AA)
        _write(image, name, (round(LEFT_PX - 36 + step * k), TOP_PX + SIDE_PX + 20))
    _write(image, "Error in sigmas (rms), scan by scan", (LEFT_PX - 60, 25), 0.55)


def _write(image: Image, text: str, position_px: tuple[int, int], size: float = 0.5) -> None:
    cv2.putText(image, text, position_px, FONT, size, INK, 1, cv2.LINE_AA)


if __name__ == "__main__":
    source, target = (Path(a) for a in sys.argv[1:3])
    draw_uncertainty(target, json.loads(source.read_text(encoding="utf-8"))["parts"]["uncertainty"]["data"])
