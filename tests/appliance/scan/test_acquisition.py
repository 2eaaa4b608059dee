"""What is taken for granted of a sequence of which nothing is said: the instrument's usual exposure and frame rate."""

from __future__ import annotations

import pytest

from appliance.config.load import default_rig_path, load_rig
from appliance.scan.acquisition import AcquisitionSettings
from appliance.scan.exposure import Exposure


def test_a_sequence_of_which_nothing_is_said_was_taken_as_the_shipped_rig_file_says() -> None:
    rig, usual = load_rig(default_rig_path()), AcquisitionSettings()
    assert usual.frame_s == pytest.approx(1.0 / rig.projector.refresh_hz)
    assert usual.exposure == Exposure(round(1000.0 * rig.camera.left.exposure_ms), rig.camera.left.gain_db)
    assert usual.steps == (usual.exposure,), "and none but its own exposure may be proposed"
