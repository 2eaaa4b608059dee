"""What a calibration in water starts from, what becomes of its recordings, and the words when there is nothing to start from."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from appliance.base import silent
from appliance.calibrate.calibrations import Calibrations
from appliance.calibrate.guide import USED, AdjustmentSummary, LengthCheck, RecordingCheck, Refusal, Session, Step
from appliance.calibrate.recordings import RecordingError
from appliance.calibrate.water_steps import Examination, Solution, basis_of, examine_recording, solve_calibration
from appliance.instrument.machine import events as on
from appliance.instrument.machine.states import Failure, FailureKind
from appliance.measure.calibration.file import Calibration, CalibrationError, encode_calibration
from appliance.measure.fault import FaultCode
from appliance.measure.light.correction import CORRECTION_INTERVALS, ImageCorrection, node_count
from appliance.measure.light.exposure import Exposure
from appliance.measure.light.model import StereoRig
from appliance.store.config import Rig
from appliance.store.instrument import Instrument
from appliance.store.library import UnknownScan
from appliance.store.manifest import SequenceInfo
from tests.appliance.instrument.capture.test_course_of_a_scan import SEQUENCE
from tests.appliance.instrument.service.scripted import Desk, a_desk, small_rig
from tests.appliance.instrument.worker.test_parents_end import Machine
from tests.appliance.store import scenes
from tests.support.planes import store_plane


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    (tmp_path / "calibration").mkdir()
    return small_rig(tmp_path)


def put(rig: Rig, name: str, calibration: Calibration) -> Calibration:
    (rig.storage.root / "calibration" / name).write_bytes(encode_calibration(calibration))
    return calibration


def in_air(rig: Rig) -> Calibration:
    covariance = tuple(tuple(float(x) for x in row) for row in np.diag(np.full(22, 1e-6)))
    return replace(Instrument(rig).design(), method="air", air_covariance=covariance)


def corrected(rig: Rig) -> Calibration:
    design = Instrument(rig).design()
    size = design.rig.left.width_px, design.rig.left.height_px
    bent = ImageCorrection(*size, CORRECTION_INTERVALS, (0.01,) * (2 * node_count(CORRECTION_INTERVALS)))
    cameras = StereoRig(replace(design.rig.left, correction=bent), replace(design.rig.right, correction=bent))
    return replace(design, method="bundle, spline", rig=cameras)


def test_the_calibration_in_air_or_the_drawing_is_the_start_and_the_one_in_use_is_compared_with(rig: Rig) -> None:
    basis = basis_of(rig)
    assert (basis.start, basis.before, basis.bar.length_mm) == (
        Instrument(rig).design(),
        Instrument(rig).design(),
        150.0,
    )
    air, current = put(rig, "air.json", in_air(rig)), put(rig, "current.json", corrected(rig))
    assert (basis_of(rig).start, basis_of(rig).before) == (air, current)
    new = replace(Instrument(rig).design(), method="bundle, ports")
    store = Calibrations(rig.storage.root, rig.rig.serial)
    store.write_solved(new, Session((), AdjustmentSummary(new.method, 0.03, (), new.hash)))
    assert store.use_solved("2026-11-21").in_use
    assert basis_of(rig).before == current, "once in use, the new one is still compared with the one before"


def test_what_there_is_nothing_to_start_from_is_named(rig: Rig) -> None:
    with pytest.raises(RecordingError, match="ball_bar"):
        basis_of(replace(rig, ball_bar=None))
    put(rig, "current.json", corrected(rig))
    with pytest.raises(RecordingError, match=r"bundle, spline.*air\.json"):
        basis_of(rig)
    put(rig, "air.json", replace(in_air(rig), rig_serial="KF-9999"))
    with pytest.raises(CalibrationError, match=r"air\.json.*KF-9999"):
        basis_of(rig)


def test_a_recording_that_is_gone_is_named(rig: Rig) -> None:
    store = Calibrations(rig.storage.root, rig.rig.serial)
    store.write(Session(tuple(RecordingCheck(step, None, 0.03) for step in USED)))
    with pytest.raises(RecordingError, match="no recording of M1, M2, M3, M4"):
        solve_calibration(rig, "2026-11-21", silent)
    store.write(Session(tuple(RecordingCheck(step, None, 0.03, scan_id="000099") for step in USED)))
    with pytest.raises(UnknownScan, match="000099"):
        solve_calibration(rig, "2026-11-21", silent)


def test_planes_and_what_is_none_are_told_apart(rig: Rig) -> None:
    folder, _ = store_plane(rig, 50.0)
    near = examine_recording(rig, Step.M3, folder, silent).check
    assert near.refusal is None
    assert near.points > 500
    far = examine_recording(rig, Step.M4, folder, silent).check
    assert far.refusal is Refusal.TOO_NEAR
    assert far.number == pytest.approx(474.0, abs=1.0)
    bar = examine_recording(rig, Step.M1, folder, silent).check
    assert bar.refusal is Refusal.NOT_FOUND
    assert "ball" in bar.detail


Heard = tuple[Desk, Machine, Callable[..., list[Any]]]


@pytest.fixture
def heard(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Heard]:
    """A desk whose processes say what the test tells them, and what the machine hears of it."""
    (tmp_path / "proc").mkdir()
    machine = Machine(tmp_path / "proc")
    monkeypatch.setattr(multiprocessing, "get_context", lambda kind: machine)
    with a_desk(tmp_path / "root") as desk:

        def after(*said: object) -> list[Any]:
            for one in said:
                machine.started[-1].pipe.send((desk.parts.calibrating._background._ticket, one))
            events: list[Any] = []
            for _ in range(3):  # what is told may want something of the disk
                desk.parts.scans.submit(lambda: None).result(10.0)
                events += [*desk.parts.calibrating.poll(), *desk.parts.scans.poll()]
            return events

        assert after() == [Session()]
        yield desk, machine, after


@pytest.mark.parametrize("step", [Step.M1, Step.VERIFY])
def test_a_recording_is_examined_and_entered_into_the_session(heard: Heard, step: Step) -> None:
    desk, machine, after = heard
    calibrating, scans = desk.parts.calibrating, desk.parts.scans
    calibrating.examine(4, step)
    assert [event.kind for event in after()] == [FailureKind.RECORDING]
    scans.begin(4, Exposure(8_000))
    assert scans.scan is not None
    scans.scan.record = scenes.record(sequence=SequenceInfo.of(SEQUENCE))
    scans.store_raw(4)
    after()
    calibrating.examine(4, step)
    assert machine.started[-1].pipe.recv()[1:] == (examine_recording, (desk.rig, step, scans.folder(4)))
    check, verified, right = RecordingCheck(step, None, 0.03), LengthCheck(0.0001, None, 0.00004), step is Step.VERIFY
    assert after(Examination(check, verified)) == [on.TrialExamined(4, check)]
    scans.watch.trend = replace(scans.watch.trend, alarm="the ray gaps have grown")
    calibrating.accept(4, check)
    events = after()
    (session,) = [event for event in events if isinstance(event, Session)]
    assert ([one.scan_id for one in session.trials], session.verified) == (["000001"], verified if right else None)
    # A bar that was measured right is the answer to the alarm.
    assert (on.ConditionCleared(FaultCode.VERIFY_CALIBRATION) in events, scans.watch.fault is None) == (right, right)


def test_what_is_solved_is_used_and_what_comes_to_nothing_is_told(heard: Heard) -> None:
    desk, machine, after = heard
    calibrating, made = desk.parts.calibrating, replace(Instrument(desk.rig).design(), method="bundle, ports")
    calibrating.warm()
    for said, kind in (
        (Failure(FailureKind.NO_SOLUTION, "no fit"), FailureKind.NO_SOLUTION),
        (7, FailureKind.BROKEN_OFF),
    ):
        calibrating.solve()
        assert [event.kind for event in after(said)] == [kind]
    calibrating.cancel()
    assert (len(machine.started), machine.started[0].waits_s) == (1, [0.0, 2.0]), "it computes no more"
    calibrating.solve()
    assert machine.started[-1].pipe.recv()[1] is solve_calibration
    assert after(on.CalibrationProgressed(0.5)) == [on.CalibrationProgressed(0.5)]
    summary = AdjustmentSummary(made.method, 0.03, (), made.hash)
    (solved,) = after(Solution(made, summary, None, {}))
    calibrating.use_solved()
    used, *cleared = after()
    assert (solved.solved, used.in_use, desk.parts.scans.calibration.hash) == (summary, True, made.hash)
    assert cleared[:2] == [on.ConditionCleared(FaultCode[code]) for code in ("UNCALIBRATED", "VERIFY_CALIBRATION")]
    calibrating.restore()
    assert [event.kind for event in after()] == [FailureKind.FILES], "none was in use before"
