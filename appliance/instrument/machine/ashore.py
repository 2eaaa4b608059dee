"""Checks ashore, inside of the housing, for faults against which a diver can only switch off and on.

The screen has no room for them. They are written to the journal beside the fault, to ``scans show``, and to
``docs/faults.md``.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from appliance.measure import FaultCode

_CABLE = "check the cable and its connectors inside of the housing, then `kingfisher check`"
_SETTINGS = "compare the camera's section of the rig file with the camera: `kingfisher check`"
_TRIGGER = "check the trigger cables from the board to both cameras, then `kingfisher check`"

ASHORE: Mapping[FaultCode, str] = MappingProxyType(
    {
        FaultCode.CAMERA_LOST: _CABLE,
        FaultCode.CAMERA_SLOW_LINK: _CABLE,
        FaultCode.PROJECTOR_LOST: _CABLE,
        FaultCode.DISPLAY_LOST: _CABLE,
        FaultCode.BOARD_LOST: _CABLE,
        FaultCode.KEYS_LOST: _CABLE,
        FaultCode.VSYNC_LOST: "check the video cable to the projector, and the board's tap of it",
        FaultCode.PROJECTOR_DARK: "check the lamp and the video cable of the projector",
        FaultCode.PROJECTOR_TIMING: "look for `PROJECTOR_TIMING` in the journal: the latency is `projector.latency_blanks` of the rig file",
        FaultCode.CAMERA_SILENT: _TRIGGER,
        FaultCode.SYNC_LOST: _TRIGGER,
        FaultCode.CAMERA_TOO_SLOW: _SETTINGS,
        FaultCode.CAMERA_REFUSED: _SETTINGS,
        FaultCode.PICTURE_MIRRORED: "correct the settings of camera or projector that mirror the image",
        FaultCode.SIDES_EXCHANGED: "exchange both serials in the rig file: left and right camera are exchanged",
        FaultCode.GREY_BENT: "switch gamma and look-up table of that camera off",
        FaultCode.DISK_READ_ONLY: "look for disk errors in the journal, and replace the disk",
        FaultCode.DISK_REFUSES: "look for disk errors in the journal, and replace the disk",
        FaultCode.STORAGE_FULL: "copy the scans to a desk, and remove them from the instrument",
        FaultCode.WINDOW: "wipe the window; fog inside means moist air: dry the housing",
    }
)
