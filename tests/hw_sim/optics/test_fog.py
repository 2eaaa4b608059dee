"""What fog on a window does: fringes soften inside the place, mean light hardly, and nothing beyond it."""

from __future__ import annotations

import numpy as np
import pytest

from hw_sim.optics.fog import Fog


def test_fog_takes_detail_keeps_light_and_stays_in_its_place() -> None:
    u = np.arange(400, dtype=np.float32)
    fringes = np.broadcast_to(1000.0 * (1.0 + 0.8 * np.cos(2.0 * np.pi * u / 10.0)), (300, 400)).astype(np.float32)
    fogged = Fog(left=0.5, x=0.3, y=0.5, radius=0.15).over("left", fringes)
    inside, outside = fogged[140:160, 100:140], fogged[140:160, 300:340]
    assert np.ptp(inside) / np.ptp(fringes) == pytest.approx(0.5, abs=0.02)
    assert inside.mean() == pytest.approx(950.0, rel=0.02), "a tenth of what is thrown aside is lost"
    np.testing.assert_allclose(outside, fringes[140:160, 300:340], rtol=2e-3)
    np.testing.assert_array_equal(Fog(left=0.5).over("right", fringes), fringes)


def test_impossible_fog_is_refused() -> None:
    with pytest.raises(ValueError, match=r"fog: left = 1\.5; allowed are 0\.\.1"):
        Fog(left=1.5)
