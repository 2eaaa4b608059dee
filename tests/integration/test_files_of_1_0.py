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

from appliance.calibration import file as calibration_file
from appliance.calibration.guide import Step
from appliance.cli import main
from appliance.config import load_rig
from appliance.instrument import calibration_of, pointers_of, standard_choices, start_of
from appliance.offline.object_errors import errors_of
from appliance.storage import objects
from appliance.storage.beams import BeamsFile
from appliance.storage.calibrations import Calibrations
from appliance.storage.choices import ChoicesFile
from appliance.storage.health import HealthFile
from appliance.storage.library import Library, LibraryFolder
from appliance.storage.manifest import Decision, Stage

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
    def library(self) -> Library:
        return Library(self.root)

    def points(self, scan_id: str) -> int:
        """Return how many points that version found in a kept scan."""
        return int(self.expected["scans"][f"scans/{scan_id}"]["points"])


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
    assert library.ids() == ["000001", "000002", "000004", "000005", "000006", "000007"]
    assert [entry.scan_id for entry in library.entries(LibraryFolder.REJECTED)] == ["000003"]
    for shelf, decided in ((LibraryFolder.SCANS, Decision.KEPT), (LibraryFolder.REJECTED, Decision.REJECTED)):
        for listed in library.entries(shelf):
            entry = library.verify(listed.scan_id)
            manifest = entry.manifest
            assert entry.problems == ()
            assert manifest is not None
            expected = (Stage.RAW, Decision.UNDECIDED) if manifest.recovered else (Stage.COMPLETE, decided)
            assert (manifest.stage, manifest.decision) == expected
            record = manifest.record
            assert record.software_version == recorded.expected["version"]
            assert record.wall_time is not None
            assert record.exposure is not None
            assert record.exposure.time_us == 12_000
            assert record.sequence.period_px == (16 if entry.scan_id in ("000006", "000007") else 32)
            assert record.verdicts[0].name == "ledger"
            frames = library.load(entry.scan_id).frames["right"]
            assert frames.shape == (len(record.sequence.patterns), HEIGHT_PX, WIDTH_PX)
    # Neither a step of a calibration nor a recovered scan has a cloud.
    for name in ("000001", "000002", "000005", "000006"):
        scan = library.load(name)
        cloud = scan.cloud()
        assert cloud is not None
        assert len(cloud.points_mm) == scan.manifest.record.cloud["points"] == recorded.points(name)
        assert 380.0 < float(np.median(cloud.points_mm[:, 2])) < 680.0
    scan = library.load("000002")
    second = scan.manifest.record.second
    assert scan.second is not None, "two exposures are still one scan"
    assert second is not None
    assert second.exposure.light != scan.manifest.record.exposure.light  # type: ignore[union-attr]
    assert not np.array_equal(scan.second["left"], scan.frames["left"])


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


def test_an_archive_gives_the_scans_back_byte_for_byte(recorded: Recorded, tmp_path: Path) -> None:
    archive = recorded.root.parent / "archive"
    assert main(["archive", "unpack", str(archive), "--out", str(tmp_path / "root")]) == 0
    for name in ("000001", "000002"):
        scan, again = (root / "scans" / name for root in (recorded.root, tmp_path / "root"))
        assert {path.name for path in scan.iterdir()} == {path.name for path in again.iterdir()}
        assert all(path.read_bytes() == (again / path.name).read_bytes() for path in scan.iterdir())


def test_the_instrument_starts_with_what_was_in_use_and_recovers_what_was_not_decided(
    recorded: Recorded, tmp_path: Path
) -> None:
    root = shutil.copytree(recorded.root, tmp_path / "root")
    rig = replace(load_rig(recorded.rig_file), storage=replace(load_rig(recorded.rig_file).storage, root=root))
    calibration, conditions = calibration_of(rig)
    assert conditions == ()
    assert calibration == calibration_file.load(root / "calibration" / "current.json")
    assert start_of(rig) == calibration_file.load(root / "calibration" / "air.json")
    session = Calibrations(root, rig.rig.serial).session()
    assert [(check.step, check.scan_id) for check in session.trials] == [(Step.M3, "000004")]
    chosen, fault = ChoicesFile(root, standard_choices(rig)).read()
    assert (chosen.period_px, fault) == (16, None)
    for path in (root / "calibration" / "kept").glob("000[12]*.json"):
        assert HealthFile(root, calibration_file.load(path).hash).read().points
    pointers = pointers_of(rig)
    assert pointers is not None
    known = json.loads((root / "calibration" / "beams.json").read_text(encoding="utf-8"))["calibration"]
    assert BeamsFile(root, pointers).read(known) != pointers.beams(), "what the dots taught is not lost"
    (name,) = objects.names(root)
    stored = objects.read(root, name)
    assert [scan.name for scan in stored.scans] == ["000001", "000006"]
    assert errors_of(stored) is not None

    library = Library(root)
    outcome = library.recover()
    assert (outcome.recovered, outcome.set_aside, outcome.failed) == (("000008",), (), ())
    assert library.verify("000008").ok
    assert library.load("000008").manifest.recovered
