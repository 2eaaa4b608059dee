"""Snow, bubbles and fish: where exact optics put them, lit by what is projected there, hiding what is behind."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hw_sim.optics.projector import soften
from hw_sim.rendering.stage import Stage
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth, project
from hw_sim.water.drift import SNOW, Specks
from hw_sim.water.medium import Water
from hw_sim.water.specks import SNOW_ALBEDO, scatter

WHITE = np.full((768, 1024), 255, np.uint8)
CLEAR = Water(attenuation_per_m=0.0, backscatter=0.0, blur_px_per_m=0.0)
AWAY = (0.0, 0.0, 5000.0, 0.0, 0.0, 0.0)
"""Out of sight: nothing but water before the rig."""
EMPTY = Scene(object="ballbar", pose=AWAY, water=CLEAR, noise=False)
TRUTH = draw_truth("realistic", 3, 400, 300, CLEAR.index)
STAGE = Stage(TRUTH)


def drawn(
    camera: str,
    places: np.ndarray,
    radius_mm: float,
    light: np.ndarray | None = None,
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    kind: int = SNOW,
    behind: float = 0.0,
    scene: Scene = EMPTY,
) -> tuple[np.ndarray, np.ndarray]:
    """Electrons before an even ``behind``, and what is covered; white and ambient light are 1."""
    pose = STAGE.pose(scene, 0.0)
    n = len(places)
    specks = Specks(places, np.tile(velocity, (n, 1)), np.full(n, radius_mm), np.full(n, kind))
    electrons, covered = np.full((300, 400), behind, np.float32), np.zeros((300, 400), np.float32)
    scatter(
        electrons, covered, specks, 0.01, STAGE.eyes[camera], STAGE.table(camera), STAGE.rays(camera),
        STAGE.geometry(camera, scene, pose), STAGE.lamp, None if light is None else STAGE.shadows(pose),
        None if light is None else soften(light, 0.0), 1.0, 1.0 if light is None else 0.0, 0.0,
    )  # fmt: skip
    return electrons.astype(float), covered.astype(float)


def centroid(image: np.ndarray) -> np.ndarray:
    v, u = np.indices(image.shape)
    return np.asarray(np.array([(image * u).sum(), (image * v).sum()]) / image.sum())


@pytest.mark.parametrize("camera", ["left", "right"])
@pytest.mark.parametrize(
    "place", [(10.0, -20.0, 500.0), (-40.0, 30.0, 420.0), (25.0, 10.0, 250.0), (-60.0, 0.0, 150.0)]
)
def test_a_speck_is_seen_where_exact_optics_put_it(camera: str, place: tuple[float, ...]) -> None:
    radius_mm = 0.05
    exact = project(TRUTH, camera, np.array([place]))[0]
    seen = drawn(camera, np.array([place]), radius_mm)[0]
    if not (5 < exact[0] < 395 and 5 < exact[1] < 295):
        assert seen.max() < 0.5 * radius_mm
        return
    assert np.linalg.norm(centroid(seen) - exact) < 0.08


def test_what_is_smaller_than_a_pixel_keeps_its_light_wherever_in_the_pixel_it_is() -> None:
    places = np.array([0.0, 0.0, 500.0]) + np.linspace(0.0, 1.0, 12)[:, None] * [0.7, 0.4, 0.0]
    for radius_mm in (0.02, 0.1, 0.25):
        sums = [drawn("left", place[None], radius_mm)[0].sum() for place in places]
        per_px = (
            np.linalg.norm(np.diff(project(TRUTH, "left", np.array([[-1.0, 0, 500.0], [1.0, 0, 500.0]])), axis=0)) / 2
        )
        area_px = math.pi * (radius_mm * per_px) ** 2
        assert np.ptp(sums) / np.mean(sums) < 0.02
        assert np.mean(sums) == pytest.approx(SNOW_ALBEDO * 2 / 3 * area_px, rel=0.06)


def test_a_speck_near_the_window_is_soft_and_none_of_its_light_is_lost() -> None:
    ray = STAGE.rays("left")[150, 200]
    far, near = (drawn("left", (ray[:3] + d * ray[3:])[None], 0.2)[0] for d in (487.5, 90.0))

    def spread_px(image: np.ndarray) -> float:
        u, _ = centroid(image)
        return math.sqrt((image * (np.indices(image.shape)[1] - u) ** 2).sum() / image.sum())

    assert spread_px(near) > 2.0 * spread_px(far)
    assert spread_px(far) < 0.7, "in focus"
    reduced = [30.0 + 5.0 / 1.77 + d / 1.333 for d in (487.5, 90.0)]
    assert near.sum() / far.sum() == pytest.approx((reduced[0] / reduced[1]) ** 2, rel=0.1)


def test_a_speck_is_lit_by_the_stripe_that_falls_on_it() -> None:
    x = np.linspace(-60.0, 60.0, 60)
    places = np.stack([x, 0.3 * x, np.full_like(x, 480.0)], -1)
    p = project(TRUTH, "projector", places)[:, 0]
    stripes = np.broadcast_to((np.arange(1024) // 32 % 2).astype(np.float32), (768, 1024))
    for place, at in zip(places, p, strict=True):
        inside = abs(at % 32 - 16.0) < 11.0
        if inside:
            share = (
                drawn("right", place[None], 0.3, stripes)[0].sum()
                / drawn("right", place[None], 0.3, WHITE / 255)[0].sum()
            )
            assert share == pytest.approx(float((at + 0.5) // 32 % 2), abs=0.02)


def test_a_speck_in_the_shadow_of_the_object_is_dark_and_one_behind_it_is_not_seen() -> None:
    scene = Scene(object="plane", pose=(0.0, 0.0, 450.0, 0.0, 0.0, 0.0), water=CLEAR)
    white = np.ones((768, 1024), np.float32)
    assert drawn("left", np.array([[0.0, 0.0, 430.0]]), 0.5, white, scene=scene)[0].sum() > 1.0
    assert drawn("left", np.array([[0.0, 0.0, 500.0]]), 0.5, white, scene=scene)[0].sum() == 0.0
    scene = replace(scene, pose=(-60.0, 0.0, 450.0, 0.0, 0.0, 0.0))
    beside = np.array([[65.0, 0.0, 560.0]])  # seen past the edge by the right camera, shaded from the projector
    lit, shaded = (drawn("right", beside, 0.5, white, scene=s)[0].sum() for s in (EMPTY, scene))
    assert lit > 0.3
    assert shaded == 0.0


def test_a_moving_speck_is_a_streak_of_the_same_light() -> None:
    place = np.array([[0.0, 0.0, 500.0]])
    still, fast = drawn("left", place, 0.1)[0], drawn("left", place, 0.1, velocity=(600.0, 0.0, 0.0))[0]
    assert fast.sum() == pytest.approx(still.sum(), rel=0.02)
    length = np.diff(project(TRUTH, "left", np.array([[-3.0, 0, 500.0], [3.0, 0, 500.0]]))[:, 0])[0]
    wide = np.flatnonzero(fast.sum(axis=0) > 0.3 * fast.sum(axis=0).max())
    assert np.ptp(wide) == pytest.approx(length, abs=2.0)
    np.testing.assert_allclose(centroid(fast), centroid(still), atol=0.1)
