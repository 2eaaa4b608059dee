"""What is rescued of a broken scan: the whole scan's points, as fine, marked as unchecked and taken by nobody who measures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from appliance.calibration.file import encode
from appliance.config import Rig
from appliance.config.spell import rig_text
from appliance.instrument import design_of
from appliance.offline.origin import calibration_for, open_source
from appliance.offline.rescue import rescue_recording
from appliance.offline.wish import Wish
from appliance.storage import incomplete
from appliance.storage import scan as stored
from appliance.storage.filesystem import LocalFileSystem
from appliance.storage.ply import StoredCloud, read_ply
from appliance.storage.scan import ScanError, ScanOrigin
from tests.support.commands import Shell
from tests.support.planes import small_rig, store_plane

OF_X = 13
"""Frames of the references and of X: 2, 7 and 4."""


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return small_rig(tmp_path / "storage")


def broken(rig: Rig, count: int) -> tuple[Path, StoredCloud]:
    """A scan of which ``count`` frames were recorded, and the cloud that the whole one has."""
    whole = stored.load(store_plane(rig)[0])
    frames = {side: np.array(one[:count]) for side, one in whole.frames.items()}
    origin = ScanOrigin(encode(design_of(rig)), rig_text(rig).encode())
    folder = incomplete.keep(
        LocalFileSystem(), rig.storage.root, frames, whole.manifest.record, origin, "CAMERA_LOST: it went away", 0
    )
    cloud = whole.cloud()
    assert cloud is not None
    return folder, cloud


def test_the_points_are_those_of_the_whole_scan_and_say_that_nothing_checked_them(rig: Rig, tmp_path: Path) -> None:
    folder, whole = broken(rig, OF_X)
    recording = incomplete.load(folder)
    # No rig file and no root is given: the recording carries all that it needs.
    source = open_source(folder, Wish(), recording.scan)
    chosen = calibration_for(source, Wish())
    report = rescue_recording(recording, source, chosen, tmp_path / "rescued.ply", lambda text: None)
    cloud = read_ply(tmp_path / "rescued.ply")
    assert len(cloud.points_mm) == report["points"] > 0.99 * len(whole.points_mm)
    normal = np.array([0.0, 0.1, 1.0]) / np.hypot(0.1, 1.0)
    one, two = (float(np.std(one.points_mm @ normal)) for one in (cloud, whole))
    assert one < 1.05 * two
    assert np.median(cloud.sigma_mm) == pytest.approx(np.median(whole.sigma_mm), rel=0.1)
    np.testing.assert_allclose(np.median(cloud.points_mm, axis=0), np.median(whole.points_mm, axis=0), atol=0.3)
    assert np.isnan(cloud.ray_gap_mm).all()
    assert report["same_calibration"]
    assert report["missing"].startswith("gray-y-0, ")
    for words in (report["unchecked"], cloud.unchecked or ""):
        assert "one direction" in words
        assert words.endswith("CAMERA_LOST: it went away")
    assert b"\ncomment unchecked: fringes of one direction only" in (tmp_path / "rescued.ply").read_bytes()[:400]
    assert whole.unchecked is None


def test_half_a_direction_is_no_direction(rig: Rig, tmp_path: Path) -> None:
    folder, _ = broken(rig, OF_X - 1)
    recording = incomplete.load(folder)
    source = open_source(folder, Wish(), recording.scan)
    with pytest.raises(ScanError, match="12 frames were recorded; the first direction has 13"):
        rescue_recording(recording, source, calibration_for(source, Wish()), tmp_path / "x.ply", lambda text: None)
    assert not (tmp_path / "x.ply").exists()


def test_nobody_who_measures_takes_it(rig: Rig, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, _ = broken(rig, OF_X)
    shell = Shell(capsys)
    (tmp_path / "list.toml").write_text(f'[[scan]]\nscan = "{folder}"\nartefact = "plane"\n')
    for words in (
        ("evaluate", tmp_path / "list.toml"),
        ("calibrate", "water", tmp_path / "list.toml", "--root", rig.storage.root),
        ("reconstruct", folder),
        ("reconstruct", folder, "--salvage"),
    ):
        said = shell(*words)
        assert said.code != 0
        assert (
            "an incomplete recording is no scan, and nothing is measured, evaluated or calibrated with it" in said.error
        )
        assert "`kingfisher rescue`" in said.error
    said = shell("rescue", "3", "--root", rig.storage.root)
    assert "no incomplete recording '3'" in said.error
