"""At the desk a stored scan gives the points it gave on the instrument, and calibrations are explained."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.calibrate.calibrations import Calibrations
from appliance.calibrate.files import describe_calibration
from appliance.desk.reconstruct import reconstruct_scan
from appliance.measure.calibration.file import encode_calibration
from appliance.measure.light.model import StereoRig
from appliance.store.config import Rig
from appliance.store.instrument import Instrument
from appliance.store.origin import SourceScan
from appliance.store.ply import read_ply
from appliance.store.wish import ScanOptions
from tests.support.planes import small_rig, store_plane
from tests.support.told import Told


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return small_rig(tmp_path / "storage")


def test_another_calibration_gives_other_points(rig: Rig, tmp_path: Path) -> None:
    """The scan's own gives the same bytes again: ``tests/integration/test_desk_commands.py``."""
    folder, points = store_plane(rig)
    other, out = replace(Instrument(rig).design(), method="bundle"), tmp_path / "again.ply"
    moved = replace(other.rig.left, port=replace(other.rig.left.port, distance_mm=33.0))
    (tmp_path / "other.json").write_bytes(encode_calibration(replace(other, rig=replace(other.rig, left=moved))))
    wish, seen = ScanOptions(rig, calibration=tmp_path / "other.json"), Told()
    source = SourceScan.open(folder, wish)
    report = reconstruct_scan(source, source.calibration_for(wish), out, seen)
    again = read_ply(out).points_mm
    assert (report["same_calibration"], report["points"]) == (False, len(again))
    assert abs(np.max(again[:, 2]) - np.max(points[:, 2])) > 0.2, "three millimetres of port bend the plane"
    assert any("frame 24 of 24" in text for text in seen.words)


def test_when_the_calibration_is_damaged_or_anothers_the_one_before_is_used_and_that_is_said(rig: Rig) -> None:
    first, second = (replace(Instrument(rig).design(), method=method) for method in ("bundle", "operator"))
    calibrations = Calibrations(rig.storage.root, rig.rig.serial)
    calibrations.install(first, "2026-01-01")
    calibrations.install(second, "2026-02-01")
    path = Instrument(rig).calibration_file
    assert Instrument(rig).calibration() == (second, ())
    for wrong in (path.read_bytes()[:-40], encode_calibration(replace(second, rig_serial="KF-0007"))):
        path.write_bytes(wrong)
        used, (condition,) = Instrument(rig).calibration()
        assert (used, condition.code.value) == (first, "UNCALIBRATED")
        assert "0001-2026-02-01.json" in condition.detail


@pytest.mark.parametrize(
    ("change", "complaint"), [("none", None), ("missing", ""), ("serial", "OTHER"), ("size", "200x300"), ("bytes", "checksum")]
)  # fmt: skip
def test_a_calibration_that_fits_is_used_and_else_the_design(rig: Rig, change: str, complaint: str | None) -> None:
    good = replace(Instrument(rig).design(), method="bundle")
    if change == "serial":
        good = replace(good, rig_serial="OTHER")
    if change == "size":
        good = replace(good, rig=replace(good.rig, left=replace(good.rig.left, width_px=200)))
    data = encode_calibration(good)
    path = Instrument(rig).calibration_file
    path.parent.mkdir(parents=True)
    if change != "missing":
        path.write_bytes(data.replace(b"30.0", b"31.0", 1) if change == "bytes" else data)
    calibration, conditions = Instrument(rig).calibration()
    if complaint is None:
        assert (calibration, conditions) == (good, ())
        return
    assert (calibration.method, conditions[0].code.value) == ("design", "UNCALIBRATED")
    assert complaint in conditions[0].detail


def test_a_calibration_is_described_and_a_lens_calibrated_in_water_has_no_port_to_show(rig: Rig) -> None:
    described = describe_calibration(Instrument(rig).design())
    assert (described["method"], described["interface_distance_mm"] is None) == ("design", False)
    assert described["baseline_mm"] == pytest.approx(230.0)
    drawn = Instrument(rig).design()
    left, right = (replace(camera, lens_in_water=True) for camera in (drawn.rig.left, drawn.rig.right))
    described = describe_calibration(replace(drawn, method="pinhole, in water", rig=StereoRig(left, right)))
    assert (described["interface_distance_mm"], described["port_tilt_deg"]) == (None, None)
    assert described["baseline_mm"] == pytest.approx(230.0)
