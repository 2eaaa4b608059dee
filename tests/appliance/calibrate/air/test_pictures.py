"""The pictures of a calibration in air show each corner where it was seen, and its residual enlarged as the title says."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.calibrate.air.calibrate import FittedView
from appliance.calibrate.air.coverage import Coverage
from appliance.calibrate.air.pictures import coverage_picture, residual_picture

Array = NDArray[np.float64]
SIZE_PX = 1600, 1200
SCALE = 720 / 1600
TITLE_PX, PANEL_PX, GAP_PX = 34, (540, 720), 16


def view(left: Array, right: Array, left_off: Array, right_off: Array) -> FittedView:
    return FittedView("01", left, right, left_off, right_off)


def panels(png: bytes) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Left and right drawing (540, 720, 3), blue green red, without their titles."""
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    height, width = PANEL_PX
    assert image.shape == (TITLE_PX + height, 2 * width + GAP_PX, 3)
    assert (image[:, width : width + GAP_PX] == 255).all()
    assert (image[:TITLE_PX, :width] < 128).any(), "a title"
    return np.asarray(image[TITLE_PX:, :width], np.uint8), np.asarray(image[TITLE_PX:, width + GAP_PX :], np.uint8)


def drawn(panel: NDArray[np.uint8]) -> NDArray[np.intp]:
    """Rows and columns of what is strongly coloured: neither paper, nor lines, nor tint."""
    return np.argwhere(np.ptp(panel.astype(int), axis=2) > 80)


def test_corners_are_where_they_were_seen_and_regions_that_lack_some_are_tinted() -> None:
    counts = np.full((3, 3), 6)
    counts[0, 2] = 5
    seen = Coverage({"left": counts, "right": np.full((3, 3), 6)}, ())
    one = view(np.array([[300.0, 900.0]]), np.array([[1000.0, 200.0]]), np.zeros((1, 2)), np.zeros((1, 2)))
    left, right = panels(coverage_picture([one], seen, *SIZE_PX))
    for panel, (u, v) in ((left, (300.0, 900.0)), (right, (1000.0, 200.0))):
        assert drawn(panel).mean(axis=0) == pytest.approx([v * SCALE, u * SCALE], abs=0.6)
        assert np.ptp(drawn(panel), axis=0).max() <= 6
        lines = [tuple(panel[at]) for at in ((180, 30), (360, 30), (30, 240), (30, 480))]
        assert lines == [(200, 200, 200)] * 4
    for row, column in np.ndindex(3, 3):
        at = 180 * row + 30, 240 * column + 30
        assert tuple(left[at]) == ((205, 215, 255) if (row, column) == (0, 2) else (250, 250, 250))
        assert tuple(right[at]) == (250, 250, 250)


def test_a_residual_of_the_usual_size_is_an_arrow_of_14_px_from_its_corner_whatever_the_camera() -> None:
    """Both cameras share the scale: the left corner is off by 0.3 px to the right, the right one by 0.1 px upwards."""
    one = view(np.array([[400.0, 300.0]]), np.array([[1200.0, 900.0]]), np.array([[0.3, 0.0]]), np.array([[0.0, -0.1]]))
    left, right = panels(residual_picture([one], *SIZE_PX))
    times = 14.0 / np.sqrt((0.3**2 + 0.1**2) / 4)
    for panel, (u, v), (du, dv) in ((left, (400, 300), (0.3, 0.0)), (right, (1200, 900), (0.0, -0.1))):
        ends = drawn(panel)
        begin, end = np.array([v, u]) * SCALE, np.array([v, u]) * SCALE + np.array([dv, du]) * times
        assert ends.min(axis=0) == pytest.approx(np.minimum(begin, end), abs=1.5)
        assert ends.max(axis=0) == pytest.approx(np.maximum(begin, end), abs=1.5)
