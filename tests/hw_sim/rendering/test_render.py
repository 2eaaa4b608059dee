"""Pictures follow from physics: true points lie on the surface, noise is that of photons, dark and water dim the light."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hw_sim.objects.motion import Motion
from hw_sim.objects.shapes import NAMES
from hw_sim.optics.trace import pixels_of
from hw_sim.rendering.render import LightSlice, Renderer
from hw_sim.rendering.sensor import E_PER_DN, READ_NOISE_E, Sensor
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth
from hw_sim.water.medium import Water

WHITE = np.full((768, 1024), 247, np.uint8)
BLACK = np.zeros((768, 1024), np.uint8)
EXPOSURE_S = 0.012


def renderer(scene: Scene, kind: str = "realistic") -> Renderer:
    return Renderer(draw_truth(kind, 3, 400, 300, scene.water.index), scene)


def shot(r: Renderer, image: np.ndarray, camera: str = "left", time_s: float = 0.0, seed: int = 1) -> np.ndarray:
    return r.expose(camera, [LightSlice(image, EXPOSURE_S)], time_s, EXPOSURE_S, 0.0, (False, False), seed)


@pytest.mark.parametrize("name", list(NAMES))
def test_what_is_seen_lies_on_the_surface_and_is_seen_there_by_the_other_camera(name: str) -> None:
    r = renderer(Scene(object=name))
    view = r.view("left", 0.0)
    assert view.seen_by_all.mean() > 0.04
    points = view.points_rig_mm[view.seen_by_all]
    assert np.abs(r.surface(0.0).distance_mm(points)).max() < 1e-4
    away = points + np.array([0.0, 0.0, -0.3])
    assert (r.surface(0.0).distance_mm(away) > 0.0).mean() > 0.99, "towards the instrument is outside"
    eye = r.truth.right.packed(r.truth.n_water)
    pixels = np.empty((len(points), 2))
    pixels_of(eye, points, pixels)
    right = r.view("right", 0.0).points_rig_mm
    u, v = np.rint(pixels).astype(int).T
    inner = (u > 1) & (v > 1) & (u < 398) & (v < 298)
    assert np.nanmedian(np.linalg.norm(right[v[inner], u[inner]] - points[inner], axis=1)) < 0.7, "within a pixel"


def test_projected_light_sits_where_the_projector_puts_it() -> None:
    r = renderer(Scene(object="plane", noise=False, texture="none", ambient=0.0))
    half = BLACK.copy()
    half[:, 512:] = 247
    picture = shot(r, half)
    view = r.view("left", 0.0)
    p = view.projector_px[..., 0]
    assert (picture[view.seen_by_all & (p > 516)] > 60).all()
    assert (picture[view.seen_by_all & (p < 507)] < 12).all()


def test_variance_grows_with_light_as_photons_do() -> None:
    sensor = Sensor(200, 100, 1, noise=True)
    for level_dn in (20.0, 90.0, 200.0):
        electrons = np.full((100, 200), level_dn * E_PER_DN, np.float32)
        pairs = np.stack([sensor.read_out(electrons, 0.0, seed).astype(float) for seed in range(40)])
        temporal = pairs.var(axis=0).mean()
        expected = (level_dn * E_PER_DN + READ_NOISE_E**2) / E_PER_DN**2 + 1 / 12
        assert temporal == pytest.approx(expected, rel=0.05)
    middle = np.full((100, 200), 125.0 * E_PER_DN, np.float32)
    assert np.std([sensor.read_out(middle, 0.0, s)[50, 50] for s in range(300)]) == pytest.approx(1.62, abs=0.25)


def test_more_light_than_the_sensor_holds_saturates() -> None:
    sensor = Sensor(10, 10, 1, noise=False)
    assert (sensor.read_out(np.full((10, 10), 1e6, np.float32), 0.0, 1) == 255).all()
    assert (sensor.read_out(np.full((10, 10), 100 * E_PER_DN, np.float32), 6.0206, 1) == 202).all(), "6 dB doubles"


def test_bright_pattern_has_the_level_a_good_exposure_gives() -> None:
    r = renderer(Scene(object="plane", texture="none"))
    lit = shot(r, WHITE)[r.view("left", 0.0).seen_by_all]
    assert 150 < np.median(lit) < 230
    assert (lit == 255).mean() < 0.001
    dark = shot(r, BLACK)[r.view("left", 0.0).seen_by_all]
    assert np.median(dark) < 12


def test_turbid_water_takes_light_and_adds_a_veil() -> None:
    clear = Scene(object="plane", noise=False, water=Water(attenuation_per_m=0.0, backscatter=0.0))
    turbid = replace(clear, water=Water(attenuation_per_m=2.0, backscatter=0.2))
    a, b = renderer(clear), renderer(turbid)
    seen = a.view("left", 0.0).seen_by_all
    assert np.median(shot(b, WHITE)[seen]) < 0.8 * np.median(shot(a, WHITE)[seen])
    nothing_there = ~np.isfinite(a.view("left", 0.0).points_rig_mm[..., 0])
    far = replace(turbid, object="ballbar")
    empty = np.isnan(renderer(far).view("left", 0.0).points_rig_mm[..., 0])
    assert nothing_there.any() or empty.any()
    assert np.median(shot(renderer(far), WHITE)[empty]) > np.median(shot(renderer(far), BLACK)[empty]) + 10


def test_shadows_are_black_in_the_picture_and_not_seen_by_all() -> None:
    r = renderer(Scene(object="frustum", noise=False, ambient=0.0))
    view = r.view("left", 0.0)
    lit = shot(r, WHITE).astype(int) - shot(r, BLACK)
    surface = np.isfinite(view.points_rig_mm[..., 0])
    shadow = surface & (lit <= 2)
    assert 50 < shadow.sum() < 0.2 * surface.sum()
    assert (view.seen_by_all & shadow).sum() < 0.02 * shadow.sum() + 20


def test_moving_hands_move_the_picture_and_the_truth_alike() -> None:
    r = renderer(Scene(object="plane", motion=Motion(velocity_mm_s=(0.0, 0.0, 10.0))))
    start, later = r.view("left", 0.0), r.view("left", 0.4)
    both = start.seen_by_all & later.seen_by_all
    depth = (start.points_rig_mm[..., 2] - later.points_rig_mm[..., 2])[both]
    assert np.median(depth) == pytest.approx(4.0, abs=0.3), "moving forward brings the plane nearer"
    assert np.abs(r.surface(0.4).distance_mm(later.points_rig_mm[both])).max() < 1e-5


def test_laser_dots_are_where_the_beams_meet_the_surface() -> None:
    r = renderer(Scene(object="plane", noise=False, texture="none", ambient=0.0))
    on = r.expose("left", [LightSlice(BLACK, EXPOSURE_S)], 0.0, EXPOSURE_S, 0.0, (True, False), 1).astype(int)
    off = shot(r, BLACK).astype(int)
    v, u = np.unravel_index(np.argmax(on - off), on.shape)
    point = r.view("left", 0.0).points_rig_mm[v, u]
    laser = r.truth.lasers[0]
    origin, direction = np.array(laser.origin_mm), np.array(laser.direction)
    assert np.linalg.norm(np.cross(point - origin, direction)) < 1.5
    assert (on - off)[v, u] > 100


def test_the_same_seed_gives_the_same_noise_and_another_another() -> None:
    r = renderer(Scene(object="plane"))
    np.testing.assert_array_equal(shot(r, WHITE, seed=5), shot(r, WHITE, seed=5))
    assert (shot(r, WHITE, seed=5) != shot(r, WHITE, seed=6)).mean() > 0.5


def test_unknown_names_are_answered_with_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"object 'teapot'; allowed are plane, ballbar"):
        Scene(object="teapot")
    with pytest.raises(ValueError, match="allowed are nominal, realistic"):
        draw_truth("kind", 1, 400, 300, 1.33)
