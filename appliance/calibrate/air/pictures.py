"""Pictures of an air calibration as PNG in memory: corners by view, and their residuals."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.air.calibrate import FittedView
from appliance.calibrate.air.coverage import ENOUGH_CORNERS, Coverage

Picture = NDArray[np.uint8]
PANEL_PX = 720
GAP_PX, TITLE_PX = 16, 34
USUAL_ARROW_PX = 14.0
"""Length of an arrow for a residual of the usual size."""
_PAPER, _LINES, _TEXT, _LACKING = (250, 250, 250), (200, 200, 200), (40, 40, 40), (205, 215, 255)


def coverage_picture(views: Sequence[FittedView], covered: Coverage, width_px: int, height_px: int) -> bytes:
    """Return both images side by side with every used corner, one colour per view.

    Regions with too few corners are tinted.
    """
    panels = []
    for side in ("left", "right"):
        panel, scale = _panel(width_px, height_px)
        for (row, column), count in np.ndenumerate(covered.corners[side]):
            if count < ENOUGH_CORNERS:
                (x0, x1), (y0, y1) = (
                    (k * full // 3, (k + 1) * full // 3)
                    for k, full in ((column, panel.shape[1]), (row, panel.shape[0]))
                )
                cv2.rectangle(panel, (x0, y0), (x1, y1), _LACKING, cv2.FILLED)
        _lines(panel)
        for k, view in enumerate(views):
            for u, v in (view.left_px if side == "left" else view.right_px) * scale:
                cv2.circle(panel, (round(u), round(v)), 2, _colour(k, len(views)), cv2.FILLED, cv2.LINE_AA)
        panels.append(_titled(panel, f"{side}: {int(covered.corners[side].sum())} corners in {len(views)} views"))
    return _png(np.concatenate([panels[0], np.full((panels[0].shape[0], GAP_PX, 3), 255, np.uint8), panels[1]], 1))


def residual_picture(views: Sequence[FittedView], width_px: int, height_px: int) -> bytes:
    """Return both images side by side with every corner's residual as an arrow, enlarged as the title says."""
    pooled = np.concatenate([np.concatenate([v.left_residual_px, v.right_residual_px]) for v in views])
    rms_px = float(np.sqrt(np.mean(pooled**2)))
    panels = []
    for side in ("left", "right"):
        panel, scale = _panel(width_px, height_px)
        _lines(panel)
        px_per_px = USUAL_ARROW_PX / max(rms_px, 1e-9)
        for k, view in enumerate(views):
            corners_px, residuals_px = (
                (view.left_px, view.left_residual_px) if side == "left" else (view.right_px, view.right_residual_px)
            )
            for begin, end in zip(corners_px * scale, corners_px * scale + residuals_px * px_per_px, strict=True):
                points = [(round(float(p[0])), round(float(p[1]))) for p in (begin, end)]
                cv2.line(panel, points[0], points[1], _colour(k, len(views)), 1, cv2.LINE_AA)
        panels.append(_titled(panel, f"{side}: {rms_px:.3f} px RMS; an arrow of {USUAL_ARROW_PX:.0f} px is that long"))
    return _png(np.concatenate([panels[0], np.full((panels[0].shape[0], GAP_PX, 3), 255, np.uint8), panels[1]], 1))


def _panel(width_px: int, height_px: int) -> tuple[Picture, float]:
    scale = PANEL_PX / width_px
    return np.full((round(height_px * scale), PANEL_PX, 3), _PAPER, np.uint8), scale


def _lines(panel: Picture) -> None:
    height, width = panel.shape[:2]
    for k in (1, 2):
        cv2.line(panel, (k * width // 3, 0), (k * width // 3, height), _LINES, 1)
        cv2.line(panel, (0, k * height // 3), (width, k * height // 3), _LINES, 1)
    cv2.rectangle(panel, (0, 0), (width - 1, height - 1), _LINES, 1)


def _titled(panel: Picture, title: str) -> Picture:
    head = np.full((TITLE_PX, panel.shape[1], 3), 255, np.uint8)
    cv2.putText(head, title, (4, 23), cv2.FONT_HERSHEY_SIMPLEX, 0.55, _TEXT, 1, cv2.LINE_AA)
    return np.concatenate([head, panel])


def _colour(k: int, count: int) -> tuple[int, int, int]:
    hsv = np.array([[[round(179 * k / max(count, 1)), 200, 190]]], np.uint8)
    b, g, r = (int(c) for c in cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR)[0, 0])
    return b, g, r


def _png(bgr: Picture) -> bytes:
    done, data = cv2.imencode(".png", bgr)
    if not done:
        raise ValueError(f"an image of shape {bgr.shape} cannot be encoded as PNG")
    return bytes(data)
