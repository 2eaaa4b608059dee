"""Each way a camera may see: its pixels and its rays agree, and it answers water as it should."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from appliance.calibration.design import Design, design_calibration
from appliance.optics.correction import ImageCorrection
from appliance.optics.model import HousedCamera
from appliance.optics.pinhole import Lens
from appliance.optics.printed import PrintedCamera
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
        "printed": PrintedCamera(
            1600, 1200, housed.lens, housed.port, housed.rotation, housed.translation_mm, correction
        ),
    }


@pytest.mark.parametrize("name", models())
def test_a_point_on_a_ray_is_seen_at_its_pixel(name: str) -> None:
    camera = models()[name]
    v, u = np.mgrid[0:1200:97, 0:1600:97].astype(float)
    uv = np.stack([u, v], -1)
    for depth_mm in (420.0, 520.0, 650.0):
        origin, direction = camera.rays(uv, FRESH)
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


def test_the_misprint_is_as_large_as_half_a_pixel_at_the_edge() -> None:
    """Beyond what a change of d can mend: the miss of rays at 500 mm, after the best d, in pixels of 0.16 mm."""
    housed = replace(
        right_camera(), rotation=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), translation_mm=(0, 0, 0)
    )
    u = np.linspace(0.0, 1599.0, 41)
    uv = np.stack([u, np.full_like(u, 599.5)], -1)
    origin, direction = housed.rays(uv, FRESH)
    points = origin + 500.0 * direction

    def miss(d_mm: float) -> np.ndarray:
        port = replace(housed.port, distance_mm=d_mm)
        printed = PrintedCamera(1600, 1200, housed.lens, port)
        return np.abs(printed.project(points, FRESH)[:, 0] - u)

    least = min(float(miss(d).max()) for d in np.arange(0.0, 60.0, 0.25))
    assert 0.02 < least < 2.0
