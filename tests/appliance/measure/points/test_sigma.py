"""What a point expects of itself: the share of noise that reading off between pixels leaves, bends, ripple, and no memory."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.measure.light.patterns import build_sequence
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.points.quality import measure_ripple
from appliance.measure.points.rows import LeftMaps
from tests.support import synthetic

WIDTH, HEIGHT = 400, 300
NOISE_PX = 0.03


@pytest.mark.parametrize("amplitude_px", [0.0, 0.08])
@pytest.mark.parametrize("slope", [0.65, 2.5])
def test_a_ripple_of_the_projector_is_found_in_the_scan_itself(amplitude_px: float, slope: float) -> None:
    """On a wavy surface with noise, in large and in small images."""
    v, u = np.mgrid[0:600, 0:800].astype(float)
    p = 40.0 + slope * 0.5 * u + 1.5 * np.sin(u / 70.0) + 0.8 * np.cos(v / 50.0 + u / 200.0)
    p = p + amplitude_px * np.sin(8.0 * np.pi * (p + 0.5) / 16.0 + 0.7)
    p += NOISE_PX * np.random.default_rng(2).standard_normal(p.shape)
    p[:, :20] = np.nan
    lit = np.tile(np.array([0, 800], np.int32), (600, 1))
    found = measure_ripple(p.astype(np.float32), lit, 16)
    assert found.amplitude_px == pytest.approx(amplitude_px, abs=0.012)
    assert found.noise_px == pytest.approx(NOISE_PX, rel=0.2)
    assert found.counts == (amplitude_px > 0.0 and slope > 1.0), "wide fringes lose nothing between pixels"


def test_maps_read_between_pixels_are_refused_where_a_camera_has_no_variances() -> None:
    nothing, none = np.full((HEIGHT, WIDTH), np.nan, np.float32), np.zeros((HEIGHT, WIDTH), np.uint8)
    bare = LeftMaps(nothing, nothing, none, none, none, np.zeros((HEIGHT, 2), np.int32))
    known = bare._replace(variance_px2=np.ones_like(nothing))
    with Pipeline(synthetic.calibration(), synthetic.WATER, build_sequence(16)) as pipeline:
        for left, right in ((bare, bare), (known, bare), (bare, known)):
            with pytest.raises(ValueError, match="without variances"):
                pipeline.find_replaced(left, right)
