"""With the truth as calibration, points lie on the true surface: complete, without outliers, noise as the period tells."""

from __future__ import annotations

import pytest

from hw_sim.objects.shapes import NAMES
from hw_sim.scene import Scene
from tests.support.rendered import judge, reconstruct, render_scan

TO_MEASURE = [name for name in NAMES if name != "board"]
"""Half of a printed board is too dark for fringes, as it must be: it is there for pictures, not for scans."""
RMS_LIMIT_MM = {16: 0.05, 32: 0.10, 64: 0.20}
FULL_RMS_MM = 0.025
"""At full resolution and the shortest period; 0.017 to 0.022 were found."""
STRIP_PX = 400
"""Rows out of the middle, at full resolution: the same fringes on the same surface in a third of the time."""


@pytest.mark.parametrize("name", TO_MEASURE)
def test_full_resolution(name: str) -> None:
    """One object in whole images, the others in strips; all in whole images where there is time."""
    scan = render_scan(Scene(object=name), "modelled", 3, 1600, 16, height_px=None if name == "pipe" else STRIP_PX)
    _, cloud = reconstruct(scan)
    result = judge(scan, cloud)
    assert result.completeness_percent >= 95.0
    assert result.outliers_ppm <= 100.0
    assert result.rms_mm <= FULL_RMS_MM


@pytest.mark.long
@pytest.mark.parametrize("period_px", [16, 32, 64])
@pytest.mark.parametrize("name", TO_MEASURE)
def test_whole_images_of_every_object_and_period(name: str, period_px: int) -> None:
    scan = render_scan(Scene(object=name), "modelled", 3, 1600, period_px)
    _, cloud = reconstruct(scan)
    result = judge(scan, cloud)
    assert result.completeness_percent >= 95.0
    assert result.outliers_ppm <= 100.0
    assert result.rms_mm <= RMS_LIMIT_MM[period_px]


def test_noise_grows_with_the_period() -> None:
    rms = []
    for period_px in (16, 32, 64):
        scan = render_scan(Scene(object="pipe"), "modelled", 5, 800, period_px, height_px=STRIP_PX // 2)
        _, cloud = reconstruct(scan)
        result = judge(scan, cloud)
        assert result.completeness_percent >= 95.0
        assert result.rms_mm <= RMS_LIMIT_MM[period_px]
        rms.append(result.rms_mm)
    assert 1.6 < rms[1] / rms[0] < 2.4
    assert 1.6 < rms[2] / rms[1] < 2.4


@pytest.mark.parametrize(("texture", "exposure_s"), [("none", 0.012), ("strong", 0.008)])
def test_texture_does_not_make_outliers(texture: str, exposure_s: float) -> None:
    """The light blotches of the strong texture would saturate at the exposure that suits an even surface."""
    scan = render_scan(Scene(object="frustum", texture=texture), "modelled", 8, 800, 16, exposure_s, STRIP_PX // 2)
    _, cloud = reconstruct(scan)
    result = judge(scan, cloud)
    assert result.completeness_percent >= 95.0
    assert result.outliers_ppm <= 100.0
    assert result.rms_mm <= 0.06
