"""What is rescued of a broken scan: the whole scan's points, as fine, marked as unchecked and taken by nobody who measures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from appliance.base import silent
from appliance.desk.rescue import rescue_recording
from appliance.measure.calibration.file import encode_calibration
from appliance.store import incomplete
from appliance.store.atomic import LocalFileSystem
from appliance.store.config import Rig
from appliance.store.config.spell import rig_text
from appliance.store.incomplete import IncompleteRecording
from appliance.store.instrument import Instrument
from appliance.store.origin import SourceScan
from appliance.store.ply import read_ply
from appliance.store.scan import ScanError, ScanOrigin, StoredScan
from appliance.store.wish import ScanOptions
from tests.support.commands import Shell
from tests.support.planes import small_rig, store_plane

OF_X = 13
"""Frames of the references and of X: 2, 7 and 4."""


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return small_rig(tmp_path / "storage")


@pytest.fixture
def whole(rig: Rig) -> StoredScan:
    return StoredScan.load(store_plane(rig)[0])


def broken(rig: Rig, whole: StoredScan, count: int, rows: slice = slice(None)) -> incomplete.IncompleteRecording:
    """A recording of which ``count`` frames were made, dark but for some ``rows``."""
    frames = {side: np.zeros_like(one[:count]) for side, one in whole.frames.items()}
    for side, dark in frames.items():
        dark[:, rows] = whole.frames[side][:count, rows]
    origin, record = (
        ScanOrigin(encode_calibration(Instrument(rig).design()), rig_text(rig).encode()),
        whole.manifest.record,
    )
    root, reason = rig.storage.root, "CAMERA_LOST: it went away"
    return IncompleteRecording.load(
        IncompleteRecording.keep(LocalFileSystem(), root, frames, record, origin, reason, 0)
    )


def rescued(recording: incomplete.IncompleteRecording, out: Path) -> dict[str, object]:
    """The report; no rig file and no root is given: the recording carries all that it needs."""
    source = SourceScan.open(recording.scan.folder, ScanOptions(), recording.scan)
    return dict(rescue_recording(recording, source, source.calibration_for(ScanOptions()), out, silent))


def test_the_points_are_those_of_the_whole_scan_and_say_that_nothing_checked_them(
    rig: Rig, whole: StoredScan, tmp_path: Path
) -> None:
    out = tmp_path / "rescued.ply"
    with pytest.raises(ScanError, match="12 frames"):
        rescued(broken(rig, whole, OF_X - 1), out)
    with pytest.raises(ScanError, match="has no usable cloud"):
        rescued(broken(rig, whole, OF_X, slice(40, 42)), out)
    assert not out.exists()
    report = rescued(broken(rig, whole, OF_X), out)
    cloud, wanted = read_ply(out), whole.cloud()
    assert wanted is not None
    assert len(cloud.points_mm) == report["points"]
    assert len(cloud.points_mm) > 0.99 * len(wanted.points_mm)
    normal = np.array([0.0, 0.1, 1.0]) / np.hypot(0.1, 1.0)
    assert np.std(cloud.points_mm @ normal) < 1.05 * np.std(wanted.points_mm @ normal)
    assert np.median(cloud.sigma_mm) == pytest.approx(np.median(wanted.sigma_mm), rel=0.1)
    np.testing.assert_allclose(np.median(cloud.points_mm, axis=0), np.median(wanted.points_mm, axis=0), atol=0.3)
    assert np.isnan(cloud.ray_gap_mm).all()
    assert report["same_calibration"]
    assert str(report["missing"]).startswith("gray-y-0, ")
    for words in (str(report["unchecked"]), cloud.unchecked or ""):
        assert "one direction" in words
        assert words.endswith("CAMERA_LOST: it went away")
    assert b"\ncomment unchecked: fringes of one direction only" in out.read_bytes()[:400]
    assert wanted.unchecked is None


def test_nobody_who_measures_takes_it(
    rig: Rig, whole: StoredScan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, shell, root = broken(rig, whole, OF_X).scan.folder, Shell(capsys), rig.storage.root
    (tmp_path / "list.toml").write_text(f'[[scan]]\nscan = "{folder}"\nartefact = "plane"\n')
    for words in (
        ("evaluate", tmp_path / "list.toml"), ("calibration", "water", tmp_path / "list.toml", "--root", root),
    ):  # fmt: skip
        said = shell(*words)
        assert (said.code != 0, "`kingfisher cloud incomplete:N`" in said.error) == (True, True)
    assert "no incomplete recording '3'" in shell("cloud", "incomplete:3", "--root", root).error
