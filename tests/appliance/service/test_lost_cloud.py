"""A scan that kills its worker every time is saved all the same, says why it has no cloud, and gets it at the desk."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.capture.ledger import Ledger
from appliance.capture.scan import CaptureReport
from appliance.config import Rig, load_rig
from appliance.config.load import default_rig_path
from appliance.instrument import design_of
from appliance.machine import events as on
from appliance.offline.origin import calibration_for, open_source
from appliance.offline.reconstruct import reconstruct_scan
from appliance.offline.wish import Wish
from appliance.patterns.sequence import PatternSequence, build_sequence
from appliance.reconstruct.pipeline import Pipeline
from appliance.scan.exposure import Exposure
from appliance.scan.fault import FaultCode
from appliance.scan.sides import SIDES
from appliance.service.scans import MeasuringSetup, ScanController, ScanStorage
from appliance.storage.library import Library
from appliance.storage.ply import read_ply
from drivers.api import Flip, Frame, FrameStatus, Pulse
from drivers.native import MonotonicClock
from drivers.wall_clock import KernelCalendar
from tests.support import synthetic

NORMAL = np.array([0.0, 0.1, 1.0]) / np.hypot(0.1, 1.0)
PERIOD_NS = 16_666_667
SEQUENCE = build_sequence(16)
CLOCK = MonotonicClock()
EXPOSURE = Exposure(12_000)


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    """The packaged rig with small cameras and a storage of its own."""
    rig = load_rig(default_rig_path())
    cameras = replace(
        rig.camera,
        left=replace(rig.camera.left, width_px=400, height_px=300),
        right=replace(rig.camera.right, width_px=400, height_px=300),
    )
    storage = replace(rig.storage, root=tmp_path / "storage")
    return replace(rig, camera=cameras, design=replace(rig.design, pixel_um=18.0), storage=storage)


@pytest.fixture
def desk(rig: Rig) -> Iterator[ScanController]:
    calibration = design_of(rig)
    library = Library(rig.storage.root)
    library.prepare()
    with ScanController(
        rig, MeasuringSetup(calibration, SEQUENCE), ScanStorage(library), CLOCK, KernelCalendar()
    ) as desk:
        index = calibration.water.index
        offset = float(NORMAL @ calibration.rig.volume_centre_mm(index))
        for side, camera in (("left", calibration.rig.left), ("right", calibration.rig.right)):
            seen = synthetic.plane_points(camera, NORMAL, offset)
            pq = synthetic.projector(calibration).project(seen, index)
            desk.store.frames(side)[...] = np.rint(synthetic.frames(SEQUENCE, pq)).astype(np.uint8)
        until(desk, lambda events: desk.worker_settled)
        yield desk


def until(desk: ScanController, done: Callable[[list[on.Event]], object], timeout_s: float = 60.0) -> list[on.Event]:
    """Everything said until ``done``."""
    events: list[on.Event] = []
    end_ns = CLOCK.now_ns() + int(timeout_s * 1e9)
    while not done(events):
        assert CLOCK.now_ns() < end_ns, events
        events += desk.poll()
        CLOCK.sleep_s(0.005)
    return events


def report_of(sequence: PatternSequence, first_ns: int) -> CaptureReport:
    """What four witnesses in agreement say of a sequence that begins at ``first_ns``."""
    times_ns = [first_ns + k * PERIOD_NS for k in range(len(sequence))]
    frames = tuple(Frame(FrameStatus.COMPLETE, k, t, t + PERIOD_NS) for k, t in enumerate(times_ns))
    ledger = Ledger(
        expected=len(sequence),
        period_ns=PERIOD_NS,
        start_sequence=1,
        start_vsync=1,
        delay_us=500,
        flips=tuple(Flip(index=k, sequence=1 + k, time_ns=t) for k, t in enumerate(times_ns)),
        pulses=tuple(Pulse(k, 1 + k, t // 1000) for k, t in enumerate(times_ns)),
        frames=dict.fromkeys(SIDES, frames),
        sync=None,
    )
    return CaptureReport(None, ledger, 0.4, ())


def record(desk: ScanController, number: int, halfway: Callable[[], None]) -> None:
    """A sequence whose frames are in the store already."""
    assert desk.begin(number, EXPOSURE) is None
    first_ns = CLOCK.now_ns() + PERIOD_NS
    for k in range(len(SEQUENCE)):
        CLOCK.sleep_s(PERIOD_NS / 1e9)
        for side in SIDES:
            desk.worker.frame(side, k)
        if k == len(SEQUENCE) // 2:
            halfway()
    desk.recorded(report_of(SEQUENCE, first_ns), {})
    desk.store_raw(number)
    desk.worker.finish()


def kill(desk: ScanController) -> None:
    if desk.worker.pid is not None:
        os.kill(desk.worker.pid, signal.SIGKILL)


def kept(desk: ScanController, number: int) -> None:
    desk.publish(number, None)
    until(desk, lambda events: any(isinstance(event, on.Saved) for event in events))


def test_raw_frames_are_kept_without_a_cloud_and_the_desk_makes_it(
    desk: ScanController, rig: Rig, tmp_path: Path
) -> None:
    record(desk, 1, halfway=lambda: kill(desk))
    seen: list[int | None] = [desk.worker.pid]

    def lost(events: list[on.Event]) -> bool:
        if desk.worker.pid not in seen:
            seen.append(desk.worker.pid)
            kill(desk)
        return any(isinstance(event, on.ReconstructionFailed) for event in events)

    events = until(desk, lost)
    (failed,) = (event for event in events if isinstance(event, on.ReconstructionFailed))
    assert failed.number == 1
    assert failed.fault.code is FaultCode.RECONSTRUCTION_FAILED
    assert "ended with code -9" in failed.fault.detail
    assert not any(isinstance(event, on.CoarseReady | on.FullReady) for event in events)
    kept(desk, 1)

    library = Library(rig.storage.root)
    scan_id = library.last_id()
    assert scan_id is not None
    assert library.verify(scan_id).ok
    scan = library.load(scan_id)
    assert scan.cloud() is None
    for side in SIDES:
        np.testing.assert_array_equal(scan.frames[side], desk.store.frames(side))

    pipeline = Pipeline(design_of(rig), desk.water, SEQUENCE)
    for k in range(len(SEQUENCE)):
        for side in SIDES:
            pipeline.push(side, desk.store.frames(side), k)
    pipeline.coarse()
    source = open_source(rig.storage.root / "scans" / scan_id, Wish())
    made = reconstruct_scan(source, calibration_for(source, Wish()), tmp_path / "late.ply", lambda text: None)
    assert made["points"] > 10_000
    np.testing.assert_array_equal(read_ply(tmp_path / "late.ply").points_mm, pipeline.full().points_mm)

    record(desk, 2, halfway=lambda: None)
    until(desk, lambda events: any(isinstance(event, on.FullReady) for event in events))


def test_a_scan_processed_again_has_its_cloud_and_four_times_in_order(desk: ScanController, rig: Rig) -> None:
    record(desk, 1, halfway=lambda: kill(desk))
    begun_ns = CLOCK.now_ns()
    wanted = (on.FullReady, on.RawStored)
    until(desk, lambda events: {type(event) for event in events}.issuperset(wanted))
    waited_s = (CLOCK.now_ns() - begun_ns) / 1e9
    kept(desk, 1)
    library = Library(rig.storage.root)
    scan = library.load(str(library.last_id()))
    assert scan.cloud() is not None
    times_s = scan.manifest.record.stage_times_s
    assert 0.0 < times_s["first_pattern"] < times_s["recording"] < times_s["coarse"] < times_s["full"]
    assert times_s["recording"] < times_s["saved"]
    sequence_s = times_s["recording"] - times_s["first_pattern"]
    assert sequence_s == pytest.approx(len(SEQUENCE) * PERIOD_NS / 1e9), "from the first pattern to the last frame"
    assert times_s["full"] <= times_s["recording"] + waited_s + 0.5


def test_all_that_the_worker_has_said_of_a_scan_is_heard_at_two_heartbeats(desk: ScanController) -> None:
    """The display paces heartbeats: with one report at each, the full cloud would wait for four pictures more."""
    record(desk, 1, halfway=lambda: None)
    CLOCK.sleep_s(2.0)  # it is done by now, and nobody has listened
    events = desk.poll() + desk.poll()
    of_the_worker = (on.PatternsRight, on.CoarseReady, on.Judged, on.Judged, on.FullReady)
    assert [type(event) for event in events if isinstance(event, of_the_worker)] == list(of_the_worker)
