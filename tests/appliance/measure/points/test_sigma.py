"""What a point expects of itself: the share of noise that reading off between pixels leaves, bends, ripple, and no memory."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.measure.points.quality import measure_ripple

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
