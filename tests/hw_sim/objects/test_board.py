"""The printed board is where its drawing and the workshop say, in air and in water, in ambient and in projected light."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from hw_sim.objects.motion import pose_matrix
from hw_sim.objects.print import ACROSS, CELLS, DOWN, INK, PAPER, SQUARE_MM, board_print, corners_mm, printed
from hw_sim.rendering.render import LightSlice, Renderer
from hw_sim.scene import Scene
from hw_sim.truth import Artefacts, TrueRig, draw_truth, in_air, project
from hw_sim.water.medium import AIR, Water

WHITE = np.full((768, 1024), 247, np.uint8)
POSE = (5.0, -8.0, 560.0, 12.0, -15.0, 30.0)
IN_AIR = Scene(object="board", pose=POSE, water=AIR, ambient=1.0)


def wet_rig() -> TrueRig:
    return draw_truth("realistic", 3, 800, 600, Water().index)


def saddles(image: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Where a paraboloid through the blurred picture around each start has its saddle: nobody's corner finder."""
    smooth = cv2.GaussianBlur(image.astype(np.float64), (0, 0), 1.5)
    y, x = np.mgrid[-3:4, -3:4]
    terms = np.stack([np.ones(49), x.ravel(), y.ravel(), x.ravel() ** 2, (x * y).ravel(), y.ravel() ** 2], 1)
    inverse = np.linalg.pinv(terms)
    found = start.copy()
    for _ in range(3):
        at = np.rint(found).astype(int)
        for k, (u, v) in enumerate(at):
            _, a, b, c, d, e = inverse @ smooth[v - 3 : v + 4, u - 3 : u + 4].ravel()
            found[k] = at[k] + np.linalg.solve([[2 * c, d], [d, 2 * e]], [-a, -b])
    return found


def corner_errors(rig: TrueRig, scene: Scene, side: str, projected: bool) -> np.ndarray:
    r = Renderer(rig, scene)
    light = [LightSlice(WHITE, 0.008)] if projected else []
    image = r.expose(side, light, 0.0, 0.008, 0.0, (False, False), 1)
    R, t = pose_matrix(scene.start_pose)
    corners = corners_mm(rig.artefacts.board_scale) @ R.T + t
    expected = project(rig, side, corners)
    inside = np.all((expected > 12) & (expected < np.array([799.0, 599.0]) - 12), axis=1)
    if projected:
        beam = project(rig, "projector", corners)
        inside &= np.all((beam > 20) & (beam < np.array([1023.0, 767.0]) - 20), axis=1)
    assert inside.sum() > 60
    return np.asarray(saddles(image, expected[inside]) - expected[inside])


@pytest.mark.parametrize(
    ("side", "wet"), [("left", True), ("right", False)], ids=["projected, in water", "ambient, in air"]
)
def test_corners_are_seen_where_exact_optics_puts_them(side: str, wet: bool) -> None:
    rig = wet_rig() if wet else in_air(wet_rig())
    scene = Scene(object="board", pose=POSE, ambient=0.02) if wet else IN_AIR
    errors = corner_errors(rig, scene, side, projected=wet)
    assert np.sqrt(np.mean(errors**2)) < (0.08 if wet else 0.06)
    assert np.abs(errors.mean(axis=0)).max() < (0.02 if wet else 0.015)


def test_the_print_is_as_large_as_the_workshop_made_it() -> None:
    rig = in_air(wet_rig())
    larger = replace(rig, artefacts=replace(rig.artefacts, board_scale=1.01))
    assert np.sqrt(np.mean(corner_errors(larger, IN_AIR, "left", projected=False) ** 2)) < 0.06
    made = [draw_truth("realistic", seed, 800, 600, 1.334).artefacts for seed in range(40)]
    assert 5e-6 < np.std([a.board_scale for a in made]) < 2e-5
    assert 0.005 < np.std([a.board_bow_mm for a in made]) < 0.02
    assert draw_truth("nominal", 1, 800, 600, 1.334).artefacts == Artefacts()


def test_a_pixel_sees_the_mean_of_the_print_before_it() -> None:
    scale = 1.01
    ink, sizes = board_print(), Artefacts(board_scale=scale).sizes()
    assert ink.shape == (DOWN * CELLS, ACROSS * CELLS)
    rng = np.random.default_rng(4)
    errors = []
    for _ in range(300):
        # Beside the upright edge between the first two squares of the second row, clear of markers.
        off, size, turn = rng.uniform(-0.1, 0.1), rng.uniform(0.1, 0.2), rng.uniform(-0.6, 0.6)
        c, s = size * np.cos(turn), size * np.sin(turn)
        edge_mm, row_mm = scale * (1 - ACROSS / 2) * SQUARE_MM, scale * (1.06 - DOWN / 2) * SQUARE_MM
        seen = printed(ink, sizes, edge_mm + off, row_mm, c, s, -s, c)
        u, v = np.meshgrid((np.arange(200) + 0.5) / 200 - 0.5, (np.arange(200) + 0.5) / 200 - 0.5)
        right = float(np.mean(off + u * c - v * s > 0.0))
        left_is_paper = ink[CELLS + 3, CELLS - 3] == 1
        errors.append((seen - INK) / (PAPER - INK) - (1.0 - right if left_is_paper else right))
    assert np.abs(errors).max() < 0.004, "as far as 200 × 200 points can tell"
    assert abs(np.mean(errors)) < 0.0005, "an edge is nowhere shifted"
