"""A scan whose fringes show too few codes tells no response, and says so."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.calibration.response.measure import CameraImages, ResponseError, measure_response
from appliance.patterns.sequence import build_sequence


def test_two_codes_are_too_few_for_ten_harmonics() -> None:
    """Coordinates that jump by half a period from pixel to pixel have the same two means everywhere."""
    sequence = build_sequence(64, 640, 480)
    frames = np.full((len(sequence), 120, 160), 90, np.uint8)
    frames[sequence.bright], frames[sequence.dark] = 180, 0
    jumps = 200.0 + 32.0 * (np.indices((120, 160)).sum(axis=0) % 2).astype(np.float32)
    with pytest.raises(ResponseError, match=r"does not show enough codes of its fringes to tell .*harmonic \d"):
        measure_response(sequence, [CameraImages(frames, jumps, jumps)])
