"""What a calibration in water starts from, and the words when there is nothing to start from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.calibration.file import Calibration, CalibrationError, encode
from appliance.calibration.guide import USED, AdjustmentSummary, RecordingCheck, Refusal, Session, Step
from appliance.calibration.recordings import RecordingError
from appliance.cli.simrig import SimOptions, default_sim_rig, simulated
from appliance.config import Rig, load_rig
from appliance.instrument import design_of
from appliance.optics.correction import INTERVALS, ImageCorrection, node_count
from appliance.optics.model import StereoRig
from appliance.service.calibrator import basis_of, examine, solve
from appliance.storage.calibrations import Calibrations
from appliance.storage.library import Library, UnknownScan
from appliance.storage.record import ScanRecord, SequenceInfo
from hw_sim.scene import Scene
from tests.support.rendered import render_scan

WIDTH_PX = 400


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    made = simulated(load_rig(default_sim_rig()), SimOptions(root=tmp_path, size="400x300"))
    (tmp_path / "calibration").mkdir()
    return made


def put(rig: Rig, name: str, calibration: Calibration) -> Calibration:
    (rig.storage.root / "calibration" / name).write_bytes(encode(calibration))
    return calibration


def in_air(rig: Rig) -> Calibration:
    covariance = tuple(tuple(float(x) for x in row) for row in np.diag(np.full(22, 1e-6)))
    return replace(design_of(rig), method="air", air_covariance=covariance)


def corrected(rig: Rig) -> Calibration:
    design = design_of(rig)
    size = design.rig.left.width_px, design.rig.left.height_px
    bent = ImageCorrection(*size, INTERVALS, (0.01,) * (2 * node_count(INTERVALS)))
    cameras = StereoRig(replace(design.rig.left, correction=bent), replace(design.rig.right, correction=bent))
    return replace(design, method="bundle, spline", rig=cameras)


def record(rig: Rig, scene: Scene) -> Path:
    """A stored scan of a scene before an instrument built to the drawing; its folder."""
    scan = render_scan(scene, "nominal", 5, WIDTH_PX, 16)
    library = Library(rig.storage.root)
    library.prepare()
    info = ScanRecord(SequenceInfo.of(scan.sequence), rig.rig_hash, None, "0", None, False, 0)
    return library.begin(scan.frames, info).publish(info)


def test_without_anything_the_drawing_is_the_start(rig: Rig) -> None:
    basis = basis_of(rig)
    assert basis.start == design_of(rig)
    assert basis.before == design_of(rig)
    assert basis.bar.length_mm == 150.0


def test_the_calibration_in_air_is_the_start_and_the_one_in_use_is_compared_with(rig: Rig) -> None:
    air, current = put(rig, "air.json", in_air(rig)), put(rig, "current.json", corrected(rig))
    basis = basis_of(rig)
    assert basis.start == air
    assert basis.start.air_covariance is not None
    assert basis.before == current


def test_once_in_use_the_new_one_is_still_compared_with_the_one_before(rig: Rig) -> None:
    before, new = put(rig, "current.json", in_air(rig)), replace(design_of(rig), method="bundle, ports")
    store = Calibrations(rig.storage.root, rig.rig.serial)
    store.write_solved(new, Session((), AdjustmentSummary(new.method, 0.03, (), new.hash)))
    assert store.use_solved("2026-11-21").in_use
    assert basis_of(rig).before == before


def test_a_corrected_calibration_is_no_start_and_that_is_said_at_once(rig: Rig) -> None:
    put(rig, "current.json", corrected(rig))
    with pytest.raises(RecordingError, match=r"bundle, spline.*put the one in air at .*air\.json"):
        basis_of(rig)


def test_the_calibration_in_air_of_another_instrument_is_named(rig: Rig) -> None:
    put(rig, "air.json", replace(in_air(rig), rig_serial="KF-9999"))
    with pytest.raises(CalibrationError, match=r"air\.json.*KF-9999"):
        basis_of(rig)


def test_without_a_certificate_the_rig_file_is_named(rig: Rig) -> None:
    with pytest.raises(RecordingError, match=r"\[ball_bar\] in the rig file"):
        basis_of(replace(rig, ball_bar=None))


def test_a_recording_that_is_gone_is_named(rig: Rig) -> None:
    store = Calibrations(rig.storage.root, rig.rig.serial)
    store.write(Session(tuple(RecordingCheck(step, None, 0.03) for step in USED)))
    with pytest.raises(RecordingError, match="no recording of M1, M2, M3, M4"):
        solve(rig, "2026-11-21", lambda _: None)
    store.write(Session(tuple(RecordingCheck(step, None, 0.03, scan_id="000099") for step in USED)))
    with pytest.raises(UnknownScan, match="000099"):
        solve(rig, "2026-11-21", lambda _: None)


def test_planes_and_what_is_none_are_told_apart(rig: Rig) -> None:
    folder = record(rig, Scene(object="plane", pose=(0.0, 0.0, 475.0, 6.0, 0.0, 0.0), texture="none"))
    near = examine(rig, Step.M3, folder, lambda _: None).check
    assert near.refusal is None
    assert near.points > 500
    far = examine(rig, Step.M4, folder, lambda _: None).check
    assert far.refusal is Refusal.TOO_NEAR
    assert far.number == pytest.approx(475.0, abs=1.5)
    bar = examine(rig, Step.M1, folder, lambda _: None).check
    assert bar.refusal is Refusal.NOT_FOUND
    assert "ball" in bar.detail
    folder = record(rig, Scene(object="ballbar", pose=(0.0, 0.0, 520.0, 0.0, 35.0, 0.0), texture="none"))
    assert examine(rig, Step.M3, folder, lambda _: None).check.refusal is not None
