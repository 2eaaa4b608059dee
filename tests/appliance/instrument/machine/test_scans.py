"""What becomes of a scan event by event, what the diver sees of it, and what the instrument does for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from appliance.instrument.machine import effects as do
from appliance.instrument.machine import events as on
from appliance.instrument.machine import scanning
from appliance.instrument.machine.conditions import has, other_exposure, second_exposure
from appliance.instrument.machine.saving import late
from appliance.instrument.machine.states import Device, Ending, Machine, State
from appliance.instrument.machine.step import step
from appliance.instrument.ranging.reach import Range
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.light.exposure import NOMINAL, Exposure
from drivers.api import BoardBooted, Key, KeyLongPress, KeyPress, KeyStuck
from tests.appliance.instrument.machine import walks as at
from tests.appliance.instrument.machine.courses import (
    BACK,
    DOWN,
    EIO,
    HOLD_DOWN,
    LEAK,
    SCAN,
    STOP,
    Then,
    codes,
    course,
    raised,
    seen,
    shown,
    wait,
)  # fmt: skip
from tests.appliance.instrument.machine.walks import HOLD_BACK, MISSING, SUMMARY, after, aim, heartbeat, labels, run
from tests.support import news

C, S = FaultCode, State
LIT = do.GoLive(light=True, lasers=True, exposure=NOMINAL)
DIED = Fault(C.RECONSTRUCTION_FAILED, "worker exited with 9")
LATE = Fault(C.LATE_FLIP, "frame 9", {"frame": 9})
MOVED = Fault(C.MOVED, "", {"shift_px": 1.84})
SPOILT = Fault(C.PATTERN_WRONG)
SHORTER, SECOND = Exposure(8_000), Exposure(3_200)
FAR = on.RangeMeasured(Range(700.0, 0.0, 0.5, 2))
SAVED = on.Saved(1, "000001")
LEFT_GONE, BOARD_GONE = on.DeviceDown(Device.CAMERA_LEFT, "gone"), on.DeviceDown(Device.BOARD, "gone")
FULL_DISK = on.StorageCounted(3, "000003", 0)
REFUSED = on.SaveFailed(1, EIO)


def coarse() -> Machine:
    return run(at.reconstructing(), news.coarse(1, SUMMARY))


def proposed() -> Machine:
    return run(at.reviewing(), news.judged(1, (Fault(C.TOO_BRIGHT),), SHORTER))


def taken() -> Machine:
    again = (on.Armed(2), on.CaptureFinished(2), news.full(2, SUMMARY), news.judged(2))
    return run(proposed(), DOWN, *HOLD_BACK, SCAN, *again)


def offered() -> Machine:
    """In review, and a second exposure would add to the scan."""
    return run(at.reviewing(), news.full(1, SUMMARY), news.judged(1, (), None, SECOND))


def adding() -> Machine:
    return run(offered(), *HOLD_DOWN, on.Armed(2))


def added() -> Machine:
    return run(adding(), on.CaptureFinished(2))


def merged() -> Machine:
    return run(added(), news.merged(1, SUMMARY))


def kept_and_refused() -> Machine:
    return run(at.kept_before_the_cloud(), REFUSED)


def wet() -> Machine:
    """The leak came 20 s after the save began."""
    return run(at.saving(), on.Tick(at.saving().now_ns + 20 * at.SECOND_NS), *LEAK)


@pytest.mark.parametrize(
    ("start", "events", "facts"),
    [
        course("armed in the dark", aim, SCAN, state=S.ARMED, effects=[do.Wish.DARK, do.Arm(1, 16, NOMINAL)]),
        course("captured", at.armed, on.Armed(1), state=S.CAPTURE, effects=[do.Capture(1)]),
        course("stored and looked at", at.capturing, on.CaptureFinished(1), state=S.CHECK,
               effects=[do.StoreRaw(1), do.Wish.RECONSTRUCT]),
        course("patterns are right", at.checking, news.right(1), state=S.RECONSTRUCT),
        course("patterns are told right after the cloud", at.checking, news.coarse(1, SUMMARY), news.right(1), state=S.REVIEW),
        course("kept", at.reviewing, SCAN, state=S.SAVING, effects=[do.Publish(1)], just_saved=None),
        course("saved", at.saving, SAVED, state=S.AIM, just_saved="000001", last_scan="000001", effects=[LIT]),
        course("and news of before is old then", at.saving, on.FaultReported(Fault(C.RESTARTED)), SAVED, shown=[]),
        course("said until the next key", at.saving, SAVED, DOWN, just_saved=None),
        course("kept before the full cloud it waits", coarse, SCAN, state=S.SAVING, effects=[]),
        course("and is saved with it", coarse, SCAN, news.full(1, SUMMARY), effects=[do.Publish(1)]),
        # What ends a capture.
        course("a missing frame", at.capturing, on.CaptureFailed(1, MISSING), state=S.AIM, shown=[("INCOMPLETE 23/24", "REPEAT")], on_scan="REPEAT"),
        course("is repeated by OK", at.capturing, on.CaptureFailed(1, MISSING), SCAN, among=do.Arm(2, 16, NOMINAL), shown=[]),
        course("a camera unplugged", at.capturing, LEFT_GONE, state=S.AIM, effects=[do.Wish.ABORT_CAPTURE, LIT],
               shown=[("SCAN FAILED", "LEFT CAM LOST: REPEAT"), ("LEFT CAM LOST", "OFF AND ON, OR END DIVE")]),
        course("heat", at.capturing, heartbeat(temperature_case_c=60.0), first=("SCAN FAILED", "HOT 60 °C: REPEAT")),
        course("a late flip is repeated once in silence", at.capturing, on.CaptureFailed(1, LATE), state=S.ARMED, shown=[],
               effects=[do.Arm(2, 16, NOMINAL)]),
        course("then named", at.capturing, on.CaptureFailed(1, LATE), on.Armed(2), on.CaptureFailed(2, LATE), state=S.AIM,
               shown=[("PROJECTOR LATE", "REPEAT")]),
        course("and anew for the next press", at.capturing, on.CaptureFailed(1, LATE), on.Armed(2), on.CaptureFailed(2, LATE), SCAN,
               on.Armed(3), on.CaptureFailed(3, LATE), state=S.ARMED),
        course("a laser found on is given time", at.capturing, heartbeat(right_on=True), state=S.CAPTURE),
        course("and then believed", at.capturing, heartbeat(right_on=True), on.Tick(2 * at.SECOND_NS), heartbeat(right_on=True),
               among=do.Wish.ABORT_CAPTURE, effects=[do.Wish.ABORT_CAPTURE, do.GoLive(light=True, lasers=False, exposure=NOMINAL)]),
        course("a board reset", at.capturing, BoardBooted("1.0", "B1", "BROWNOUT"), effects=[do.Wish.ABORT_CAPTURE, LIT]),
        course("can be repeated at once", at.capturing, BoardBooted("1.0", "B1", "BROWNOUT"), SCAN, state=S.ARMED),
        course("a board reset while aiming", aim, BoardBooted("1.0", "B1", "BROWNOUT"), effects=[LIT], codes=[C.BOARD_RESET]),
        course("a full disk ends none", at.capturing, FULL_DISK, state=S.CAPTURE),
        # What refuses one.
        course("a camera lost is told", aim, on.DeviceDown(Device.CAMERA_RIGHT, "gone"), effects=[LIT],
               shown=[("RIGHT CAM LOST", "OFF AND ON, OR END DIVE")]),
        course("and refuses", aim, on.DeviceDown(Device.CAMERA_RIGHT, "gone"), SCAN, state=S.AIM, effects=[],
               shown=[("RIGHT CAM LOST", "SCAN REFUSED")]),
        course("which can be read although it is back", aim, LEFT_GONE, SCAN, on.DeviceUp(Device.CAMERA_LEFT), wait(1.9),
               shown=[("LEFT CAM LOST", "SCAN REFUSED")]),
        course("for two seconds", aim, LEFT_GONE, SCAN, on.DeviceUp(Device.CAMERA_LEFT), wait(2.0), shown=[]),
        course("a slow link", aim, on.DeviceDown(Device.CAMERA_LEFT, "480 Mbit/s", C.CAMERA_SLOW_LINK), SCAN, state=S.AIM,
               codes=[C.CAMERA_SLOW_LINK]),
        course("keys and display are not needed", aim, on.DeviceDown(Device.DISPLAY, "gone"), on.DeviceDown(Device.KEYS, "gone"), SCAN,
               state=S.ARMED),
        course("a full disk", aim, FULL_DISK, SCAN, state=S.AIM),
        course("a laser that stays on", at.capturing, on.CaptureFailed(1, Fault(C.LASER_ON, "left")), SCAN, wait(5.0), heartbeat(left_on=True),
               state=S.AIM, first=("LASER ON", "SCAN REFUSED")),
        course("until it is seen off", at.capturing, on.CaptureFailed(1, Fault(C.LASER_ON, "left")), SCAN, wait(5.0), heartbeat(), shown=[]),
        # Outside of the volume SCAN asks once more.
        course("too far", aim, FAR, SCAN, state=S.AIM, effects=[], full="FAR 700 mm", on_scan="ANYWAY"),
        course("too near", aim, on.RangeMeasured(Range(401.0, 2.0, 0.4, 2)), SCAN, state=S.AIM, full="NEAR 401 mm"),
        course("pressed again", aim, FAR, SCAN, wait(9.9), SCAN, state=S.ARMED),
        course("after ten seconds it is asked anew", aim, FAR, SCAN, wait(10.0), SCAN, state=S.AIM),
        course("hands that tremble at the limit", aim, *(on.RangeMeasured(Range(d, 0.0, 0.3, 2)) for d in (558.0, 562.0)), SCAN, state=S.ARMED),
        course("once outside, a little inside is not enough", aim, *(on.RangeMeasured(Range(d, 0.0, 0.3, 2)) for d in (566.0, 558.0)), SCAN,
               state=S.AIM),
        course("not known is not outside", aim, on.RangeMeasured(None), SCAN, state=S.ARMED),
        course("one dot is enough", aim, on.RangeMeasured(Range(500.0, None, 1.0, 1)), SCAN, state=S.ARMED),
        course("a distance is forgotten with the lasers", aim, on.RangeMeasured(Range(500.0, 1.0, 0.3, 2)), SCAN, range=None),
        course("also one that is told after", aim, SCAN, on.RangeMeasured(Range(480.0, 1.0, 0.3, 2)), state=S.ARMED, range=None),
        # The review.
        course("a dead worker leaves the frames", at.reconstructing, news.failed(1, DIED), state=S.REVIEW, effects=[],
               shown=[("PROCESS LATER", "KEEP RAW FRAMES OR REPEAT")]),
        course("to be kept", at.reconstructing, news.failed(1, DIED), SCAN, effects=[do.Publish(1)]),
        course("a late cloud is welcome", at.reconstructing, news.failed(1, DIED), news.full(1, SUMMARY), cloud=SUMMARY, shown=[]),
        course("a hanging worker is given up", at.reconstructing, wait(61.0), state=S.REVIEW, effects=[do.Wish.CANCEL_RECONSTRUCTION]),
        course("also while the save waits", at.kept_before_the_cloud, wait(61.0), effects=[do.Wish.CANCEL_RECONSTRUCTION, do.Publish(1)]),
        course("a wrong pattern is no cloud", at.reconstructing, news.wrong(1, Fault(C.PROJECTOR_TIMING, "one frame late")),
               state=S.AIM, among=do.Reject(1, "one frame late"), codes=[C.PROJECTOR_TIMING]),
        course("without a sentence it is rejected by its name", at.reconstructing, news.wrong(1, SPOILT),
               among=do.Reject(1, "PATTERN_WRONG")),
        course("a moved scan says so", coarse, news.judged(1, (MOVED,)), news.full(1, SUMMARY, MOVED), shown=[("MOVED 1.8 px", "REPEAT")]),
        course("and can be kept", coarse, news.judged(1, (MOVED,)), SCAN, state=S.SAVING),
        course("the judges' last word counts", coarse, news.judged(1, (MOVED,)), news.judged(1), shown=[]),
        course("which comes with the full cloud", coarse, news.judged(1, (MOVED,)), news.full(1, SUMMARY), shown=[]),
        course("of this scan", coarse, news.judged(2, (MOVED,)), shown=[]),
        *(course(f"a glove on BACK costs nothing in {way.__name__}", way, BACK, state=way().state, scan=way().scan, effects=[],
                 on_back="HOLD: REDO") for way in (at.checking, at.reconstructing, at.reviewing)),
        course("held since before there was a scan", aim, BACK, SCAN, on.Armed(1), on.CaptureFinished(1), KeyLongPress(Key.BACK, 0), effects=[],
               state=S.CHECK),
        course("held without a cloud", at.checking, *HOLD_BACK, state=S.AIM,
               effects=[do.Wish.CANCEL_RECONSTRUCTION, do.Reject(1, "rejected before the cloud was ready"), LIT]),
        course("held with a part of it", coarse, *HOLD_BACK, effects=[do.Wish.CANCEL_RECONSTRUCTION, do.Reject(1, "rejected by the diver"), LIT]),
        course("held with all of it", at.reviewing, *HOLD_BACK, state=S.AIM, effects=[do.Reject(1, "rejected by the diver"), LIT]),
        course("the same press does not switch off", at.reviewing, *HOLD_BACK, KeyLongPress(Key.BACK, 0), state=S.AIM, asked=False),
        # The exposure.
        course("proposed", proposed, on_down="EXPOSE 8 ms"),
        course("taken, and shown live before the scan", proposed, DOWN, *HOLD_BACK, among=do.GoLive(light=True, lasers=True, exposure=SHORTER)),
        course("the next scan has it", proposed, DOWN, *HOLD_BACK, SCAN, among=do.Arm(2, 16, SHORTER)),
        course("taken back by the same key", proposed, DOWN, on_down="EXPOSE 12 ms"),
        course("and then as before", proposed, DOWN, DOWN, exposure=NOMINAL, on_down="EXPOSE 8 ms"),
        course("the scan is kept all the same", proposed, DOWN, SCAN, state=S.SAVING),
        course("nothing is proposed where light was right", taken, on_down=None),
        course("it stays", taken, DOWN, *HOLD_BACK, exposure=SHORTER),
        course("also for a calibration", taken, *HOLD_BACK, *(KeyPress(k, 0) for k in (Key.UP, *at.TO_CALIBRATION)), SCAN,
               among=do.Arm(3, 16, SHORTER)),
        course("no proposal, no change", at.reviewing, DOWN, exposure=NOMINAL),
        course("BACK is stuck", proposed, KeyStuck(Key.BACK), DOWN, exposure=NOMINAL),
        course("more gain is named as such", proposed, news.judged(1, (), Exposure(12_000, 4.0)), on_down="GAIN 4 dB"),
        # A second exposure.
        course("offered", offered, on_down="HOLD: ADD 3.2 ms"),
        course("recorded", offered, *HOLD_DOWN, among=do.Arm(2, 16, SECOND, second=True), never=(do.Reject, do.StoreRaw)),
        course("worked out", adding, on.CaptureFinished(2), among=do.Wish.RECONSTRUCT, never=(do.Reject, do.StoreRaw)),
        course("merged, and its frames made durable, too", added, news.merged(1, replace(SUMMARY, points=1500)), state=S.REVIEW,
               effects=[do.StoreRaw(1)], cloud=replace(SUMMARY, points=1500), on_down=None, exposure=NOMINAL),
        course("what is held against either is held against both, but for the light", added, news.judged(1, (MOVED, Fault(C.TOO_BRIGHT)), None, SECOND),
               news.merged(1, SUMMARY, Fault(C.TOO_DARK), Fault(C.WATER_DIRTY)), codes=[C.MOVED, C.WATER_DIRTY]),
        course("two are kept", merged, SCAN, among=do.Publish(1)),
        course("their frames are stored again", merged, REFUSED, wait(5.0), effects=[do.StoreRaw(1)]),
        course("wrong points are not added to", offered, news.judged(1, (Fault(C.MOVED),), None, SECOND), on_down=None),
        course("a part of a cloud is not added to", coarse, news.judged(1, (), None, SECOND), on_down=None),
        course("a glove that brushes DOWN", offered, DOWN, state=S.REVIEW, exposure=NOMINAL, scan=offered().scan),
        course("one that lay on it before the offer", at.reviewing, DOWN, news.full(1, SUMMARY), news.judged(1, (), None, SECOND),
               KeyLongPress(Key.DOWN, 0), state=S.REVIEW, on_down="HOLD: ADD 3.2 ms"),
        course("refused, and the review goes on", offered, BOARD_GONE, *HOLD_DOWN, state=S.REVIEW, effects=[], scan=offered().scan,
               first=("BOARD LOST", "SCAN REFUSED")),
        *(course(f"the press that stops {way.__name__} held on", way, *HOLD_BACK, state=S.REVIEW, never=do.Reject) for way in (adding, added)),
        course("and the next one rejects", added, *HOLD_BACK, *HOLD_BACK, state=S.AIM, among=do.Reject(1, "rejected by the diver")),
        course("whatever lasts, BACK gives it up first", added, raised(C.UNCALIBRATED), BACK, state=S.REVIEW, acknowledged=()),
        course("while it is worked out the first is not rejected", added, KeyLongPress(Key.BACK, 0), never=do.Reject),
        *(course(f"a leak while {way.__name__} saves the first", way, *LEAK, state=S.SAFE, among=do.Publish(1)) for way in (adding, added)),
        # The disk.
        course("a refused scan comes back", at.saving, REFUSED, state=S.REVIEW, codes=[C.NOT_SAVED]),
        course("and is tried by OK", at.refused_by_the_disk, SCAN, effects=[do.Publish(1)]),
        course("saved it says so", at.refused_by_the_disk, SCAN, SAVED, shown=[], just_saved="000001", state=S.AIM),
        course("it is tried again unasked", at.refused_by_the_disk, wait(4.9), effects=[]),
        course("after five seconds", at.refused_by_the_disk, wait(5.0), effects=[do.Publish(1)]),
        course("three times", at.refused_by_the_disk, wait(5.0), REFUSED, wait(5.0), REFUSED, wait(5.0), effects=[do.Publish(1)]),
        course("and not for ever", at.refused_by_the_disk, *(wait(5.0), REFUSED) * 3, wait(3600.0), effects=[], state=S.REVIEW),
        course("but when the diver asks", at.refused_by_the_disk, *(wait(5.0), REFUSED) * 3, SCAN, REFUSED, wait(5.0), effects=[do.Publish(1)]),
        course("it can be given up", at.refused_by_the_disk, *HOLD_BACK, state=S.AIM, scan=None, among=do.Reject(1, "rejected by the diver")),
        course("a disk that never answers", at.saving, wait(61.0), state=S.REVIEW, codes=[C.NOT_SAVED]),
        course("is believed when it does", at.saving, wait(61.0), SAVED, just_saved="000001"),
        course("raw frames are refused", at.reconstructing, REFUSED, wait(4.9), effects=[], codes=[C.NOT_SAVED]),
        course("and stored again", at.reconstructing, REFUSED, wait(5.0), effects=[do.StoreRaw(1)]),
        course("which ends the message", at.reconstructing, REFUSED, wait(5.0), on.RawStored(1), shown=[]),
        course("kept and refused it waits", kept_and_refused, news.full(1, SUMMARY), state=S.SAVING, effects=[]),
        course("until that is tried again", kept_and_refused, news.full(1, SUMMARY), wait(5.0), effects=[do.Publish(1)]),
        course("without a cloud not for ever", kept_and_refused, wait(60.0), wait(1.0), state=S.SAVING, effects=[do.Publish(1)]),
        course("of another scan", at.reconstructing, on.SaveFailed(7, EIO), scan=at.reconstructing().scan, codes=[C.NOT_SAVED]),
        course("a disk that tells no number is as full as it was", aim, FULL_DISK, on.StorageCounted(3, "000003", None), codes=[C.STORAGE_FULL]),
        course("one that has room again is not", aim, FULL_DISK, on.StorageCounted(2, "000002", 1), codes=[]),
        # The end.
        course("stopping waits for the save", at.saving, STOP, state=S.SAVING, effects=[]),
        course("and for nothing else", at.saving, STOP, SAVED, effects=[do.Quit(power_off=False)]),
        course("kept before its cloud it is saved with it", at.kept_before_the_cloud, STOP, news.full(1, SUMMARY), effects=[do.Publish(1)]),
        course("a worthless one keeps nobody", at.kept_before_the_cloud, STOP, news.wrong(1, SPOILT), state=S.SHUTDOWN,
               among=(do.Reject(1, "PATTERN_WRONG"), do.Quit(power_off=False))),
        *(course(f"stopped in {way().state.value}", way, STOP, state=S.SHUTDOWN, effects=[*ends, do.Quit(power_off=False)]) for way, ends in (
            (aim, [do.Wish.DARK]), (at.armed, [do.Wish.ABORT_CAPTURE]), (at.capturing, [do.Wish.ABORT_CAPTURE]),
            (at.checking, [do.Wish.CANCEL_RECONSTRUCTION]), (at.reconstructing, [do.Wish.CANCEL_RECONSTRUCTION]), (at.reviewing, []),
        )),
        course("a leak ends a capture", at.capturing, *LEAK, state=S.SAFE, effects=[do.Wish.DARK, do.Wish.ABORT_CAPTURE]),
        course("a leak publishes what nobody will be asked about", at.reviewing, *LEAK, effects=[do.Wish.DARK, do.Publish(1)]),
        course("a leak waits for the cloud", at.reconstructing, *LEAK, SCAN, state=S.SAFE, effects=[], on_scan=None),
        course("which is saved", at.safe_with_a_scan, news.coarse(1, SUMMARY), news.full(1, SUMMARY), SCAN, state=S.SAFE,
               among=do.Publish(1), effects=[], on_scan=None),
        course("and kept", at.safe_with_a_scan, news.full(1, SUMMARY), SAVED, state=S.SAFE, scan=None, last_scan="000001"),
        course("refused it is tried by SCAN", at.safe_with_a_scan, news.full(1, SUMMARY), REFUSED, SCAN, effects=[do.Publish(1)]),
        course("but not for ever", at.safe_with_a_scan, wait(60.0), effects=[do.Wish.CANCEL_RECONSTRUCTION, do.Publish(1)]),
        course("worthless it is put away in the dark", at.safe_with_a_scan, news.wrong(1, SPOILT), state=S.SAFE, scan=None,
               deadline_ns=None, among=do.Reject(1, "PATTERN_WRONG")),
        course("a save under way keeps its time", wet, wait(39.9), state=S.SAFE, publishing=True),
        course("and no more", wet, wait(40.0), publishing=False, codes=[C.LEAK, C.NOT_SAVED]),
        # Nothing comes too late to be wrong.
        course("a late tick", aim, on.Tick(100 * at.SECOND_NS), on.Tick(at.SECOND_NS), SCAN, on.Armed(1), wait(5.399), state=S.CAPTURE,
               now_ns=105_399_000_000),
    ],
)  # fmt: skip
def test_a_scan_takes_its_course(
    start: Callable[[], Machine], events: tuple[Then, ...], facts: dict[str, object]
) -> None:
    assert seen(start, events, facts) == facts


def again() -> Machine:
    return run(at.capturing(), BACK, SCAN, on.Armed(2))


CLOUDS = (
    news.coarse(1, SUMMARY),
    news.full(1, SUMMARY),
    news.failed(1, MISSING),
    news.right(1),
)
PAIR = (news.merged(1, SUMMARY), news.not_merged(1, DIED))


@pytest.mark.parametrize(
    ("way", "events"),
    [
        (lambda: run(at.capturing(), LEFT_GONE), (on.CaptureFailed(1, MISSING),)),
        (lambda: run(at.capturing(), BACK, SCAN), (on.Armed(1),)),
        (again, (on.CaptureFailed(1, MISSING), on.CaptureFinished(1))),
        (lambda: run(again(), on.CaptureFinished(2)), CLOUDS),
        (added, (news.merged(2, SUMMARY), news.not_merged(2, DIED))),
        (offered, PAIR), (at.reconstructing, PAIR), (lambda: run(added(), BACK), (*PAIR, news.failed(1, DIED))), (lambda: run(added(), *LEAK), PAIR),
        (lambda: run(at.checking(), news.coarse(1, SUMMARY)), (news.right(1),)),
        (aim, (on.BootFinished(),)), (at.reviewing, (on.BootFinished(),)), (at.safe, (on.BootFinished(),)),
        (lambda: run(at.in_gallery(), BACK), (on.ScansListed(("000009",)),)),
    ],
)  # fmt: skip
def test_answers_that_nobody_waits_for_change_nothing(way: Callable[[], Machine], events: tuple[on.Event, ...]) -> None:
    for event in events:
        assert step(way(), event) == (way(), ())


def test_what_is_told_of_a_scan_that_is_being_published_comes_too_late() -> None:
    for event in (news.full(1, SUMMARY), news.wrong(1, SPOILT), news.failed(1, DIED)):
        machine, effects = after(at.saving(), event)
        assert (machine.state, machine.scan is not None and machine.scan.publishing, effects) == (S.SAVING, True, [])


@pytest.mark.parametrize(
    "lost",
    [
        (BACK,), (on.Armed(2), BACK), (on.CaptureFailed(2, MISSING),), (on.Armed(2), BOARD_GONE), (on.Armed(2), BoardBooted("1.0", "B1", "WATCHDOG")),
        (on.Armed(2), wait(10_000)), (on.Armed(2), on.CaptureFinished(2), BACK), (on.Armed(2), on.CaptureFinished(2), wait(10_000)),
        (on.Armed(2), on.CaptureFinished(2), news.not_merged(1, Fault(C.MOVED))), (on.Armed(2), on.CaptureFinished(2), news.failed(1, DIED)),
    ],
)  # fmt: skip
def test_whatever_ends_the_second_exposure_the_first_scan_is_reviewed_as_before(lost: tuple[Then, ...]) -> None:
    kinds = do.Reject, do.Wish.CANCEL_RECONSTRUCTION
    facts = {"state": S.REVIEW, "scan": offered().scan, "never": kinds}
    assert seen(offered, (*HOLD_DOWN, *lost), facts) == facts
    kept = {"among": do.Publish(1)}
    assert seen(offered, (*HOLD_DOWN, *lost, SCAN), kept) == kept
    machine = offered()
    for event in (*HOLD_DOWN, *lost):
        machine = run(machine, event(machine) if callable(event) else event)
    said = shown(machine)[:1]
    assert bool(said) == (lost[-1] is not BACK), "who pressed BACK is told nothing"
    assert all(headline == "NOT ADDED" and action.endswith("FIRST KEPT") for headline, action in said)


def test_exposures_are_proposed_and_added_in_the_review_only() -> None:
    proposal, offer = news.judged(1, (), SHORTER), news.judged(1, (), None, SECOND)
    assert (other_exposure(proposed()), second_exposure(offered())) == (SHORTER, SECOND)
    for way in (at.checking(), run(at.reviewing(), SCAN), aim()):
        assert (other_exposure(run(way, proposal)), second_exposure(run(way, offer))) == (None, None)
    assert other_exposure(at.reviewing()) is None
    for judged in (news.judged(1), news.judged(1, (Fault(C.MOVED),))):
        assert Key.DOWN not in labels(run(at.reviewing(), judged)), "DOWN means the exposure, or nothing"


def test_late_flips_alone_are_repeated_in_silence() -> None:
    for code in C:
        assert (run(at.capturing(), on.CaptureFailed(1, Fault(code))).state is S.ARMED) == (code is C.LATE_FLIP)


@pytest.mark.parametrize(
    ("named", "reopened"), [("camera.right", Device.CAMERA_RIGHT), ("camera.left", Device.CAMERA_LEFT), (None, None), ("cameras", None)]
)  # fmt: skip
def test_the_camera_that_is_stuck_is_opened_again_and_both_where_nobody_knows_which(
    named: str | None, reopened: Device | None
) -> None:
    stuck = on.CaptureFailed(1, Fault(C.CAMERA_STUCK, "same image", device=named))
    assert after(at.capturing(), stuck)[1][0] == do.ReopenDevice(reopened)


@pytest.mark.parametrize(("device", "clears"), [("board", True), (None, True), ("camera.left", False)])
def test_a_laser_that_images_showed_is_not_taken_back_by_what_the_board_reads(device: str | None, clears: bool) -> None:
    machine = run(at.capturing(), on.CaptureFailed(1, Fault(C.LASER_ON, "seen", device=device)))
    witness = device if device != "board" else None
    assert has(machine, C.LASER_ON, witness)
    machine = run(machine, on.Tick(machine.now_ns + 5 * at.SECOND_NS), heartbeat())
    assert has(machine, C.LASER_ON, witness) == (not clears)


@pytest.mark.parametrize(("left", "is_full"), [(0, True), (1, False), (None, False)])
def test_the_disk_is_full_when_not_one_more_scan_fits(left: int | None, is_full: bool) -> None:
    assert codes(run(aim(), on.StorageCounted(3, "000003", left))) == [C.STORAGE_FULL] * is_full


def test_exactly_enough_light_is_enough_and_a_sequence_takes_its_share() -> None:
    machine = run(aim(), heartbeat(), on.Tick(7 * at.SECOND_NS), heartbeat())
    for left_s, begun in ((0.39, False), (0.4, True), (12.0, True)):
        scanned = run(replace(machine, thermal=replace(machine.thermal, ration_s=left_s)), SCAN, on.Armed(1))
        assert (scanned.state is S.CAPTURE) == begun, left_s
        assert not begun or scanned.thermal.ration_s == pytest.approx(left_s - 0.4)


def test_a_silent_disk_without_a_scan_and_a_cloud_of_none_lead_to_aim() -> None:
    machine, effects = late(replace(at.saving(), scan=None))
    assert (machine.state, effects, has(machine, C.NOT_SAVED)) == (S.AIM, (), True)
    assert scanning.stopped_adding(at.reviewing()) == (at.reviewing(), ())
    assert scanning.rejected(aim()) == (aim(), ())
    assert scanning.no_cloud(aim(), EIO)[0].state is S.AIM


def test_a_safe_whose_cause_has_gone_is_left_with_the_scan_still_to_be_decided_on() -> None:
    def dried(machine: Machine, stopping: Ending | None = None) -> State:
        dry = replace(machine, conditions=(), stopping=stopping)
        return run(dry, on.Tick(dry.now_ns + 1)).state

    refused = run(at.saving(), *LEAK, REFUSED)
    found = [dried(one) for one in (at.safe(), at.safe_with_a_scan(), run(at.saving(), *LEAK), refused)]
    assert found == [S.AIM, S.SAFE, S.SAFE, S.REVIEW], "not while its cloud is awaited, or it is being published"
    assert dried(refused, Ending.STOP) is S.SAFE, "it ends as soon as that is saved"
