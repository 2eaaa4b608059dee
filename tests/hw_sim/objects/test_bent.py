"""Bent plates: the surface that rays meet is the one that was asked for, on the print as on the bare plate."""

from __future__ import annotations

import numpy as np
import pytest

from hw_sim.objects.bent import BentPlates
from hw_sim.objects.print import front_met, lean
from hw_sim.objects.shapes import (
    BOARD,
    BOARD_BOW,
    BOARD_FORM,
    BOARD_HALF_X_MM,
    PLANE,
    PLANE_HALF_X_MM,
    VARIED,
    march_all,
    rise,
)
from hw_sim.truth import Artefacts

PLATES = BentPlates(0.05, -0.03, 0.02, 0.006, 0.004, -0.003)
BENT = Artefacts(board_bow_mm=0.02, plane_form_mm=PLATES.plane, board_form_mm=PLATES.board).sizes()


def heights(kind: int, sizes: np.ndarray, xy: np.ndarray) -> np.ndarray:
    rays = np.zeros((len(xy), 6))
    rays[:, :2], rays[:, 2], rays[:, 5] = xy, -100.0, 1.0
    out = np.empty(len(xy))
    march_all(kind + VARIED, sizes, rays, out)
    return out - 100.0


def test_the_shape_is_saddle_twist_and_s() -> None:
    rng = np.random.default_rng(2)
    xy = rng.uniform(-90.0, 90.0, (60, 2))
    for kind, half, bow, (saddle, twist, s) in (
        (PLANE, PLANE_HALF_X_MM, 0.0, PLATES.plane),
        (BOARD, BOARD_HALF_X_MM, 0.02, PLATES.board),
    ):
        p, q = xy.T / half
        cubic = 2.5980762 * p * (1.0 - p * p)
        expected = bow * (1.0 - 2.0 * (p * p + q * q)) + saddle * (p * p - q * q) + 2.0 * twist * p * q + s * cubic
        np.testing.assert_allclose(heights(kind, BENT, xy), expected, atol=2e-7)


def test_the_print_lies_on_the_bent_front_and_leans_as_it_does() -> None:
    rng = np.random.default_rng(4)
    for x, y in rng.uniform(-110.0, 110.0, (20, 2)):
        direction = np.array([*rng.uniform(-0.3, 0.3, 2), 1.0])
        direction /= np.linalg.norm(direction)
        ray = np.array([*(np.array([x, y, 0.0]) - 400.0 * direction), *direction])
        out = np.empty(1)
        march_all(BOARD + VARIED, BENT, ray[None], out)
        assert front_met(BENT, *ray) == pytest.approx(out[0], abs=2e-7)
        h, at = 1e-3, (BENT, BOARD_BOW, BOARD_FORM, BOARD_HALF_X_MM)
        by_x = (rise(*at, x + h, y) - rise(*at, x - h, y)) / (2 * h)
        by_y = (rise(*at, x, y + h) - rise(*at, x, y - h)) / (2 * h)
        assert lean(BENT, x, y) == pytest.approx((by_x, by_y), abs=1e-10)
