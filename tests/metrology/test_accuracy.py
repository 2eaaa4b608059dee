"""With the truth as calibration, points lie on the true surface: complete, without outliers, noise as the period tells."""

from __future__ import annotations

import pytest

from hw_sim.objects.shapes import NAMES
from hw_sim.scene import Scene
from tests.support.rendered import judge, reconstruct, render_scan

TO_MEASURE = [name for name in NAMES if name != "board"]
"""Half of a printed board is too dark for fringes, as it must be: it is there for pictures, not for scans."""
STRIP_PX = 120
"""Rows out of the middle: the same fringes on the same surface in a tenth of the time."""


def rms_mm(scene: Scene, width_px: int, period_px: int, exposure_s: float = 0.012) -> float:
    """Return the RMS distance from the true surface of a scan that is complete and without outliers."""
    scan = render_scan(scene, "modelled", 3, width_px, period_px, exposure_s, height_px=STRIP_PX)
    _, cloud = reconstruct(scan)
    result = judge(scan, cloud)
    assert result.completeness_percent >= 95.0
    assert result.outliers_ppm <= 100.0
    return float(result.rms_mm)


@pytest.mark.parametrize("name", TO_MEASURE)
def test_full_resolution(name: str) -> None:
    """At the shortest period; 0.017 to 0.022 mm were found."""
    assert rms_mm(Scene(object=name), 1600, 16) <= 0.025


def test_noise_grows_with_the_period() -> None:
    short, middle, long = (rms_mm(Scene(object="pipe"), 800, period_px) for period_px in (16, 32, 64))
    assert short <= 0.05
    assert 1.6 < middle / short < 2.4
    assert 1.6 < long / middle < 2.4


def test_texture_does_not_make_outliers() -> None:
    """The light blotches of the strong texture would saturate at the exposure that suits an even surface."""
    assert rms_mm(Scene(object="frustum", texture="strong"), 800, 16, 0.008) <= 0.06
