"""What the log, the console and the screen say of the machine: written for people, never as Python prints an object."""

from __future__ import annotations

import logging
import re
from dataclasses import replace

import pytest

from appliance.instrument.machine import events as on
from appliance.instrument.machine.states import Device, Gallery, Part, PartResult, State, boot
from appliance.instrument.ranging.reach import Marks, Range, Reach, Track
from appliance.instrument.screens.review import to_the_minute
from appliance.instrument.screens.views import AimView, CalibrateView, GalleryView, SelfTestView, StoredScan
from appliance.instrument.service.loop import fault_text, log_line
from appliance.instrument.service.view import Surroundings, view_of
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.news import FullCloud, PatternIdentity, ReconstructionFailure, Verdicts
from hw_sim.people import status_file
from tests.appliance.instrument.machine.walks import EVERY_EVENT, UPS, aim, kind, run
from tests.support import news
from tests.support.golden_texts import Says

REPR = re.compile(r"<\w+[.:]|\w\(\w+=|\{'|\['|\(\)|\('|\bNone\b|Device\.|FaultCode\.")
"""``<Device.DISPLAY: 'display'>``, ``Fault(code=…)``, a dict, a list, a tuple."""


def test_no_event_is_logged_as_python_prints_it() -> None:
    lines = {event: line for event in EVERY_EVENT if (line := log_line(event)) is not None}
    said = (on.DeviceUp, on.DeviceDown, on.CaptureFailed, on.SaveFailed)
    told = (PatternIdentity, ReconstructionFailure, Verdicts, FullCloud)
    assert {kind(event) for event in lines} == {*said, *told}
    for level, text in lines.values():
        assert level in (logging.INFO, logging.WARNING)
        assert not REPR.search(text), text


def test_what_happened_is_told_with_its_numbers_and_its_remedy(says: Says) -> None:
    moved = Fault(FaultCode.MOVED, "the hands shook", {"shift_px": 3.14159})
    bent = Fault(FaultCode.GREY_BENT, "set Gamma = 1.0", device="camera.left")
    told = (
        on.DeviceDown(Device.DISPLAY, "/dev/dri/card0 cannot be opened (No such file or directory)"),
        on.DeviceDown(Device.CAMERA_LEFT, "480 Mbit/s", FaultCode.CAMERA_SLOW_LINK),
        on.CaptureFailed(3, moved),
        news.judged(3, (bent,)),
    )
    lines = [log_line(one) for one in told]
    assert [line and line[0] for line in lines] == [logging.WARNING] * 3 + [logging.INFO]
    says("\n".join(line[1] for line in lines if line is not None))
    assert fault_text(Fault(FaultCode.INTERNAL)) == "INTERNAL"
    assert log_line(news.judged(3)) is log_line(news.right(3)) is None


def test_what_the_console_sees_is_written_in_words(says: Says) -> None:
    status = {
        "state": "REVIEW",
        "alerts": [{"code": "MOVED", "headline": "MOVED 3.1 px", "action": "REPEAT"}],
        "keys": {"scan": "SAVE", "back": None},
        "scans": 3,
        "range": {"distance_mm": 498.76543, "word": "OK"},
        "calibration": {"busy": False, "steps": ["M1", "M2"]},
    }
    says(status_file.summary(status))
    assert not REPR.search(status_file.summary(status))
    assert "alerts: none" in status_file.summary({})


NOTHING = Surroundings(left=None, right=None, temperature_c=None, scan=None)


def test_the_gallery_shows_the_scan_that_is_looked_at_and_of_another_that_was_loaded_nothing() -> None:
    machine = replace(aim(), state=State.GALLERY, gallery=Gallery(("000003", "000002"), 1))
    loaded = StoredScan("000002", points=44_597, coverage_percent=81.7)
    view, other = (view_of(machine, replace(NOTHING, shown=one)) for one in (loaded, replace(loaded, scan_id="000003")))
    assert isinstance(view, GalleryView)
    assert isinstance(other, GalleryView)
    assert (view.scan is loaded, view.index, view.count) == (True, 1, 2)
    assert other.scan is not None
    assert (other.scan.scan_id, other.count, other.scan.points) == ("000002", 2, None)
    for empty in (None, Gallery(), Gallery(())):
        blank = view_of(replace(machine, gallery=empty), replace(NOTHING, shown=loaded))
        assert isinstance(blank, GalleryView)
        assert (blank.scan, blank.count) == (None, 0)


@pytest.mark.parametrize("failed", [None, *Part])
def test_all_is_called_ready_only_when_no_line_of_the_self_test_says_otherwise(failed: Part | None) -> None:
    parts = [PartResult(part, part is not failed) for part in Part]
    view = view_of(run(boot(0), *UPS, on.BootFinished(), *parts), NOTHING)
    assert isinstance(view, SelfTestView)
    assert view.finished
    assert view.passed == (failed is None)


@pytest.mark.parametrize("state", [State.AIM, State.CALIBRATE])
def test_where_a_picture_is_aimed_with_the_dots_it_shows_their_marks(state: State) -> None:
    marks = Marks((Track((0.4, 0.5), (0.5, 0.5), (0.6, 0.5)),), ())
    view = view_of(replace(boot(0), state=state), replace(NOTHING, marks=marks))
    assert isinstance(view, AimView | CalibrateView)
    assert view.marks is marks


def shown_aim(*events: on.Event) -> AimView:
    view = view_of(run(aim(), *events), NOTHING)
    assert isinstance(view, AimView)
    return view


@pytest.mark.parametrize("device", [Device.CAMERA_LEFT, Device.CAMERA_RIGHT])
def test_with_one_camera_gone_the_gauge_pretends_no_distance(device: Device) -> None:
    """It went on with a green OK and 515 mm."""
    measured = on.RangeMeasured(Range(515.0, 0.0, 0.3, 2))
    gauge = shown_aim(measured).gauge
    assert gauge is not None
    assert (gauge.word, gauge.distance_mm) == (Reach.OK, 515.0)
    assert shown_aim(on.DeviceDown(device, "gone"), measured).gauge is None


def test_a_date_is_written_as_people_read_it() -> None:
    dates = ("2026-11-26T20:55:56+00:00", "2026-11-26T20:55:56+02:00", "no date")
    assert [to_the_minute(iso) for iso in dates] == ["2026-11-26 20:55 UTC", "2026-11-26 20:55", "no date"]
