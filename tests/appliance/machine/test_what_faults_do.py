"""What each fault costs: which ones refuse a scan, end a capture, put out the light, spoil what was recorded."""

from __future__ import annotations

import pytest

from appliance.machine import effects as do
from appliance.machine import events as on
from appliance.machine.alerts import RULES, action_of
from appliance.machine.permissions import may_light
from appliance.machine.states import State
from appliance.machine.words import Language
from appliance.scan.fault import Fault, FaultCode
from drivers.api import Key
from tests.appliance.machine.walks import after, aim, capturing, in_gallery, reconstructing, run

C = FaultCode
NEEDED = {C.CAMERA_LOST, C.CAMERA_SLOW_LINK, C.CAMERA_REFUSED, C.PROJECTOR_LOST, C.BOARD_LOST, C.VSYNC_LOST, C.LASER_ON}
"""What a sequence cannot do without."""
HEAT_AND_WATER = {C.HOT, C.TOO_HOT, C.LEAK}
NOWHERE_TO_KEEP = {C.STORAGE_FULL, C.DISK_READ_ONLY, C.DISK_REFUSES}
WITNESSES = {
    *(C.FRAME_MISSING, C.FRAME_REPEATED, C.FRAME_ORDER, C.FRAME_TRUNCATED, C.FRAME_CORRUPT, C.CAMERA_STUCK),
    *(C.CAMERA_TOO_SLOW, C.CAMERA_SILENT),
    *(
        C.PATTERN_WRONG,
        C.PICTURE_MIRRORED,
        C.SYNC_LOST,
        C.LATE_FLIP,
        C.PROJECTOR_TIMING,
        C.PROJECTOR_DARK,
        C.PULSE_MISSING,
    ),
    *(C.CAPTURE_TIMEOUT, C.BOARD_RESET, C.INTERNAL),
}
"""Frames, flips and pulses did not agree, or nobody knows what happened: no point of such a scan can be believed."""


@pytest.mark.parametrize("code", FaultCode)
def test_a_capture_ends_for_what_it_needs_for_heat_and_for_water_and_for_nothing_else(code: FaultCode) -> None:
    machine = run(capturing(), on.ConditionRaised(Fault(code)))
    assert (machine.state is not State.CAPTURE) == (code in NEEDED | HEAT_AND_WATER)


@pytest.mark.parametrize("code", FaultCode)
def test_a_scan_is_refused_for_what_it_needs_and_where_it_could_not_be_kept(code: FaultCode) -> None:
    machine = run(aim(), on.ConditionRaised(Fault(code)), on.KeyPressed(Key.SCAN))
    refused = code in NEEDED | HEAT_AND_WATER | NOWHERE_TO_KEEP | {C.SUPPLY_LOW}
    assert (machine.state is not State.ARMED) == refused


@pytest.mark.parametrize("code", FaultCode)
def test_light_goes_out_for_heat_and_water_alone(code: FaultCode) -> None:
    assert may_light(run(aim(), on.ConditionRaised(Fault(code)))) == (code not in HEAT_AND_WATER)


@pytest.mark.parametrize("code", FaultCode)
def test_a_scan_whose_witnesses_disagree_is_dropped_and_any_other_is_offered(code: FaultCode) -> None:
    machine, effects = after(reconstructing(), on.ReconstructionFailed(1, Fault(code, "because")))
    dropped = any(isinstance(effect, do.Reject) for effect in effects)
    assert dropped == (code in WITNESSES)
    assert (machine.state is State.REVIEW) == (not dropped)


def test_what_doubts_lengths_is_no_scan_to_call_good() -> None:
    assert {code for code, rule in RULES.items() if rule.doubts_lengths} == {
        *(C.UNCALIBRATED, C.LENGTH_ERROR, C.VERIFY_CALIBRATION)
    }


@pytest.mark.parametrize(
    ("device", "action"),
    [
        ("camera.left", "LEFT CAMERA EXCHANGED"),
        ("camera.right", "RIGHT CAMERA EXCHANGED"),
        ("cameras", "CAMERAS EXCHANGED"),
        (None, "LENGTHS NOT TRUSTED"),
        ("board", "LENGTHS NOT TRUSTED"),
    ],
)
def test_an_exchanged_camera_is_named_as_the_reason(device: str | None, action: str) -> None:
    assert action_of(Fault(C.UNCALIBRATED, device=device)) == action
    german = action_of(Fault(C.UNCALIBRATED, device=device), Language.GERMAN)
    assert german != action
    assert (german == action_of(Fault(C.UNCALIBRATED), Language.GERMAN)) == (not action.endswith("EXCHANGED"))
    assert action_of(Fault(C.CAMERA_LOST, device=device)) == "OFF AND ON, OR END DIVE"


def test_in_the_gallery_only_up_and_down_turn_the_pages() -> None:
    machine = in_gallery()
    assert after(machine, on.KeyPressed(Key.SCAN)) == (machine, [])
    older, effects = after(machine, on.KeyPressed(Key.DOWN))
    assert effects == [do.ShowGalleryScan("000002")]
    assert after(older, on.KeyPressed(Key.UP))[1] == [do.ShowGalleryScan("000003")]
    assert after(machine, on.KeyPressed(Key.UP))[1] == [], "it is the newest"
