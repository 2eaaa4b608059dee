"""The scan in hand: what is written down of it, what may be asked of it when, and that it needs no process for points."""

from __future__ import annotations

import errno
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.instrument.capture.ledger import Ledger
from appliance.instrument.capture.scan import CaptureReport
from appliance.instrument.capture.store import FrameStore
from appliance.instrument.machine import events as on
from appliance.instrument.machine.states import Part, PartResult
from appliance.instrument.machine.words import Text
from appliance.instrument.service.scan_files import ScanFiles, ScanInMemory, ScanRoom, SecondInMemory
from appliance.instrument.service.scans import ScanController
from appliance.instrument.service.worker_reports import WorkerReports
from appliance.instrument.worker.messages import Ready
from appliance.instrument.worker.process import WorkerEvent
from appliance.measure.cloud import CloudLocation
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.guidance import Overlap
from appliance.measure.light.exposure import Exposure
from appliance.measure.light.patterns import PatternSequence, build_sequence
from appliance.measure.light.sides import SIDES
from appliance.measure.news import (
    Bracket,
    CoarseCloud,
    FullCloud,
    LiveGuidance,
    News,
    PatternIdentity,
    ReconstructionFailure,
    ScanOverlap,
    SequenceFact,
    Verdicts,
    WorkerFailure,
    WorkProgress,
)
from appliance.measure.points.table import Cloud
from appliance.measure.verdict import Judgement, Verdict
from appliance.store.library import Library
from drivers.api import Flip, Frame, FrameStatus, Pulse
from tests.appliance.instrument.capture.test_course_of_a_scan import SEQUENCE
from tests.appliance.instrument.machine.walks import SUMMARY
from tests.appliance.instrument.service.scripted import Desk
from tests.appliance.store.scenes import FRAMES, ORIGIN, BadDisk, frames, record, second_sequence
from tests.drivers.clock import SteppedClock

PERIOD_NS = 16_666_667


def report_of(sequence: PatternSequence, first_ns: int) -> CaptureReport:
    """What four witnesses in agreement say of a sequence that begins at ``first_ns``."""
    times_ns = [first_ns + k * PERIOD_NS for k in range(len(sequence))]
    frames = tuple(Frame(FrameStatus.COMPLETE, k, t, t + PERIOD_NS) for k, t in enumerate(times_ns))
    flips = tuple(Flip(k, 1 + k, t) for k, t in enumerate(times_ns))
    pulses = tuple(Pulse(k, 1 + k, t // 1000) for k, t in enumerate(times_ns))
    ledger = Ledger(len(sequence), PERIOD_NS, 1, 1, 500, flips, pulses, dict.fromkeys(SIDES, frames), None)
    return CaptureReport(None, ledger, 0.4, ())


REPORT = report_of(SEQUENCE, 5_000_000_000)
EXPOSURE = Exposure(8_000)


def test_a_worker_that_cannot_live_is_a_condition_and_no_endless_boot(desk: Desk) -> None:
    scans, told = desk.parts.scans.__enter__(), list[on.Event]()

    def settled() -> bool:
        told.extend(event for event in scans.poll() if not isinstance(event, on.PartBusy))
        return len(told) == 2

    desk.until(settled, 60.0)
    raised, tested = told
    assert isinstance(raised, on.ConditionRaised)
    assert raised.fault.code is FaultCode.RECONSTRUCTION_FAILED
    assert tested == PartResult(Part.WORKER, False, Text.GIVEN_UP)


def begun(desk: Desk, number: int = 3) -> ScanController:
    scans = desk.parts.scans
    assert scans.begin(number, EXPOSURE, 5) is None
    return scans


SAVEABLE = on.ConditionCleared(FaultCode.NOT_SAVED)


def answered(scans: ScanController) -> list[on.Event]:
    scans.submit(int).result(10.0)
    return [
        event
        for event in scans.poll()
        if event == SAVEABLE or isinstance(event, on.RawStored | on.Saved | on.SaveFailed)
    ]


def test_a_scan_is_written_down_with_what_it_was_recorded_with_and_saved_with_the_divers_word(desk: Desk) -> None:
    scans = begun(desk)
    scan = scans.scan
    assert scan is not None
    scan.begun_ns = 4_000_000_000
    scans.recorded(REPORT, {"case": 31.0})
    made = scan.record
    assert made is not None
    known = (made.exposure, made.object, made.recorded_ns, made.temperatures_c)
    assert known == (EXPOSURE, 5, scan.begun_ns, {"case": 31.0})
    assert made.water is not None
    assert (made.water["temperature_c"], made.water["index"]) == (scans.water.temperature_c, scans.water.index)
    (verdict,) = made.verdicts
    assert (verdict.name, verdict.passed, verdict.numbers) == ("ledger", True, {"frames": float(len(SEQUENCE))})
    assert scan.times_s["first_pattern"] == 1.0
    assert scan.times_s["recording"] == pytest.approx(1.0 + len(SEQUENCE) / 60.0)
    for wrong in (scans.store_raw, lambda number: scans.publish(number, None), lambda number: scans.reject(number, "")):
        wrong(4)
    assert (scans.busy, scans.folder(3)) == (False, None)
    scans.store_raw(3)
    assert (scans.busy, scans.settled) == (True, False)
    assert answered(scans) == [on.RawStored(3)]
    assert (scans.settled, scans.folder(4)) == (True, None)
    assert scans.folder(3) is not None
    scans.publish(3, np.zeros((4, 6, 3), np.uint8), Verdict("grade", True, {}, "good"))
    (saved,) = answered(scans)
    assert isinstance(saved, on.Saved)
    stored = Library(desk.rig.storage.root).load(saved.scan_id).manifest
    assert [one.name for one in stored.record.verdicts] == ["ledger", "grade"]
    assert "preview.png" in stored.files


def test_a_scan_that_is_rejected_or_accepted_says_so(desk: Desk) -> None:
    scans = begun(desk)
    scans.accept(3, Verdict("calibration", True), lambda scan_id: [])
    assert not scans.busy, "nothing was recorded"
    scans.recorded(REPORT, {})
    scans.accept(3, Verdict("calibration", True), lambda scan_id: [on.Saved(9, scan_id)])
    saved, entered = answered(scans)
    assert isinstance(saved, on.Saved)
    assert entered == on.Saved(9, saved.scan_id), "behind the publication"
    begun(desk, 4).recorded(REPORT, {})
    scans.reject(4, "not wanted")
    assert answered(scans) == [SAVEABLE]


def test_a_second_sequence_is_given_up_alone_and_the_first_stays(desk: Desk) -> None:
    scans = desk.parts.scans
    fault = scans.begin_second(4, EXPOSURE)
    assert fault is not None
    assert fault.code is FaultCode.INTERNAL
    begun(desk).recorded(REPORT, {})
    assert scans.begin_second(4, Exposure(14_000)) is None
    scan = scans.scan
    assert scan is not None
    first = scan.record
    scans.recorded(REPORT, {"case": 32.0})
    assert scan.record is first
    assert scan.second is not None
    assert scan.second.record is not None
    assert (scan.second.record.exposure, scan.second.record.temperatures_c) == (Exposure(14_000), {"case": 32.0})
    scans.drop()
    assert [scans.scan, scan.second] == [scan, None]
    scans.drop()
    assert [scans.scan] == [None]


def test_other_water_another_sequence_and_another_calibration_are_measured_with_from_then_on(desk: Desk) -> None:
    scans = desk.parts.scans
    scans.use_water(35.0, 4.0)
    assert (scans.water.salinity_psu, scans.water.temperature_c) == (35.0, 4.0)
    other = replace(scans.calibration, made_at="2026-02-01")
    scans.use(other)
    assert scans.calibration is other
    begun(desk)
    scans.use_sequence(build_sequence(64, 64, 64))
    assert (scans.scan, scans.sequence.period_px, scans.busy) == (None, 64, True)
    order = scans.worker.order
    assert (order.water, order.calibration, order.sequence) == (scans.water, other, scans.sequence)
    assert len(scans.store.frames("left")) == len(scans.sequence)


@pytest.mark.parametrize("refused", ["create frames_left_second.npy", "sync frames_right_second.npy"])
def test_a_second_exposure_that_the_disk_refused_once_is_written_when_the_scan_is_saved(
    tmp_path: Path, refused: str
) -> None:
    counting = BadDisk()
    _save(tmp_path / "counted", counting)
    disk = BadDisk(counting.calls.index(refused), error=errno.EIO)
    first, saved = _save(tmp_path / "refused", disk)
    assert [type(event) for event in first[:1]] == [on.SaveFailed]
    assert [type(event) for event in saved[:1]] == [on.Saved]
    library = Library(tmp_path / "refused")
    (entry,) = library.entries()
    assert library.verify(entry.scan_id).ok
    second = library.load(entry.scan_id).second
    assert second is not None
    assert all(np.array_equal(second[side], frames(1)[side]) for side in ("left", "right"))


def _save(root: Path, disk: BadDisk) -> tuple[list[on.Event], list[on.Event]]:
    library, clock = Library(root, disk), SteppedClock()
    library.prepare()
    with FrameStore(FRAMES, 8, 10, sequences=2) as store:
        for side in ("left", "right"):
            store.frames(side)[:] = frames(0)[side]
            store.frames(side, second=True)[:] = frames(1)[side]
        files = ScanFiles(library, ScanRoom(library, None, 0, clock), store, clock)
        scan = ScanInMemory(1, clock.now_ns(), Exposure(2000), ORIGIN, record=record())
        scan.pending = library.begin(frames(0), record(), ORIGIN)
        scan.second = SecondInMemory(2, clock.now_ns(), Exposure(14_000), second_sequence(), merged=True)
        return files.store_second(scan), files.publish(scan, None)


SPOILT = Fault(FaultCode.MOVED, "the hands shook")
GOOD, BAD = Judgement(Verdict("motion", True)), Judgement(Verdict("motion", False), SPOILT)
PAIR = Judgement(Verdict("pair", True))
RIGHT, FOUND = PatternIdentity(Judgement(Verdict("identity", True))), CloudLocation(((0, 5),), SUMMARY)
DOWN = Fault(FaultCode.RECONSTRUCTION_FAILED, "the process ended with code -9")


def cloud() -> Cloud:
    ones = np.ones(5, np.float32)
    return Cloud(
        np.ones((5, 3), np.float32), np.ones(5, np.uint8), ones, ones, ones, np.arange(5, dtype=np.uint32), SUMMARY
    )


class Heard:
    """Reports about a scan that began 2 s before, and whether what was recorded last was given up."""

    def __init__(self, desk: Desk) -> None:
        scans = desk.parts.scans
        self.dropped = 0
        self.worker = scans.worker
        self.reports = WorkerReports(scans.worker, scans.watch, desk.script.clock, self._drop)
        begun_ns = desk.script.clock.now_ns() - 2_000_000_000
        self.scan = ScanInMemory(4, begun_ns, Exposure(8_000), ORIGIN, record=record())

    def _drop(self) -> None:
        self.dropped += 1

    def meant(self, report: WorkerEvent) -> list[on.Event]:
        return self.reports.events_of(report, self.scan)

    def told(self, fact: SequenceFact, points: Cloud | None = None) -> list[on.Event]:
        """What is heard of a fact about the scan, whose ``points`` the worker has copied."""
        self.worker.coarse = self.worker.full = points
        return self.meant(News(4, fact))

    def with_second(self) -> SecondInMemory:
        self.scan.second = SecondInMemory(5, self.scan.begun_ns, Exposure(14_000), second_sequence())
        return self.scan.second

    @property
    def verdicts(self) -> list[Verdict]:
        assert self.scan.record is not None
        return list(self.scan.record.verdicts)


@pytest.fixture
def heard(desk: Desk) -> Heard:
    return Heard(desk)


def test_of_another_scan_nothing_is_heard_and_news_of_none_are_told_as_they_are(heard: Heard) -> None:
    heard.worker.coarse = heard.worker.full = cloud()
    facts = (
        RIGHT,
        CoarseCloud(FOUND, 0.1),
        FullCloud(FOUND, (BAD,), 0.1),
        Verdicts((BAD,), 0.1),
        ScanOverlap(Overlap(0.5), 0.1),
    )
    for fact in facts:
        assert heard.meant(News(3, fact)) == heard.reports.events_of(News(4, fact), None) == []
    assert (heard.scan.full, heard.scan.times_s) == (None, {})
    assert BAD.verdict not in heard.verdicts
    ready: list[on.Event] = [on.ConditionCleared(FaultCode.RECONSTRUCTION_FAILED), PartResult(Part.WORKER, True)]
    assert heard.reports.events_of(Ready(), None) == ready
    assert heard.reports.events_of(LiveGuidance(None, 77, 0.1), None) == [LiveGuidance(None, 77, 0.1)]


def test_the_machine_hears_a_fact_as_it_is(heard: Heard) -> None:
    for fact in (RIGHT, CoarseCloud(FOUND), Verdicts((BAD,)), FullCloud(FOUND, (BAD,)), ScanOverlap(Overlap(0.5))):
        assert heard.told(fact, cloud()) == [News(4, fact)]
    assert heard.told(WorkProgress("light")) == []


def test_clouds_enter_the_scan_with_the_time_at_which_each_was_seen_first(heard: Heard) -> None:
    scan, made = heard.scan, cloud()
    heard.told(CoarseCloud(FOUND, 0.25), made)
    assert (scan.coarse, scan.full) == (made, None)
    heard.told(FullCloud(FOUND, (), 0.5), made)
    assert (scan.full, scan.times_s["coarse_cpu"], scan.times_s["full_cpu"]) == (made, 0.25, 0.5)
    first_s = scan.times_s["full"]
    assert 2.0 <= scan.times_s["coarse"] <= first_s < 5.0
    heard.told(FullCloud(FOUND, (), 0.5), cloud())
    assert scan.times_s["full"] == first_s


def test_judgements_are_entered_in_place_of_those_before(heard: Heard) -> None:
    proposing = Judgement(Verdict("exposure", True), proposal=Exposure(4_000), second=Exposure(14_000))
    heard.told(Verdicts((BAD, proposing), 0.25))
    assert {"motion", "exposure"} <= {one.name for one in heard.verdicts}
    heard.told(Verdicts((GOOD,), 0.5))
    assert heard.scan.times_s["judged_cpu"] == 0.75
    assert [one.passed for one in heard.verdicts if one.name == "motion"] == [True], "in place of the first word"
    heard.told(FullCloud(FOUND, (BAD,), 0.5), cloud())
    assert heard.scan.times_s["judged_cpu"] == 0.75
    assert [one.passed for one in heard.verdicts if one.name == "motion"] == [False], "the last word"


def test_a_spoilt_scan_and_its_overlap_are_told(heard: Heard) -> None:
    heard.told(ScanOverlap(Overlap(0.5), 0.1))
    assert heard.scan.times_s["overlap_cpu"] == 0.1
    spoilt = PatternIdentity(BAD)
    assert heard.told(spoilt) == [News(4, spoilt)]
    assert BAD.verdict in heard.verdicts


def test_both_sequences_become_one_cloud(heard: Heard) -> None:
    bracket = Bracket(FOUND, PAIR, (GOOD,), 0.5)
    assert heard.told(bracket, cloud()) == [], "there is no second one"
    assert [heard.scan.full] == [None]
    second, made = heard.with_second(), cloud()
    assert heard.told(bracket, made) == [News(4, bracket)]
    assert (second.merged, heard.scan.full, heard.scan.times_s["pair_cpu"]) == (True, made, 0.5)
    assert 2.0 <= heard.scan.times_s["pair"] < 5.0
    assert heard.scan.coarse is not None
    assert PAIR.verdict in heard.verdicts
    assert second.record is not None
    assert second.record.verdicts[-1] == GOOD.verdict
    assert heard.dropped == 0


@pytest.mark.parametrize("fault", [SPOILT, None])
def test_a_second_sequence_that_does_not_fit_is_given_up_alone(heard: Heard, fault: Fault | None) -> None:
    second = heard.with_second()
    bracket = Bracket(None, Judgement(Verdict("pair", False, {}, "nothing in common"), fault))
    assert heard.told(bracket) == [News(4, bracket)]
    assert bracket.fault == (fault or Fault(FaultCode.RECONSTRUCTION_FAILED, "nothing in common"))
    assert (second.merged, heard.scan.full, heard.dropped) == (False, None, 1)


@pytest.mark.parametrize(
    ("number", "second", "merged", "dropped"),
    [
        (4, False, False, 0),
        (4, True, False, 1),
        (4, True, True, 0),
        (3, True, False, 0),
        (None, False, False, 0),
    ],
)
def test_a_process_that_is_down_for_good_fails_what_it_had(
    heard: Heard, number: int | None, second: bool, merged: bool, dropped: int
) -> None:
    if second:
        heard.with_second().merged = merged
    lost = None if number is None else News(number, ReconstructionFailure(DOWN))
    events = heard.meant(WorkerFailure(DOWN.detail) if lost is None else lost)
    down = [on.ConditionRaised(DOWN), PartResult(Part.WORKER, False, Text.GIVEN_UP)]
    assert events == [*([] if lost is None else [lost]), *down]
    assert heard.dropped == dropped, "the second sequence, and no more"
