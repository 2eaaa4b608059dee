"""Files that a released version wrote are read by this one: scans, calibrations, beams, health, choices, a session, an object, an archive.

The recordings lie in ``tests/recordings``, which says how they were made; no test writes to them.
"""

from __future__ import annotations

import json
import shutil
import tarfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from appliance.calibration import file as calibration_file
from appliance.calibration.guide import Step
from appliance.cli import main
from appliance.config import Rig, load_rig
from appliance.instrument import calibration_of, pointers_of, standard_choices, start_of
from appliance.offline.object_errors import errors_of
from appliance.storage import objects
from appliance.storage.beams import BeamsFile
from appliance.storage.calibrations import Calibrations
from appliance.storage.choices import ChoicesFile
from appliance.storage.health import HealthFile
from appliance.storage.library import Library, LibraryFolder
from appliance.storage.manifest import Decision, Stage
from appliance.storage.ply import read_ply

RECORDINGS = Path(__file__).parents[1] / "recordings"
VERSIONS = sorted(path.name.removesuffix(".tar.xz") for path in RECORDINGS.glob("*.tar.xz"))
WIDTH_PX, HEIGHT_PX = 160, 120


@dataclass(frozen=True)
class Recorded:
    """A storage root of a released version, and what that version made of every scan."""

    version: str
    root: Path
    rig_file: Path
    expected: dict[str, Any]

    @property
    def rig(self) -> Rig:
        return load_rig(self.rig_file)

    @property
    def library(self) -> Library:
        return Library(self.root)


@pytest.fixture(scope="module", params=VERSIONS)
def recorded(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """Unpacked once; read only."""
    folder = tmp_path_factory.mktemp("recordings")
    with tarfile.open(RECORDINGS / f"{request.param}.tar.xz") as packed:
        packed.extractall(folder, filter="data")
    expected = json.loads((folder / "expected.json").read_text(encoding="utf-8"))
    return Recorded(request.param, folder / "root", folder / "rig.toml", expected)


def test_every_scan_is_listed_whole_and_says_what_it_said(recorded: Recorded) -> None:
    library = recorded.library
    assert [entry.scan_id for entry in library.entries()] == [
        "000001",
        "000002",
        "000004",
        "000005",
        "000006",
        "000007",
    ]
    assert [entry.scan_id for entry in library.entries(LibraryFolder.REJECTED)] == ["000003"]
    for shelf in (LibraryFolder.SCANS, LibraryFolder.REJECTED):
        for listed in library.entries(shelf):
            entry = library.verify(listed.scan_id)
            assert entry.problems == ()
            manifest = entry.manifest
            assert manifest is not None
            decided = Decision.KEPT if shelf is LibraryFolder.SCANS else Decision.REJECTED
            expected = (Stage.RAW, Decision.UNDECIDED) if manifest.recovered else (Stage.COMPLETE, decided)
            assert (manifest.stage, manifest.decision) == expected
            record = manifest.record
            assert record.software_version == recorded.expected["version"]
            assert record.wall_time is not None
            assert record.exposure is not None
            assert record.exposure.time_us == 12_000
            assert record.sequence.period_px == (16 if entry.scan_id in ("000006", "000007") else 32)
            assert record.water["temperature_c"] == 20.0
            assert record.verdicts[0].text == "all four witnesses agree"
            scan = library.load(entry.scan_id)
            for side in ("left", "right"):
                frames = scan.frames[side]
                assert frames.shape == (len(record.sequence.patterns), HEIGHT_PX, WIDTH_PX)
                bright, dark = (frames[record.sequence.patterns.index(name)] for name in ("bright", "dark"))
                assert float(bright.mean()) > float(dark.mean()) + 10.0


def test_figures_of_the_dive_are_those_that_were_stored(recorded: Recorded) -> None:
    points = {
        one.scan_id: one.manifest.record.cloud.get("points") for one in recorded.library.entries() if one.manifest
    }
    expected = {name.rpartition("/")[2]: said["points"] for name, said in recorded.expected["scans"].items()}
    assert points == {**{name: expected[name] for name in points}, "000004": None, "000007": None}, (
        "neither a step of a calibration nor a recovered scan has a cloud"
    )
    for name in ("000001", "000002", "000005", "000006"):
        scan = recorded.library.load(name)
        cloud = scan.cloud()
        assert cloud is not None
        assert len(cloud.points_mm) == expected[name]
        assert 380.0 < float(np.median(cloud.points_mm[:, 2])) < 680.0
        assert scan.manifest.record.cloud["noise_mm"] == pytest.approx(float(np.median(cloud.sigma_mm)), rel=0.05)
        verdicts = {one.name: one for one in scan.manifest.record.verdicts}
        assert verdicts["ray-gaps"].passed is True
        assert verdicts["motion"].numbers["added_noise_percent"] is not None


def test_two_exposures_are_still_one_scan(recorded: Recorded) -> None:
    scan = recorded.library.load("000002")
    assert scan.second is not None
    record = scan.manifest.record
    assert record.second is not None
    assert record.exposure is not None
    assert record.second.exposure.light != record.exposure.light
    assert {"pair", "grade"} <= {one.name for one in record.verdicts}
    assert scan.second["left"].shape == scan.frames["left"].shape
    assert not np.array_equal(scan.second["left"], scan.frames["left"])


@pytest.mark.parametrize("number", range(1, 7))
def test_reconstructing_gives_the_points_of_the_version_that_recorded(
    recorded: Recorded, number: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = next(name for name in recorded.expected["scans"] if name.endswith(f"{number:06d}"))
    said = recorded.expected["scans"][name]
    out = tmp_path / "again.ply"
    assert main(["reconstruct", str(recorded.root / name), "--out", str(out), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert (report["same_calibration"], report["calibration_from"]) == (True, "the scan's own")
    stored = recorded.root / name / "cloud.ply"
    # A later version may find better points, not fewer or quite other ones.
    assert 0.985 * said["points"] < report["points"] < 1.1 * said["points"]
    if stored.exists():
        before, after = (read_ply(path) for path in (stored, out))
        apart_mm, _ = cKDTree(after.points_mm).query(before.points_mm)
        assert float(np.median(apart_mm / before.sigma_mm)) < 0.8
        assert float(np.percentile(apart_mm / before.sigma_mm, 99.0)) < 6.0


def test_calibrations_of_every_model_are_read_and_are_the_same_ones(recorded: Recorded) -> None:
    folder = recorded.root / "calibration"
    files = [path for path in (*folder.glob("*.json"), *folder.glob("kept/*.json")) if path.name != "beams.json"]
    found = {path: calibration_file.load(path) for path in files}
    for path, one in found.items():
        assert one.rig_serial == "KF-SIM"
        assert (one.rig.left.width_px, one.rig.left.height_px) == (WIDTH_PX, HEIGHT_PX)
        assert one.hash == json.loads(path.read_text(encoding="utf-8"))["sha256"], "scans name it by this"
    models = {(one.rig.left.correction is not None, one.rig.left.ray_shift is not None) for one in found.values()}
    assert models == {(False, False), (True, False), (False, True)}
    assert found[folder / "air.json"].air_covariance is not None


def test_an_object_is_read(recorded: Recorded) -> None:
    (name,) = objects.names(recorded.root)
    stored = objects.read(recorded.root, name)
    assert stored.places is not None
    assert [scan.name for scan in stored.scans] == ["000001", "000006"]
    assert errors_of(stored) is not None


def test_an_archive_gives_the_scans_back_byte_for_byte(recorded: Recorded, tmp_path: Path) -> None:
    archive = recorded.root.parent / "archive"
    assert main(["archive", "unpack", str(archive), "--out", str(tmp_path / "root")]) == 0
    for name in ("000001", "000002"):
        scan, again = (root / "scans" / name for root in (recorded.root, tmp_path / "root"))
        assert {path.name for path in scan.iterdir()} == {path.name for path in again.iterdir()}
        assert all(path.read_bytes() == (again / path.name).read_bytes() for path in scan.iterdir())


def test_the_instrument_starts_with_what_was_in_use(recorded: Recorded, tmp_path: Path) -> None:
    root = shutil.copytree(recorded.root, tmp_path / "root")
    rig = recorded.rig
    rig = replace(rig, storage=replace(rig.storage, root=root))
    calibration, conditions = calibration_of(rig)
    assert conditions == ()
    assert calibration == calibration_file.load(root / "calibration" / "current.json")
    assert start_of(rig) == calibration_file.load(root / "calibration" / "air.json")
    session = Calibrations(root, rig.rig.serial).session()
    assert [(check.step, check.scan_id) for check in session.trials] == [(Step.M3, "000004")]
    chosen, fault = ChoicesFile(root, standard_choices(rig)).read()
    assert fault is None
    assert chosen.period_px == 16
    (calibrations,) = ({path.stem for path in (root / "calibration" / "health").glob("*.json")},)
    for path in (root / "calibration" / "kept").glob("000[12]*.json"):
        found = calibration_file.load(path).hash
        assert found[:16] in calibrations
        trend = HealthFile(root, found).read()
        assert trend.judged >= 1
        assert trend.points
    pointers = pointers_of(rig)
    assert pointers is not None
    known = json.loads((root / "calibration" / "beams.json").read_text(encoding="utf-8"))["calibration"]
    learned = BeamsFile(root, pointers).read(known)
    assert learned != pointers.beams(), "what the dots taught is not lost"
    assert json.loads((root / "run" / "status.json").read_text(encoding="utf-8"))["state"] == "REVIEW"


def test_a_scan_that_was_not_decided_when_the_power_went_is_recovered(recorded: Recorded, tmp_path: Path) -> None:
    root = shutil.copytree(recorded.root, tmp_path / "root")
    library = Library(root)
    outcome = library.recover()
    assert (outcome.recovered, outcome.set_aside, outcome.failed) == (("000008",), (), ())
    scan = library.load("000008")
    assert library.verify("000008").ok
    assert scan.manifest.recovered
    assert scan.frames["left"].shape[1:] == (HEIGHT_PX, WIDTH_PX)
