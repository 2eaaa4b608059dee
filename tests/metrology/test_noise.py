"""A point's expected error is its error: over distance, period, light and paint; and small enough."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.calibrate.photon_transfer import NoiseError, measure_noise
from appliance.measure.light.patterns import build_sequence
from hw_sim.rendering.sensor import E_PER_DN, FULL_WELL_E, OFFSET_DN, READ_NOISE_E
from hw_sim.scene import Imaging, Scene
from tests.support.bias import depth_errors, rms
from tests.support.rendered import reconstruct, render_scan

SIZE_PX = (1600, 120)
"""Full resolution across; a strip is as good as an image and takes a tenth of the time."""
TILTED = (0.0, 0.0, 522.5, 0.0, 35.0, 0.0)


def residuals(scene: Scene, period_px: int = 16, exposure_s: float = 0.012) -> tuple[np.ndarray, np.ndarray]:
    """Error along the ray in mm, and the same in expected errors; of points that lie on the object's face."""
    scan = render_scan(scene, "modelled", 3, SIZE_PX[0], period_px, exposure_s, height_px=SIZE_PX[1])
    _, cloud = reconstruct(scan)
    errors = depth_errors(scan.renderer, cloud)
    inner = errors.seen & (np.abs(errors.along_ray_mm) < 1.0)
    assert np.mean(inner[errors.seen]) > 0.9999
    along = errors.along_ray_mm[inner]
    return along, along / cloud.sigma_mm[inner]


@pytest.mark.parametrize(
    ("scene", "period_px", "exposure_s"),
    [
        (Scene(object="plane", pose=TILTED, imaging=Imaging("linear")), 64, 0.012),
        (Scene(object="plane", texture="checker", imaging=Imaging("linear")), 16, 0.010),
        (Scene(object="plane", ambient=0.3, imaging=Imaging("linear")), 32, 0.008),
    ],
    ids=["tilted, longest period", "paint", "daylight"],
)
def test_the_expected_error_of_points_is_their_error(scene: Scene, period_px: int, exposure_s: float) -> None:
    _, normalised = residuals(scene, period_px, exposure_s)
    assert rms(normalised) == pytest.approx(1.0, abs=0.10)
    assert np.median(np.abs(normalised)) == pytest.approx(0.6745, rel=0.10), "and is no mean of sure and unsure points"


@pytest.mark.parametrize(
    ("scene", "period_px"),
    [
        (Scene(object="frustum", texture="strong", imaging=Imaging("linear")), 16),
        (Scene(object="stones", texture="checker", ambient=0.2), 32),
    ],
    ids=["painted frustum", "checked stones"],
)
def test_every_point_of_a_bent_steep_and_broken_surface_expects_its_error(scene: Scene, period_px: int) -> None:
    """All points of a small image, where fringes are six pixels wide and a pixel sees two thirds of a millimetre: limbs,
    edges and borders of paint, with the projector's own response."""
    scan = render_scan(scene, "modelled", 3, 400, period_px, 0.010)
    _, cloud = reconstruct(scan)
    errors = depth_errors(scan.renderer, cloud)
    known = np.isfinite(errors.along_ray_mm)
    assert np.mean(known) > 0.999, "the others' pixels look past the object"
    normalised = (errors.along_ray_mm / cloud.sigma_mm)[known]
    kept = np.sort(np.abs(normalised))[: int(0.997 * len(normalised))]
    assert rms(normalised) == pytest.approx(1.0, abs=0.15)
    assert rms(kept) == pytest.approx(1.0, abs=0.10)
    assert np.mean(kept < 1.0) == pytest.approx(0.683, abs=0.05)
    assert np.mean(kept < 2.0) == pytest.approx(0.954, abs=0.02)
    sure = cloud.sigma_mm[known] < np.quantile(cloud.sigma_mm, 0.2)
    unsure = cloud.sigma_mm[known] > np.quantile(cloud.sigma_mm, 0.95)
    assert rms(normalised[sure]) == pytest.approx(1.0, abs=0.15), "the best points"
    assert 0.55 < rms(normalised[unsure]) < 1.2, "those at limbs and edges rather too little than too much"


def test_the_noise_of_a_camera_is_found_in_a_scan() -> None:
    """Judged by the figures of the simulated sensor."""
    scan = render_scan(Scene(object="pipe"), "modelled", 3, 1600, 16, 0.010, height_px=200)
    for frames in scan.frames.values():
        found = measure_noise(scan.sequence, frames)
        light_dn, variance_dn2 = found.variance_at_dn2
        electrons = (light_dn - OFFSET_DN) * E_PER_DN
        assert variance_dn2 == pytest.approx((electrons + READ_NOISE_E**2) / E_PER_DN**2 + 1 / 12, rel=0.05)
        assert found.full_well_e == pytest.approx(FULL_WELL_E, rel=0.08)


def test_images_too_coarse_to_tell_noise_from_fringes_say_so() -> None:
    with pytest.raises(NoiseError, match="fringes of about 3 px in images 200 px wide; needed are 5 px"):
        measure_noise(build_sequence(16), np.zeros((24, 150, 200), np.uint8))
    even = np.random.default_rng(1).normal(92.0, 1.5, (20, 300, 400)).astype(np.uint8)
    with pytest.raises(NoiseError, match="light of 1 levels"):
        measure_noise(build_sequence(64), even)
    with pytest.raises(NoiseError, match="have no noise"):
        measure_noise(build_sequence(64), np.full((20, 300, 400), 90, np.uint8))
