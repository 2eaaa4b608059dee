"""Snow, bubbles and fish: where exact optics put them, lit by what is projected there, hiding what is behind."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from hw_sim.objects.motion import Motion
from hw_sim.optics.projector import LightSlice, soften
from hw_sim.rendering.render import Renderer
from hw_sim.rendering.stage import Stage
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth, project
from hw_sim.water.drift import BUBBLE, SNOW, Drift, Specks, Swarm
from hw_sim.water.medium import Water
from hw_sim.water.specks import SNOW_ALBEDO, SNOW_OPACITY, scatter

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
@pytest.mark.parametrize("radius_mm", [0.05, 0.5])
def test_a_speck_is_seen_where_exact_optics_put_it(camera: str, place: tuple[float, ...], radius_mm: float) -> None:
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
    far, near = (drawn("left", STAGE.rays("left")[150, 200, :3][None] + d * STAGE.rays("left")[150, 200, 3:], 0.2)[0]
                 for d in (487.5, 90.0))  # fmt: skip

    def spread(image: np.ndarray) -> float:
        u, _ = centroid(image)
        return math.sqrt((image * (np.indices(image.shape)[1] - u) ** 2).sum() / image.sum())

    assert near.max() < far.max() * 4.0
    assert spread(near) > 2.0 * spread(far)
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


def test_a_speck_hides_what_is_behind_by_its_area() -> None:
    place = np.array([[0.0, 0.0, 500.0]])
    before, covered = drawn("left", place, 0.5, np.zeros((768, 1024), np.float32), behind=100.0)
    np.testing.assert_allclose(100.0 - before, 100.0 * covered, atol=1e-3)
    per_px = 2555.6 / 4 / (30.0 + 5.0 / 1.77 + math.hypot(465.0, 115.0) / 1.333)
    assert covered.sum() == pytest.approx(SNOW_OPACITY * math.pi * (0.5 * per_px) ** 2, rel=0.1)


def test_a_moving_speck_is_a_streak_of_the_same_light() -> None:
    place = np.array([[0.0, 0.0, 500.0]])
    still, fast = drawn("left", place, 0.1)[0], drawn("left", place, 0.1, velocity=(600.0, 0.0, 0.0))[0]
    assert fast.sum() == pytest.approx(still.sum(), rel=0.02)
    length = np.diff(project(TRUTH, "left", np.array([[-3.0, 0, 500.0], [3.0, 0, 500.0]]))[:, 0])[0]
    wide = np.flatnonzero(fast.sum(axis=0) > 0.3 * fast.sum(axis=0).max())
    assert np.ptp(wide) == pytest.approx(length, abs=2.0)
    np.testing.assert_allclose(centroid(fast), centroid(still), atol=0.1)


def test_bubbles_rise_the_larger_the_faster_and_have_a_bright_rim() -> None:
    swarm, pose = Swarm(Drift(bubbles=50)), STAGE.pose(EMPTY, 0.0)
    now, soon = (swarm.specks(t, pose, pose) for t in (0.0, 0.001))
    rise = -(soon.places_mm - now.places_mm)[:, 1] / 0.001
    stays = np.abs(rise) < 1000.0
    assert stays.mean() > 0.9, "few come in again from below"
    assert (rise[stays] >= 99.9).all()
    assert (rise[stays] <= 250.1).all()
    assert np.corrcoef(rise[stays], now.radius_mm[stays])[0, 1] > 0.99
    seen, covered = drawn("left", np.array([[0.0, 0.0, 300.0]]), 2.0, kind=BUBBLE, behind=0.2)
    u, v = np.rint(centroid(covered)).astype(int)
    per_px = 2555.6 / 4 / (30.0 + 5.0 / 1.77 + math.hypot(265.0, 115.0) / 1.333)
    rim = seen[v, u + round(1.8 * per_px)]
    assert rim > 1.3 * seen[v, u + round(1.2 * per_px)], "total reflection beyond three quarters of the radius"


@pytest.mark.parametrize("drift", [Drift(particles_per_l=30.0, seed=5), Drift(bubbles=40), Drift(fish=3, seed=4)])
def test_pictures_differ_where_something_hides_and_from_frame_to_frame(drift: Drift) -> None:
    scene = Scene(object="plane", pose=(0.0, 0.0, 522.5, 0.0, 0.0, 0.0), water=CLEAR, noise=False, drift=drift)
    free, full = Renderer(TRUTH, replace(scene, drift=Drift())), Renderer(TRUTH, scene)

    def shot(r: Renderer, clock_s: float) -> np.ndarray:
        return r.expose("left", [LightSlice(WHITE // 2, 0.001)], 0.0, 0.001, 24.0, (False, False), 1, clock_s).astype(
            int
        )

    without = shot(free, 0.0)
    now, later = shot(full, 0.0), shot(full, 0.1)
    hidden = full.hidden_by_drift("left", 0.0, 0.0, 0.001)
    assert hidden.any()
    assert (now != later).any()
    np.testing.assert_array_equal(now, shot(full, 0.0))
    assert np.mean(now[hidden] != without[hidden]) > 0.8
    if drift.fish:  # everything else leaves traces that are too faint to count as hidden
        clear = cv2.dilate(hidden.astype(np.uint8), np.ones((15, 15), np.uint8)) == 0
        assert clear.any()
        np.testing.assert_array_equal(now[clear], without[clear])
    seen = full.view("left", 0.0).seen_by_all
    np.testing.assert_array_equal(seen, free.view("left", 0.0).seen_by_all)


def test_a_fish_hides_the_object_from_both_cameras_where_it_is() -> None:
    drift = Drift(fish=1, seed=2)
    r = Renderer(TRUTH, Scene(object="plane", drift=drift))
    pose, swarm, found = STAGE.pose(r.scene, 0.0), Swarm(drift), 0
    for clock_s in np.linspace(0.0, 6.0, 25):
        middle = swarm.school(float(clock_s), pose, pose).places_mm
        for camera in ("left", "right"):
            u, v = np.rint(project(TRUTH, camera, middle))[0]
            if 0 <= u < 400 and 0 <= v < 300:
                found += 1
                assert r.hidden_by_drift(camera, 0.0, float(clock_s))[int(v), int(u)]
    assert found >= 5


def test_specks_stay_in_the_water_while_the_hands_move() -> None:
    moved = Scene(object="plane", drift=Drift(particles_per_l=2.0), motion=Motion(velocity_mm_s=(40.0, 0.0, 0.0)))
    swarm, rest, then = Swarm(moved.drift), STAGE.pose(moved, 0.0), STAGE.pose(moved, 0.5)
    at_rest, seen = (swarm.specks(0.0, pose, rest).places_mm for pose in (rest, then))
    nearest = np.linalg.norm(seen[:, None] - (at_rest - [20.0, 0.0, 0.0])[None], axis=-1).min(axis=1)
    assert np.mean(nearest < 1e-9) > 0.9, "all but those that left the box and came in on the other side"


def test_as_much_snow_as_was_asked_for() -> None:
    swarm, pose = Swarm(Drift(particles_per_l=50.0)), STAGE.pose(EMPTY, 0.0)
    places = swarm.specks(3.3, pose, pose).places_mm
    in_litre = (np.abs(places - [0.0, 0.0, 450.0]) < 50.0).all(axis=1)
    assert in_litre.sum() == pytest.approx(50.0, abs=30.0)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [({"particles_per_l": -1.0}, "particles_per_l = -1.0; allowed are 0..2000"), ({"fish": 1.5}, "fish = 1.5"),
     ({"current_mm_s": (1.0,)}, "three finite"), ({"up": (0.0, 0.0, 0.0)}, "rise somewhere")],
)  # fmt: skip
def test_impossible_drift_is_refused(wrong: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Drift(**wrong)  # type: ignore[arg-type]
