"""Each way a camera may see: its pixels and its rays agree, and it answers water as it should."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.calibration.design import Design, design_calibration
from appliance.calibration.field import INTERVALS as AIR_INTERVALS
from appliance.optics import pinhole
from appliance.optics.correction import INTERVALS, ImageCorrection
from appliance.optics.model import HousedCamera, StereoRig
from appliance.optics.pinhole import Lens
from appliance.optics.ray_shift import INTERVALS as SHIFT_INTERVALS
from appliance.optics.ray_shift import RayShift
from appliance.optics.water import Water

FRESH, SALT = Water(20.0, 0.0, 530.0).index, Water(20.0, 35.0, 530.0).index
RIG = design_calibration(
    Design(11.5, 4.5, 230.0, 12.41, 30.0, 5.0, 1.77), "KF", 1600, 1200, Water(20.0, 0.0, 530.0)
).rig
SHIFT = RayShift(1600, 1200, (4, 3), tuple(np.random.default_rng(3).normal(0.0, 0.05, 84)))
MODELS = {
    "ray field": replace(
        RIG.right,
        correction=ImageCorrection(1600, 1200, (6, 5), tuple(np.random.default_rng(4).normal(0.0, 0.1, 144))),
        ray_shift=SHIFT,
    ),
    "lens in water": replace(
        RIG.right, lens=Lens((3400.0, 3400.0), RIG.right.lens.c_px, (0.2, 0.1, 1e-4, 1e-4, 0.0)), lens_in_water=True
    ),
}


@pytest.mark.parametrize("name", MODELS)
def test_a_point_on_a_ray_is_seen_at_its_pixel_and_only_a_lens_calibrated_in_water_ignores_the_water(name: str) -> None:
    camera = MODELS[name]
    v, u = np.mgrid[0:1200:97, 0:1600:97].astype(float)
    uv = np.stack([u, v], -1)
    origin, direction = camera.rays(uv, FRESH)
    for depth_mm in (420.0, 650.0):
        np.testing.assert_allclose(np.linalg.norm(direction, axis=-1), 1.0, atol=1e-12)
        np.testing.assert_allclose(camera.project(origin + depth_mm * direction, FRESH), uv, atol=1e-6)
    behind = np.asarray(camera.translation_mm) - 100.0 * np.asarray(camera.rotation)[:, 2]
    assert np.isnan(camera.project(behind[None], FRESH)).all()
    change = np.abs(camera.rays(uv, SALT)[1] - direction).max()
    assert (change == 0.0) == (name == "lens in water")


def test_a_ray_shift_moves_rays_without_turning_them_and_has_as_many_nodes_as_its_grid() -> None:
    uv = np.array([[100.0, 100.0], [1500.0, 700.0]])
    (o, d), (o2, d2) = RIG.right.rays(uv, FRESH), replace(RIG.right, ray_shift=SHIFT).rays(uv, FRESH)
    np.testing.assert_array_equal(d, d2)
    assert 0.001 < np.linalg.norm(o2 - o, axis=1).min() < 0.2
    for count in (83, 85, 42):
        with pytest.raises(ValueError, match=f"ray shift with {count} coefficients; 4 × 3 intervals need 84"):
            RayShift(1600, 1200, (4, 3), (0.0,) * count)


def test_the_middle_of_the_volume_is_where_the_two_central_rays_come_nearest() -> None:
    rig = replace(RIG, right=replace(RIG.right, translation_mm=(226.0, 7.0, 51.0)))
    centre = rig.volume_centre_mm(FRESH)
    gaps = []
    for camera in (rig.left, rig.right):
        origin, direction = camera.rays(np.array([799.5, 599.5]), FRESH)
        gaps.append(origin + direction * float((centre - origin) @ direction) - centre)
        assert abs(float(gaps[-1] @ direction)) < 1e-9
    np.testing.assert_allclose(gaps[0], -gaps[1], atol=1e-9)  # half-way between the feet, which lie opposite each other
    assert 1.0 < np.linalg.norm(gaps[0]) < 10.0
    assert 300.0 < centre[2] < 900.0


@pytest.mark.parametrize(("angle_mrad", "parallel"), [(0.0, True), (0.9, True), (1.1, False)])
def test_axes_within_a_milliradian_of_each_other_are_parallel(angle_mrad: float, parallel: bool) -> None:
    """Two hundred metres away they would meet."""
    left = HousedCamera(1600, 1200, Lens((2500.0, 2500.0), (799.5, 599.5)), RIG.right.port, lens_in_water=True)
    c, s = float(np.cos(1e-3 * angle_mrad)), float(np.sin(1e-3 * angle_mrad))
    turned = (c, 0.0, -s), (0.0, 1.0, 0.0), (s, 0.0, c)
    rig = StereoRig(left, replace(left, rotation=turned, translation_mm=(230.0, 0.0, 0.0)))
    if parallel:
        with pytest.raises(ValueError, match="parallel; check the calibration"):
            rig.volume_centre_mm(FRESH)
    else:
        assert rig.volume_centre_mm(FRESH)[2] == pytest.approx(230.0 / (1e-3 * angle_mrad), rel=1e-3)


@pytest.mark.parametrize(
    ("place", "moved"),
    [
        (0, (0.3 * 0.13, -0.2 * 0.13)),
        (1, (0.3 * 0.0169, -0.2 * 0.0169)),
        (2, (2 * 0.3 * -0.2, 0.13 + 2 * 0.04)),
        (3, (0.13 + 2 * 0.09, 2 * 0.3 * -0.2)),
        (4, (0.3 * 0.002197, -0.2 * 0.002197)),
    ],
)
def test_distortion_is_opencvs(place: int, moved: tuple[float, float]) -> None:
    """Against the formulas of OpenCV's manual, one coefficient at a time, at (0.3, -0.2): r² = 0.13."""
    at = np.array([0.3, -0.2])
    lens = Lens((1000.0, 900.0), (10.0, 20.0), tuple(0.1 * (k == place) for k in range(5)))
    expected = (at + 0.1 * np.array(moved)) * [1000.0, 900.0] + [10.0, 20.0]
    np.testing.assert_allclose(lens.to_pixels(at), expected, atol=1e-9)
    np.testing.assert_allclose(lens.to_normalised(expected), at, atol=1e-12)


def test_a_strongly_bent_lens_is_inverted_in_three_steps_and_an_unknown_pixel_spoils_only_itself(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Newton's method squares the error with each step, if its slopes are those of the lens."""
    monkeypatch.setattr(pinhole, "MAX_ITERATIONS", 3)
    lens = Lens((1000.0, 900.0), (10.0, 20.0), (-0.3, 0.12, 2e-2, -3e-2, 0.05))
    xy = np.random.default_rng(1).uniform(-0.45, 0.45, (300, 2))
    xy[0], xy[1], xy[2] = (0.0, 0.0), (0.3, 0.0), (0.0, 0.3)
    uv = lens.to_pixels(xy)
    uv[5] = np.nan
    found = lens.to_normalised(uv)
    assert np.flatnonzero(np.isnan(found).all(axis=1)).tolist() == [5]
    np.testing.assert_allclose(np.delete(found, 5, 0), np.delete(xy, 5, 0), atol=2e-10)


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_lens_that_folds_over_is_refused_on_either_side_of_the_image(side: float, axis: int) -> None:
    """x (1 - 0.5 r^2) is never more than 0.55."""
    lens = Lens((1000.0, 1000.0), (0.0, 0.0), (-0.5, 0.0, 0.0, 0.0, 0.0))
    uv = np.zeros((1, 2))
    uv[0, axis] = 200.0 * side
    assert lens.to_pixels(lens.to_normalised(uv)) == pytest.approx(uv, abs=1e-8)
    uv[0, axis] = 700.0 * side
    with pytest.raises(ValueError, match="cannot be inverted within the image; recalibrate the camera in air"):
        lens.to_normalised(uv)


def test_the_free_fields_are_as_fine_as_the_documentation_says_and_the_shift_has_square_cells() -> None:
    """Depth shows less than an image, so that the ray shift is coarser."""
    (across, down), (shift_across, shift_down) = INTERVALS, SHIFT_INTERVALS
    said = (Path(__file__).parents[3] / "docs" / "calibration.md").read_text(encoding="utf-8")
    assert f"of {across} × {down} from a start that has none" in said
    assert f"of {AIR_INTERVALS[0]} × {AIR_INTERVALS[1]} intervals about the lenses' fields from air" in said
    assert 1600 / shift_across == 1200 / shift_down, "square on a sensor of 4 : 3"
    assert 1 / 3 < shift_across * shift_down / (across * down) < 2 / 3
