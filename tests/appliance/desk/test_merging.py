"""Two stored scans with different exposures become one cloud at the desk, or a reason why not; the cloud is frozen in ``tests/behaviour``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.base import silent
from appliance.desk.merging import merge_clouds, merge_scans
from appliance.measure.calibration.file import encode_calibration
from appliance.store.config import Rig, load_rig
from appliance.store.instrument import load_calibration
from appliance.store.origin import SourceScan
from appliance.store.ply import read_ply
from appliance.store.scan import ScanError, StoredScan
from appliance.store.wish import ScanOptions
from hw_sim.scene import Scene
from tests.support.rendered import judge, reconstruct, render_scan
from tests.support.stored import store
from tests.support.truth import true_calibration

SCENE = Scene(object="stones", texture="checker")
SIZE_PX = (240, 180)


@pytest.fixture
def rig() -> Rig:
    whole = load_rig()
    cameras = {side: getattr(whole.camera, side) for side in ("left", "right")}
    small = {side: replace(one, width_px=SIZE_PX[0], height_px=SIZE_PX[1]) for side, one in cameras.items()}
    return replace(whole, camera=replace(whole.camera, **small))


@pytest.mark.dive
def test_a_cloud_of_two_exposures_has_more_points_and_is_as_true(rig: Rig, tmp_path: Path) -> None:
    exposures_ms = {"000001": 16.0, "000002": 2.5}
    scans = {
        name: render_scan(SCENE, "realistic", 5, SIZE_PX[0], 16, exposure_s=ms / 1e3)
        for name, ms in exposures_ms.items()
    }
    folders = {name: store(scan, tmp_path / name, exposure_ms=exposures_ms[name]) for name, scan in scans.items()}
    path, out = tmp_path / "calibration.json", tmp_path / "both.ply"
    path.write_bytes(encode_calibration(true_calibration(scans["000001"].renderer.truth)))
    sources = SourceScan.open(folders["000001"], ScanOptions(rig)), SourceScan.open(folders["000002"], ScanOptions(rig))
    report = merge_scans(
        sources, SourceScan.one_calibration(sources, ScanOptions(calibration=path, foreign=True)), out, silent
    )
    assert report["scans"] == "000002 + 000001", "the shorter one gives the grey values"
    assert report["exposures"] == "2.5 ms + 16 ms"
    loaded = (StoredScan.load(folders["000002"]), StoredScan.load(folders["000001"]))
    cloud, _, _ = merge_clouds(loaded, rig, load_calibration(path), silent)
    np.testing.assert_array_equal(read_ply(out).points_mm, cloud.points_mm)
    alone = [judge(scan, reconstruct(scan, load_calibration(path))[1]) for scan in scans.values()]
    together = judge(scans["000001"], cloud)
    assert together.completeness_percent > max(one.completeness_percent for one in alone) + 2.0
    assert together.rms_mm < 1.05 * max(one.rms_mm for one in alone)


def test_scans_between_which_the_instrument_moved_and_of_other_patterns_are_refused(rig: Rig, tmp_path: Path) -> None:
    moved = replace(SCENE, pose=(25.0, 0.0, 520.0, 0.0, 0.0, 9.0))
    still = replace(SCENE, pose=(0.0, 0.0, 500.0, 0.0, 0.0, 0.0))
    scans = [render_scan(scene, "realistic", 5, SIZE_PX[0], 16, exposure_s=0.006) for scene in (still, moved)]
    scans.append(render_scan(still, "nominal", 1, 64, 32, height_px=48))
    loaded = [StoredScan.load(store(scan, tmp_path / f"{k:06d}")) for k, scan in enumerate(scans, 1)]
    for other, said in ((loaded[1], r"moved by|too little overlap|one rigid object"), (loaded[2], "patterns")):
        with pytest.raises(ScanError, match=said):
            merge_clouds((loaded[0], other), rig, true_calibration(scans[0].renderer.truth), silent)
