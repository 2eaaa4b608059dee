"""Owns what a scan was taken with: written beside its frames, and found again at the desk."""

from __future__ import annotations

from appliance.calibration.file import Calibration, encode
from appliance.config import Rig, rig_text
from appliance.storage.scan import Origin


def origin_of(rig: Rig, calibration: Calibration) -> Origin:
    """What a scan that is taken now carries with it: the calibration in use and the rig as it is understood."""
    return Origin(encode(calibration), rig_text(rig).encode())
