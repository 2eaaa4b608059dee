"""Two stored scans with different exposures become one cloud at the desk, or a reason why not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.calibration.file import encode, load
from appliance.config import Rig, load_rig
from appliance.config.load import default_rig_path
from appliance.offline.merging import merge_scans, merged_cloud_of
from appliance.offline.origin import one_calibration, open_source
from appliance.offline.wish import Wish
from appliance.storage import scan as stored
from appliance.storage.ply import read_ply
from appliance.storage.scan import ScanError
from hw_sim.scene import Scene
from tests.support.rendered import judge, reconstruct, render_scan
from tests.support.stored import store
from tests.support.truth import true_calibration

SCENE = Scene(object="stones", texture="checker")
WIDTH_PX = 400


def silent(what: str) -> None:
    """No progress is shown."""


def rig() -> Rig:
    whole = load_rig(default_rig_path())
    camera = whole.camera
    small = {side: replace(getattr(camera, side), width_px=400, height_px=300) for side in ("left", "right")}
    return replace(whole, camera=replace(camera, **small))


def test_a_cloud_of_two_exposures_has_more_points_and_is_as_true(tmp_path: Path) -> None:
    exposures_ms = {"000001": 16.0, "000002": 2.5}
    scans = {
        name: render_scan(SCENE, "realistic", 5, WIDTH_PX, 16, exposure_s=ms / 1e3) for name, ms in exposures_ms.items()
    }
    folders = {name: store(scan, tmp_path / name, exposure_ms=exposures_ms[name]) for name, scan in scans.items()}
    calibration = true_calibration(scans["000001"].renderer.truth)
    (tmp_path / "calibration.json").write_bytes(encode(calibration))
    calibration = load(tmp_path / "calibration.json")
    alone = {name: judge(scan, reconstruct(scan, calibration)[1]) for name, scan in scans.items()}
    out = tmp_path / "both.ply"
    wish = Wish(rig(), calibration=tmp_path / "calibration.json")
    sources = open_source(folders["000001"], wish), open_source(folders["000002"], wish)
    report = merge_scans(
        sources, one_calibration(sources, Wish(calibration=wish.calibration, foreign=True)), out, silent
    )
    assert report["scans"] == "000002 + 000001", "the shorter one gives the grey values"
    assert report["exposures"] == "2.5 ms + 16 ms"
    loaded = (stored.load(folders["000002"]), stored.load(folders["000001"]))
    cloud, _, _ = merged_cloud_of(loaded, rig(), calibration, lambda what: None)
    np.testing.assert_array_equal(read_ply(out).points_mm, cloud.points_mm)
    together = judge(scans["000001"], cloud)
    assert together.completeness_percent > max(one.completeness_percent for one in alone.values()) + 2.0
    assert together.rms_mm < 1.05 * max(one.rms_mm for one in alone.values())
    assert together.outliers_ppm <= max(one.outliers_ppm for one in alone.values()) + 100.0


def test_scans_between_which_the_instrument_moved_are_refused(tmp_path: Path) -> None:
    moved = replace(SCENE, pose=(25.0, 0.0, 520.0, 0.0, 0.0, 9.0))
    still = replace(SCENE, pose=(0.0, 0.0, 500.0, 0.0, 0.0, 0.0))
    first, second = (render_scan(scene, "realistic", 5, WIDTH_PX, 16, exposure_s=0.006) for scene in (still, moved))
    folders = store(first, tmp_path / "000001"), store(second, tmp_path / "000002")
    calibration = true_calibration(first.renderer.truth)
    with pytest.raises(ScanError, match=r"(moved by|too little in common|one rigid thing)"):
        merged_cloud_of((stored.load(folders[0]), stored.load(folders[1])), rig(), calibration, lambda what: None)


def test_scans_of_other_patterns_are_refused(tmp_path: Path) -> None:
    strips = [render_scan(SCENE, "nominal", 1, 64, period_px, height_px=48) for period_px in (16, 32)]
    loaded = [
        stored.load(store(strip, tmp_path / name)) for strip, name in zip(strips, ("000001", "000002"), strict=True)
    ]
    with pytest.raises(ScanError, match="different patterns"):
        merged_cloud_of((loaded[0], loaded[1]), rig(), true_calibration(strips[0].renderer.truth), lambda what: None)
