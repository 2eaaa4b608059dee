"""Owns the picture of reasons: of each left pixel in which colour it is said why it has no point; where there is one, what the camera saw."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from appliance.desk.foreign.points import ForeignCloud
from appliance.desk.foreign.reasons import Reason
from appliance.store import LocalFileSystem, replace_file

COLOURS = {
    Reason.SATURATED: (255, 255, 0), Reason.WEAK: (16, 16, 72), Reason.CONTRADICTION: (214, 39, 40), Reason.OUTSIDE: (148, 103, 189),
    Reason.NO_RAY: (140, 86, 75), Reason.NO_MATCH: (31, 119, 180), Reason.GAP: (255, 127, 14), Reason.SIGMA: (44, 160, 44),
    Reason.DEPTH: (23, 190, 207), Reason.NEIGHBOURS: (227, 119, 194),
}  # fmt: skip
"""Red, green, blue of each reason."""
LINE_PX = 24


def draw_reasons(cloud: ForeignCloud, path: Path) -> None:
    """Write the picture as PNG, with the reasons and their numbers of pixels below it. Raises StorageError."""
    grey = cloud.cloud.grey
    picture = np.repeat(grey[..., None], 3, axis=-1)
    for reason, colour in COLOURS.items():
        picture[cloud.reason_map == reason] = colour
    counts = cloud.reasons
    legend = np.full((LINE_PX * (len(counts) + 1), max(grey.shape[1], 12 * LINE_PX), 3), 255, np.uint8)
    picture = np.pad(picture, ((0, 0), (0, legend.shape[1] - grey.shape[1]), (0, 0)), constant_values=255)
    named = [((128, 128, 128), f"point: {cloud.points}")]
    named += [(COLOURS[one], f"{one.word}: {counts[one.word]}") for one in COLOURS if one.word in counts]
    for line, (colour, text) in enumerate(named):
        top = line * LINE_PX
        cv2.rectangle(legend, (4, top + 4), (LINE_PX - 4, top + LINE_PX - 4), colour, cv2.FILLED)
        cv2.putText(legend, text, (LINE_PX + 4, top + 17), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 1, cv2.LINE_AA)
    # OpenCV counts colours from blue.
    made = cv2.imencode(".png", np.vstack([picture, legend])[..., ::-1])[1]
    replace_file(LocalFileSystem(), path, made.tobytes())
