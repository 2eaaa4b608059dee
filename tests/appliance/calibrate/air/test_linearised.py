"""How a board looks in air and what changes that, against OpenCV's projection and differences taken here."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from appliance.calibrate.air.calibrate import NO_PORT
from appliance.calibrate.air.linearised import BoardView, bend_of, linearise_view, rig_steps
from appliance.measure.light.model import HousedCamera, StereoRig
from appliance.measure.light.pinhole import Lens
from appliance.measure.light.rotation import matrix3

LENSES = np.array(
    [[2400.0, 803.0, 596.0, -0.12, 0.08, 4e-4, -3e-4, 0.02], [2430.0, 795.0, 604.0, -0.1, 0.05, -2e-4, 5e-4, -0.03]]
)
TURN_RAD, BASE_MM = np.array([0.02, -0.4, 0.03]), np.array([228.0, 3.0, 25.0])
BOARD_RAD, BOARD_MM = np.array([0.3, -0.2, 1.1]), np.array([20.0, -15.0, 540.0])
AMOUNTS_MM = np.array([0.2, -0.15, 0.1, 0.3, -0.25])
MIDDLE_MM, REACH_MM = np.array([40.0, 25.0, 0.0]), 90.0


def turned(vector: np.ndarray) -> np.ndarray:
    return np.asarray(cv2.Rodrigues(np.asarray(vector, np.float64))[0])


def rig(values: np.ndarray | None = None) -> StereoRig:
    """The rig with the 22 ``values`` added: eight of each lens, turns of the right camera about its own axes, its shift."""
    x = np.zeros(22) if values is None else values
    lenses = [
        Lens((f, f), (u, v), (k1, k2, p1, p2, k3)) for f, u, v, k1, k2, p1, p2, k3 in LENSES + x[:16].reshape(2, 8)
    ]
    t = BASE_MM + x[19:]
    right = HousedCamera(
        1600, 1200, lenses[1], NO_PORT, matrix3(turned(TURN_RAD) @ turned(x[16:19])), tuple(t.tolist())
    )
    return StereoRig(HousedCamera(1600, 1200, lenses[0], NO_PORT), right)


def corners_mm() -> np.ndarray:
    """A board that is no square, whose frame begins at none of its corners and not in its middle."""
    x, y = np.meshgrid(np.linspace(-50.0, 130.0, 7), np.linspace(-35.0, 85.0, 5))
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])


def look(values: np.ndarray, amounts_mm: np.ndarray, place: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Pixels of both cameras by OpenCV, left u, v of each corner, then right; ``place``: turns about the board's axes, and a shift."""
    corners = corners_mm()
    p, q = (corners[:, :2] - MIDDLE_MM[:2]).T / REACH_MM
    shapes = (1 - 2 * (p**2 + q**2), p**2 - q**2, 2 * p * q, p - p**3, q - q**3)
    corners[:, 2] += sum(amount * rise for amount, rise in zip(amounts_mm, shapes, strict=True))
    corners += scale * (corners - MIDDLE_MM)
    points = corners @ (turned(BOARD_RAD) @ turned(place[:3])).T + BOARD_MM + place[3:]
    found = []
    for camera in (rig(values).left, rig(values).right):
        R, t = np.asarray(camera.rotation), np.asarray(camera.translation_mm)
        (fx, fy), (cx, cy), bends = camera.lens.f_px, camera.lens.c_px, np.array(camera.lens.distortion)
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        found.append(cv2.projectPoints(points, cv2.Rodrigues(R.T)[0], -R.T @ t, matrix, bends)[0])
    return np.concatenate(found).ravel()


def test_a_board_bends_about_its_middle_in_shapes_of_one_millimetre() -> None:
    view = BoardView("board", corners_mm(), np.zeros((35, 2)), np.zeros((35, 2)))
    part = replace(view, corners_mm=view.corners_mm[:20])
    bend = bend_of([part, replace(view, corners_mm=view.corners_mm[10:])])
    assert bend.middle == pytest.approx(MIDDLE_MM)
    assert bend.reach_mm == pytest.approx(REACH_MM)
    a = REACH_MM
    at = MIDDLE_MM + np.array([[0, 0, 0], [a, 0, 0], [0, a, 0], [a, -a, 0], [a / 2, 0, 0], [0, -a / 2, 0]])
    bow, saddle, twist, along, down = bend.of(at).T
    assert bow == pytest.approx([1.0, -1.0, -1.0, -3.0, 0.5, 0.5])
    assert saddle == pytest.approx([0.0, 1.0, -1.0, 0.0, 0.25, -0.25])
    assert twist == pytest.approx([0.0, 0.0, 0.0, -2.0, 0.0, 0.0])
    assert along == pytest.approx([0.0, 0.0, 0.0, 0.0, 0.375, 0.0])
    assert down == pytest.approx([0.0, 0.0, 0.0, 0.0, 0.0, -0.375])


def test_every_slope_is_that_of_opencvs_pixels() -> None:
    lens = [0.3, 0.2, -0.4, 1e-3, -2e-3, 1e-4, 2e-4, 1e-3]
    changes = np.array([*lens, *lens, 1e-3, -2e-3, 1e-3, 0.5, 0.2, -0.3])
    corners = corners_mm()
    bend = bend_of([BoardView("", corners, corners, corners)])
    now = {"values": changes, "amounts_mm": AMOUNTS_MM, "place": np.zeros(6), "scale": np.zeros(1)}
    seen = look(**now)
    off = np.random.default_rng(2).normal(0.0, 0.3, seen.size)
    left, right = (seen + off).reshape(2, -1, 2)
    view, place = BoardView("board", corners, left, right), (turned(BOARD_RAD), BOARD_MM)
    found = linearise_view(rig(changes), rig_steps(rig(), changes), place, view, bend, AMOUNTS_MM)
    assert found.residual == pytest.approx(off, abs=1e-6), "seen less computed"
    steps = [1e-2] * 3 + [1e-4] * 5
    for what, by, each in (
        ("values", found.by_rig[:, :22], steps * 2 + [1e-5] * 3 + [1e-2] * 3), ("amounts_mm", found.by_rig[:, 22:], [1e-2] * 5),
        ("place", found.by_pose, [1e-5] * 3 + [1e-2] * 3), ("scale", found.by_scale[:, None], [1e-4]),
    ):  # fmt: skip
        for k, (column, step) in enumerate(zip(by.T, each, strict=True)):
            further = step * np.eye(len(each))[k]
            ends = [look(**{**now, what: now[what] + sign * further}) for sign in (1.0, -1.0)]
            wanted = (ends[0] - ends[1]) / (2.0 * step)
            assert column == pytest.approx(wanted, rel=1e-3, abs=2e-3 * np.abs(wanted).max()), (what, k)
