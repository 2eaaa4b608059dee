"""At the desk a stored scan gives the points it gave on the instrument, and calibrations are explained."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.calibration.file import CalibrationError, encode
from appliance.config import Rig
from appliance.instrument import CALIBRATION_FILE, calibration_of, design_of
from appliance.offline.calibration.files import describe_calibration, write_nominal_calibration
from appliance.offline.origin import calibration_for, open_source
from appliance.offline.reconstruct import reconstruct_scan
from appliance.offline.wish import Wish
from appliance.optics.model import StereoRig
from appliance.storage.calibrations import Calibrations
from appliance.storage.ply import read_ply
from tests.support.planes import small_rig, store_plane


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return small_rig(tmp_path / "storage")


def test_the_same_points_again(rig: Rig, tmp_path: Path) -> None:
    folder, points = store_plane(rig)
    seen: list[str] = []
    source = open_source(folder, Wish(rig))
    report = reconstruct_scan(source, calibration_for(source, Wish(rig)), tmp_path / "again.ply", seen.append)
    np.testing.assert_array_equal(read_ply(tmp_path / "again.ply").points_mm, points)
    assert report["points"] == len(points)
    assert report["same_calibration"] is True
    assert report["calibration_from"] == "the scan's own"
    assert any("frame 24 of 24" in text for text in seen)


def test_another_calibration_gives_other_points_and_says_so(rig: Rig, tmp_path: Path) -> None:
    folder, points = store_plane(rig)
    other = replace(design_of(rig), method="bundle")
    moved = replace(other.rig.left, port=replace(other.rig.left.port, distance_mm=33.0))
    path = tmp_path / "other.json"
    path.write_bytes(encode(replace(other, rig=replace(other.rig, left=moved))))
    wish = Wish(rig, calibration=path)
    source = open_source(folder, wish)
    report = reconstruct_scan(source, calibration_for(source, wish), tmp_path / "again.ply", lambda text: None)
    assert report["same_calibration"] is False
    again = read_ply(tmp_path / "again.ply").points_mm
    assert abs(np.max(again[:, 2]) - np.max(points[:, 2])) > 0.2, "three millimetres of port bend the plane"


def test_an_instrument_without_calibration_uses_its_design_and_says_so(rig: Rig) -> None:
    calibration, conditions = calibration_of(rig)
    assert calibration.method == "design"
    assert [fault.code.value for fault in conditions] == ["UNCALIBRATED"]


def test_when_the_calibration_is_damaged_the_one_before_is_used_and_that_is_said(rig: Rig) -> None:
    first, second = (replace(design_of(rig), method=method) for method in ("bundle", "operator"))
    calibrations = Calibrations(rig.storage.root, rig.rig.serial)
    calibrations.install(first, "2026-01-01")
    calibrations.install(second, "2026-02-01")
    path = rig.storage.root / CALIBRATION_FILE
    assert calibration_of(rig) == (second, ())
    path.write_bytes(path.read_bytes()[:-40])
    used, (condition,) = calibration_of(rig)
    assert used == first
    assert condition.code.value == "UNCALIBRATED"
    assert "0001-2026-02-01.json, which was in use before, is used" in condition.detail


@pytest.mark.parametrize(
    ("change", "complaint"),
    [("serial", "is of instrument OTHER"), ("size", "camera has 200x300 px"), ("bytes", "checksum")],
)
def test_a_calibration_that_does_not_fit_is_not_used(rig: Rig, change: str, complaint: str) -> None:
    good = replace(design_of(rig), method="bundle")
    if change == "serial":
        good = replace(good, rig_serial="OTHER")
    if change == "size":
        good = replace(good, rig=replace(good.rig, left=replace(good.rig.left, width_px=200)))
    data = encode(good)
    path = rig.storage.root / CALIBRATION_FILE
    path.parent.mkdir(parents=True)
    path.write_bytes(data.replace(b"30.0", b"31.0", 1) if change == "bytes" else data)
    calibration, conditions = calibration_of(rig)
    assert calibration.method == "design"
    assert complaint in conditions[0].detail


def test_a_calibration_that_fits_is_used(rig: Rig) -> None:
    good = replace(design_of(rig), method="bundle")
    path = rig.storage.root / CALIBRATION_FILE
    path.parent.mkdir(parents=True)
    path.write_bytes(encode(good))
    assert calibration_of(rig) == (good, ())


def test_calibration_show_and_nominal(rig: Rig, tmp_path: Path) -> None:
    path = write_nominal_calibration(rig, tmp_path / "nominal.json")
    described = describe_calibration(rig, path)
    assert described["method"] == "design"
    assert described["baseline_mm"] == pytest.approx(230.0)
    with pytest.raises(CalibrationError, match="cannot be read"):
        describe_calibration(rig, tmp_path / "nothing.json")


def test_a_lens_calibrated_in_water_has_no_port_to_show(rig: Rig, tmp_path: Path) -> None:
    drawn = design_of(rig)
    assert describe_calibration(rig, write_nominal_calibration(rig, None))["interface_distance_mm"] is not None
    left, right = (replace(camera, lens_in_water=True) for camera in (drawn.rig.left, drawn.rig.right))
    wet = StereoRig(left, right)
    path = tmp_path / "wet.json"
    path.write_bytes(encode(replace(drawn, method="pinhole, in water", rig=wet)))
    described = describe_calibration(rig, path)
    assert described["interface_distance_mm"] is None
    assert described["port_tilt_deg"] is None
    assert described["baseline_mm"] == pytest.approx(230.0)
