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
from appliance.optics.port import water_rays
from appliance.optics.ray_shift import INTERVALS as SHIFT_INTERVALS
from appliance.optics.ray_shift import RayShift
from appliance.optics.water import Water

FRESH, SALT = Water(20.0, 0.0, 530.0).index, Water(20.0, 35.0, 530.0).index


def right_camera() -> HousedCamera:
    return design_calibration(
        Design(11.5, 4.5, 230.0, 12.41, 30.0, 5.0, 1.77), "KF", 1600, 1200, Water(20.0, 0.0, 530.0)
    ).rig.right


def models() -> dict[str, HousedCamera]:
    rng = np.random.default_rng(3)
    housed = right_camera()
    correction = ImageCorrection(1600, 1200, (6, 5), tuple(rng.normal(0.0, 0.1, 144)))
    shift = RayShift(1600, 1200, (4, 3), tuple(rng.normal(0.0, 0.05, 84)))
    lens = Lens((3400.0, 3400.0), housed.lens.c_px, (0.2, 0.1, 1e-4, 1e-4, 0.0))
    return {
        "ray field": replace(housed, correction=correction, ray_shift=shift),
        "lens in water": replace(housed, lens=lens, lens_in_water=True),
    }


@pytest.mark.parametrize("name", models())
def test_a_point_on_a_ray_is_seen_at_its_pixel(name: str) -> None:
    camera = models()[name]
    v, u = np.mgrid[0:1200:97, 0:1600:97].astype(float)
    uv = np.stack([u, v], -1)
    for depth_mm in (420.0, 520.0, 650.0):
        origin, direction = camera.rays(uv, FRESH)
        np.testing.assert_allclose(np.linalg.norm(direction, axis=-1), 1.0, atol=1e-12)
        np.testing.assert_allclose(camera.project(origin + depth_mm * direction, FRESH), uv, atol=1e-6)
    behind = np.asarray(camera.translation_mm) - 100.0 * np.asarray(camera.rotation)[:, 2]
    assert np.isnan(camera.project(behind[None], FRESH)).all()


def test_only_a_lens_calibrated_in_water_ignores_the_water() -> None:
    uv = np.array([[100.0, 100.0], [1500.0, 700.0]])
    for name, camera in models().items():
        change = np.abs(camera.rays(uv, SALT)[1] - camera.rays(uv, FRESH)[1]).max()
        assert (change == 0.0) == (name == "lens in water"), name


def test_a_ray_shift_moves_rays_without_turning_them() -> None:
    plain, field = right_camera(), replace(right_camera(), ray_shift=models()["ray field"].ray_shift)
    uv = np.array([[100.0, 100.0], [1500.0, 700.0]])
    (o, d), (o2, d2) = plain.rays(uv, FRESH), field.rays(uv, FRESH)
    np.testing.assert_array_equal(d, d2)
    assert 0.001 < np.linalg.norm(o2 - o, axis=1).min() < 0.2


def test_the_middle_of_the_volume_is_where_the_two_central_rays_come_nearest() -> None:
    rig = design_calibration(
        Design(11.5, 4.5, 230.0, 12.41, 30.0, 5.0, 1.77), "KF", 1600, 1200, Water(20.0, 0.0, 530.0)
    ).rig
    rig = replace(rig, right=replace(rig.right, translation_mm=(226.0, 7.0, 51.0)))
    centre = rig.volume_centre_mm(FRESH)
    gaps = []
    for camera in (rig.left, rig.right):
        origin, direction = camera.rays(np.array([799.5, 599.5]), FRESH)
        gaps.append(origin + direction * float((centre - origin) @ direction) - centre)
        assert abs(float(gaps[-1] @ direction)) < 1e-9
    np.testing.assert_allclose(gaps[0], -gaps[1], atol=1e-9)  # half-way between the feet, which lie opposite each other
    assert 1.0 < np.linalg.norm(gaps[0]) < 10.0
    assert 300.0 < centre[2] < 900.0


def test_two_cameras_that_look_the_same_way_have_no_middle() -> None:
    camera = replace(right_camera(), rotation=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    with pytest.raises(ValueError, match="parallel; check the calibration"):
        StereoRig(camera, replace(camera, translation_mm=(230.0, 0.0, 0.0))).volume_centre_mm(FRESH)


def test_distortion_is_opencvs() -> None:
    """Against the formulas of OpenCV's manual, one coefficient at a time, at (0.3, -0.2): r² = 0.13."""
    at = np.array([0.3, -0.2])
    for place, moved in enumerate(
        [
            (0.3 * 0.13, -0.2 * 0.13),
            (0.3 * 0.0169, -0.2 * 0.0169),
            (2 * 0.3 * -0.2, 0.13 + 2 * 0.04),
            (0.13 + 2 * 0.09, 2 * 0.3 * -0.2),
            (0.3 * 0.002197, -0.2 * 0.002197),
        ]
    ):
        coefficients = [0.0] * 5
        coefficients[place] = 0.1
        lens = Lens((1000.0, 900.0), (10.0, 20.0), tuple(coefficients))
        expected = (at + 0.1 * np.array(moved)) * [1000.0, 900.0] + [10.0, 20.0]
        np.testing.assert_allclose(lens.to_pixels(at), expected, atol=1e-9)
        np.testing.assert_allclose(lens.to_normalised(expected), at, atol=1e-12)


def test_strong_distortion_is_inverted_to_the_last_digit_and_a_lens_that_folds_over_is_refused() -> None:
    strong = Lens((2500.0, 2500.0), (800.0, 600.0), (-0.3, 0.12, 4e-3, -5e-3, -0.02))
    v, u = np.mgrid[0:1200:60, 0:1600:60].astype(float)
    uv = np.stack([u, v], -1)
    assert np.abs(strong.to_pixels(strong.to_normalised(uv)) - uv).max() < 1e-9
    with pytest.raises(ValueError, match="cannot be inverted within the image"):
        Lens((600.0, 600.0), (800.0, 600.0), (-0.9, 0.0, 0.0, 0.0, 0.0)).to_normalised(uv)


def test_a_surface_with_the_wrong_number_of_nodes_is_refused() -> None:
    with pytest.raises(ValueError, match="ray shift with 10 coefficients; 4 × 3 intervals need 84"):
        RayShift(1600, 1200, (4, 3), (0.0,) * 10)


def test_a_camera_without_a_place_stands_in_the_left_ones_and_looks_the_same_way() -> None:
    housed = right_camera()
    camera = HousedCamera(1600, 1200, housed.lens, housed.port)
    uv = np.array([[100.0, 200.0], [1500.0, 700.0], [3.0, 1190.0]])
    origin, direction = camera.rays(uv, FRESH)
    wanted_origin, wanted_direction = water_rays(housed.port, FRESH, housed.lens.to_directions(uv))
    np.testing.assert_allclose(origin, wanted_origin, atol=1e-12)
    np.testing.assert_allclose(direction, wanted_direction, atol=1e-12)


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


def test_a_pixel_that_nobody_knows_leaves_the_others_their_directions() -> None:
    lens = Lens((1000.0, 900.0), (10.0, 20.0), (-0.1, 0.05, 1e-3, -1e-3, 0.01))
    uv = np.array([[300.0, 250.0], [np.nan, np.nan], [-200.0, 100.0]])
    found = lens.to_pixels(lens.to_normalised(uv))
    assert np.isnan(found).all(axis=1).tolist() == [False, True, False]
    np.testing.assert_allclose(found[[0, 2]], uv[[0, 2]], atol=1e-9)


def test_a_ray_shift_with_a_wrong_number_of_nodes_is_refused() -> None:
    RayShift(1600, 1200, (4, 3), (0.0,) * 84)
    for count in (83, 85, 42, 126, 0):
        with pytest.raises(ValueError, match=f"ray shift with {count} coefficients; 4 × 3 intervals need 84"):
            RayShift(1600, 1200, (4, 3), (0.0,) * count)


def test_a_strongly_bent_lens_is_inverted_in_three_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Newton's method squares the error with each step, if its slopes are those of the lens."""
    monkeypatch.setattr(pinhole, "MAX_ITERATIONS", 3)
    lens = Lens((1000.0, 900.0), (10.0, 20.0), (-0.3, 0.12, 2e-2, -3e-2, 0.05))
    xy = np.random.default_rng(1).uniform(-0.45, 0.45, (300, 2))
    xy[0], xy[1], xy[2] = (0.0, 0.0), (0.3, 0.0), (0.0, 0.3)
    np.testing.assert_allclose(lens.to_normalised(lens.to_pixels(xy)), xy, atol=2e-10)


def test_the_free_fields_are_as_fine_as_the_documentation_says_and_the_shift_has_square_cells() -> None:
    """docs/calibration.md tells the grids of the image correction, without and with the lenses' fields from air; depth shows less, so
    that the ray shift is coarser."""
    across, down = INTERVALS
    said = (Path(__file__).parents[3] / "docs" / "calibration.md").read_text(encoding="utf-8")
    assert f"of {across} × {down} from a start that has none" in said
    assert (
        f"B-spline per image: of {AIR_INTERVALS[0]} × {AIR_INTERVALS[1]} intervals about the lenses' fields from air"
        in said
    )
    shift_across, shift_down = SHIFT_INTERVALS
    assert 1600 / shift_across == 1200 / shift_down, "square on a sensor of 4 : 3"
    assert 1 / 3 < shift_across * shift_down / (across * down) < 2 / 3


@pytest.mark.parametrize(("angle_mrad", "parallel"), [(0.9, True), (1.1, False), (1.3, False)])
def test_axes_within_a_milliradian_of_each_other_are_parallel(angle_mrad: float, parallel: bool) -> None:
    """Two hundred metres away they would meet."""
    lens = Lens((2500.0, 2500.0), (799.5, 599.5))
    left = HousedCamera(1600, 1200, lens, right_camera().port, lens_in_water=True)
    c, s = np.cos(1e-3 * angle_mrad), np.sin(1e-3 * angle_mrad)
    turned = ((float(c), 0.0, float(-s)), (0.0, 1.0, 0.0), (float(s), 0.0, float(c)))
    rig = StereoRig(left, replace(left, rotation=turned, translation_mm=(230.0, 0.0, 0.0)))
    if parallel:
        with pytest.raises(ValueError, match="parallel; check the calibration"):
            rig.volume_centre_mm(FRESH)
    else:
        assert rig.volume_centre_mm(FRESH)[2] == pytest.approx(230.0 / (1e-3 * angle_mrad), rel=1e-3)
