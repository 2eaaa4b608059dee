"""A knock moves one camera in its mount by what was said, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from hw_sim.mount_shift import MountShiftError, parse, with_mount_shifted
from hw_sim.truth import draw_truth, project

TRUTH = draw_truth("nominal", 1, 1600, 1200, 1.335)
POINTS = np.array([[0.0, 0.0, 522.5], [80.0, 0.0, 522.5]])


@pytest.mark.parametrize(
    ("sentence", "moves_px"),
    [
        # 0.1° in water is 0.1° of the ray, n times as much before the window, and f px per radian.
        ("right pitch_deg=0.1", (0.0, 5.955)),
        ("right yaw_deg=0.1", (-5.955, 0.0)),
        ("right roll_deg=0.1", (0.0, 0.0)),
        ("right y_mm=0.5", (0.0, -0.5 / 0.16)),
        ("right x_mm=0.5", (-0.5 / 0.16, 0.0)),
    ],
)
def test_the_image_moves_as_it_must(sentence: str, moves_px: tuple[float, float]) -> None:
    moved = with_mount_shifted(TRUTH, parse(sentence))
    middle, away = project(moved, "right", POINTS) - project(TRUTH, "right", POINTS)
    assert middle == pytest.approx(np.array(moves_px), rel=0.1, abs=0.1)
    if "roll" in sentence:
        assert abs(away[1]) == pytest.approx(np.radians(0.1) * 80.0 / 0.16, rel=0.15)
    assert moved.left == TRUTH.left
    assert moved.right.port == TRUTH.right.port, "the window goes with its camera"


@pytest.mark.parametrize(
    "sentence",
    ["", "right", "top pitch_deg=1", "right pitch=1", "right pitch_deg=x", "right pitch_deg=nan", "right x_mm=21"],
)
def test_what_is_no_knock_is_refused_with_what_is_allowed(sentence: str) -> None:
    with pytest.raises(MountShiftError, match=r"pitch_deg|left, right"):
        parse(sentence)
