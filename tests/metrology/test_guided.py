"""The instrument's own pictures: what examining five recordings and solving from four of them gives, and what it takes."""

from __future__ import annotations

import multiprocessing
import resource
import time
from dataclasses import replace
from pathlib import Path

import pytest

from appliance.base import silent
from appliance.calibrate.calibrations import Calibrations
from appliance.calibrate.guide import USED, RecordingCheck, Session, Step
from appliance.calibrate.water.start import start_from_air
from appliance.calibrate.water_steps import examine_recording, solve_calibration
from appliance.cli.simrig import SimOptions, apply_options, default_sim_rig
from appliance.measure.calibration.file import encode_calibration
from appliance.store.config import Rig, load_rig
from appliance.store.instrument import Instrument
from appliance.store.library import Library
from appliance.store.manifest import ScanRecord, SequenceInfo
from hw_sim.scene import Scene
from tests.support.calibrating import air_of, hidden_rig
from tests.support.rendered import render_scan
from tests.support.told import Told

SEED = 2
HELD = {
    Step.M1: ("ballbar", (-15.0, -20.0, 505.0, 0.0, 35.0, 20.0)),
    Step.M2: ("ballbar", (15.0, 20.0, 540.0, 0.0, -35.0, 70.0)),
    Step.M3: ("plane", (0.0, 0.0, 478.0, 8.0, -10.0, 0.0)),
    Step.M4: ("plane", (0.0, 0.0, 570.0, -10.0, 8.0, 0.0)),
    Step.VERIFY: ("ballbar", (0.0, 0.0, 520.0, 0.0, 5.0, -40.0)),
}


def record(rig: Rig) -> None:
    """All five, rendered and stored; in a process of its own, so that its memory does not count."""
    library, session = Library(rig.storage.root), Session()
    library.prepare()
    for step, (what, pose) in HELD.items():
        scan = render_scan(Scene(object=what, pose=pose, texture="none"), "realistic", SEED, 1600, 16)
        info = ScanRecord(SequenceInfo.of(scan.sequence), rig.rig_hash, None, "0", None, False, 0)
        pending = library.begin(scan.frames, info, Instrument(rig).origin(Instrument(rig).design()))
        pending.publish(info)
        session = replace(session, trials=(*session.trials, RecordingCheck(step, None, None, scan_id=pending.scan_id)))
    Calibrations(rig.storage.root, rig.rig.serial).write(session)


@pytest.mark.long
@pytest.mark.timeout(900)
def test_five_recordings_at_full_size(tmp_path: Path) -> None:
    rig = apply_options(load_rig(default_sim_rig()), SimOptions(root=tmp_path))
    store, library = Calibrations(tmp_path, rig.rig.serial), Library(tmp_path)
    store.folder.mkdir()
    store.air.write_bytes(
        encode_calibration(start_from_air(air_of(hidden_rig("realistic", SEED)), Instrument(rig).design()))
    )
    renderer = multiprocessing.get_context("spawn").Process(target=record, args=(rig,))
    renderer.start()
    renderer.join(600.0)
    assert renderer.exitcode == 0
    folders = {t.step: library.entry(t.scan_id).folder for t in store.session().trials if t.scan_id is not None}

    took_s: dict[str, float] = {}
    for step in USED:
        begun = time.process_time()
        check = examine_recording(rig, step, folders[step], silent).check
        took_s[step.value] = time.process_time() - begun
        assert check.refusal is None, check
    begun = time.process_time()
    reported = Told()
    solution = solve_calibration(rig, "2026-11-21T10:00:00+00:00", reported)
    took_s["SOLVE"] = time.process_time() - begun
    store.write_solved(solution.calibration, replace(store.session(), solved=solution.solved), solution.report)
    begun = time.process_time()
    examined = examine_recording(rig, Step.VERIFY, folders[Step.VERIFY], silent)
    took_s["VERIFY"] = time.process_time() - begun

    most_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"\nCPU { ({k: round(v, 1) for k, v in took_s.items()}) } s, memory {most_mb:.0f} MB, {examined.verified}")
    assert examined.verified is not None
    assert examined.verified == solution.verified, "the same, whether it was recorded before or after solving"
    assert examined.verified.before is not None
    assert examined.verified.after is not None
    assert abs(examined.verified.before) > 0.002, "from the drawing"
    assert abs(examined.verified.after) < 0.0004
    assert reported.all == sorted(reported.all, key=lambda one: one[1] or 0.0)
    assert solution.solved.warnings == ()
    assert max(took_s.values()) < 60.0
    assert (store.folder / "session" / "report.html").read_bytes().startswith(b"<!doctype html>")
