"""The scan in hand: what is written down of it, what may be asked of it when, and that it needs no process for points."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.calibration.design import Design, design_calibration
from appliance.cli.simrig import SimOptions, default_sim_rig, simulated
from appliance.config import load_rig
from appliance.machine import events as on
from appliance.machine.states import Part
from appliance.optics.water import Water
from appliance.patterns.sequence import Direction, build_sequence
from appliance.scan.exposure import Exposure
from appliance.scan.fault import Fault, FaultCode
from appliance.scan.verdict import Verdict
from appliance.service.scans import MeasuringSetup, ScanController, ScanStorage
from appliance.storage.library import Library
from appliance.worker.order import WorkLimits
from drivers.native import MonotonicClock
from drivers.wall_clock import KernelCalendar
from tests.appliance.capture.test_course_of_a_scan import SEQUENCE
from tests.appliance.capture.test_ledger import clean
from tests.appliance.service.scripted import Desk, a_desk
from tests.appliance.service.test_lost_cloud import report_of


def events_until_settled(scans: ScanController, timeout_s: float = 60.0) -> list[on.Event]:
    clock = MonotonicClock()
    found: list[on.Event] = []
    end_ns = clock.now_ns() + int(timeout_s * 1e9)
    while not scans.worker_settled and clock.now_ns() < end_ns:
        found += [
            event for event in scans.poll() if not isinstance(event, on.PartBusy)
        ]  # how long it takes is the host's
        clock.sleep_s(0.01)
    return found


def test_a_worker_that_cannot_live_is_a_condition_and_no_endless_boot(tmp_path: Path) -> None:
    rig = simulated(load_rig(default_sim_rig()), SimOptions(root=tmp_path, size="400x300"))
    calibration = design_calibration(
        Design(11.5, 18.0, 230.0, 12.41, 30.0, 5.0, 1.77), "KF-TEST", 400, 300, Water(20.0, 0.0, 530.0)
    )
    library = Library(tmp_path)
    library.prepare()
    for memory_mb, expected in ((20.0, on.ConditionRaised), (2000.0, on.ConditionCleared)):
        limits = WorkLimits(memory_mb=memory_mb, start_memory_mb=memory_mb)
        with ScanController(
            rig,
            MeasuringSetup(calibration, build_sequence(16)),
            ScanStorage(library),
            MonotonicClock(),
            KernelCalendar(),
            limits,
        ) as scans:
            event, told = events_until_settled(scans)
            assert isinstance(event, expected)
            assert isinstance(told, on.PartTested)
            assert (told.part, told.passed) == (Part.WORKER, expected is on.ConditionCleared), (
                "the self-test hears of it"
            )
            fault = event.fault if isinstance(event, on.ConditionRaised) else event
            assert fault.code is FaultCode.RECONSTRUCTION_FAILED
            assert scans.worker_settled


REPORT = report_of(SEQUENCE, 5_000_000_000)
EXPOSURE = Exposure(8_000)


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    with a_desk(tmp_path) as made:
        yield made


def begun(desk: Desk, number: int = 3) -> ScanController:
    scans = desk.parts.scans
    assert scans.begin(number, EXPOSURE, 5) is None
    return scans


def answered(scans: ScanController) -> list[on.Event]:
    scans.submit(int).result(10.0)
    return [event for event in scans.poll() if isinstance(event, on.RawStored | on.Saved | on.Rejected | on.SaveFailed)]


def test_a_scan_is_written_down_with_what_it_was_recorded_with_and_saved_with_the_divers_word(desk: Desk) -> None:
    scans = begun(desk)
    scan = scans.scan
    assert scan is not None
    scan.begun_ns = 4_000_000_000
    scans.recorded(REPORT, {"case": 31.0})
    made = scan.record
    assert made is not None
    assert (made.exposure, made.object, made.recorded_ns, made.temperatures_c) == (
        EXPOSURE,
        5,
        scan.begun_ns,
        {"case": 31.0},
    )
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
    scans.accept(3, Verdict("calibration", True), lambda scan_id: [on.Rejected(9, scan_id)])
    saved, entered = answered(scans)
    assert isinstance(saved, on.Saved)
    assert entered == on.Rejected(9, saved.scan_id), "behind the publication"
    begun(desk, 4).recorded(REPORT, {})
    scans.reject(4, "not wanted")
    (rejected,) = answered(scans)
    assert isinstance(rejected, on.Rejected)


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


@pytest.mark.parametrize(("frames", "wanted", "kept"), [(0, True, 0), (1, True, 1), (1, False, 0)])
def test_an_incomplete_recording_is_kept_where_it_holds_a_whole_direction_and_the_rig_file_asks(
    tmp_path: Path, frames: int, wanted: bool, kept: int
) -> None:
    with a_desk(tmp_path, keep_incomplete=wanted) as desk:
        scans = begun(desk)
        count = SEQUENCE.axis(Direction.X).sine[-1] + frames
        cut = replace(clean(), flips=clean().flips[:count])
        scans.keep_incomplete(replace(REPORT, ledger=cut), Fault(FaultCode.FRAME_MISSING, "left 9"), {})
        assert scans.busy is bool(kept)
        scans.submit(int).result(10.0)
        folder = tmp_path / "incomplete"
        assert len(list(folder.iterdir()) if folder.exists() else []) == kept


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
    assert (order.water, order.calibration, order.period_px) == (scans.water, other, 64)
    assert len(scans.store.frames("left")) == len(scans.sequence)
