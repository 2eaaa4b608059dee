"""Clear water is not taken for milk."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.reconstruct.decode.decoder import CameraDecoder
from appliance.scan.noise import camera_noise
from hw_sim.rendering.sensor import FULL_WELL_E, OFFSET_DN, READ_NOISE_E
from hw_sim.scene import Scene
from tests.support.rendered import RenderedScan, render_scan


@pytest.fixture(scope="module")
def clear() -> RenderedScan:
    return render_scan(Scene(object="stones", texture="strong"), "realistic", 1, 400, 16, 0.010)


@pytest.mark.parametrize("moved_px", [0, 4])
def test_clear_water_is_read_once_also_where_paint_moves(clear: RenderedScan, moved_px: int) -> None:
    """A scan that moved was read twice, for a tenth of a second and more: at borders of paint it is as if there were light beside the fringes."""
    frames = clear.frames["left"].copy()
    for k in (clear.sequence.bright, clear.sequence.dark):
        frames[k] = np.roll(frames[k], moved_px, axis=1)
    decoder = CameraDecoder(clear.sequence, frames.shape[2], frames.shape[1])
    for k in range(len(clear.sequence)):
        decoder.push(frames, k)
    before = decoder.p_px.copy()
    assert not decoder.read_again_through_backscatter(frames, camera_noise(FULL_WELL_E, READ_NOISE_E, OFFSET_DN, 13.0))
    np.testing.assert_array_equal(decoder.p_px, before)
