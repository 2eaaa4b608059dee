"""Files that an earlier version wrote are read by this one: scans, calibrations, beams, health, choices, a session, an object, an archive.

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

from appliance.calibrate.calibrations import Calibrations
from appliance.calibrate.guide import Step
from appliance.calibrate.health import HealthFile
from appliance.calibrate.water_steps import start_of
from appliance.cli import main
from appliance.desk import object_store as objects
from appliance.desk.object_errors import errors_of
from appliance.instrument.service.remembered import BeamsFile, ChoicesFile
from appliance.instrument.service.settings import pointers_of, standard_choices
from appliance.store.config import load_rig
from appliance.store.instrument import Instrument, load_calibration
from appliance.store.library import Library, LibraryFolder
from appliance.store.manifest import Stage

RECORDINGS = Path(__file__).parents[1] / "recordings"
VERSIONS = sorted(path.name.removesuffix(".tar.xz") for path in RECORDINGS.glob("*.tar.xz"))
WIDTH_PX, HEIGHT_PX = 160, 120


@dataclass(frozen=True)
class Recorded:
    """A storage root of an earlier version, and what that version made of every scan."""

    root: Path
    rig_file: Path
    expected: dict[str, Any]


@pytest.fixture(scope="module", params=VERSIONS)
def recorded(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """Unpacked once; read only."""
    folder = tmp_path_factory.mktemp("recordings")
    with tarfile.open(RECORDINGS / f"{request.param}.tar.xz") as packed:
        packed.extractall(folder, filter="data")
    return Recorded(folder / "root", folder / "rig.toml", json.loads((folder / "expected.json").read_text()))


def test_every_scan_is_listed_whole_and_says_what_it_said(recorded: Recorded) -> None:
    library = Library(recorded.root)
    kept, rejected = library.entries(), library.entries(LibraryFolder.REJECTED)
    assert [entry.scan_id for entry in kept] == ["000001", "000002", "000004", "000005", "000006", "000007"]
    assert [entry.scan_id for entry in rejected] == ["000003"]
    for listed in (*kept, *rejected):
        entry = library.verify(listed.scan_id)
        assert entry.manifest is not None
        assert (entry.problems, entry.manifest.stage is Stage.RAW) == ((), entry.manifest.recovered)
        record = entry.manifest.record
        assert record.software_version == recorded.expected["version"]
        assert (record.exposure is not None and record.exposure.time_us, record.wall_time is None) == (12_000, False)
        assert record.sequence.period_px == (16 if entry.scan_id in ("000006", "000007") else 32)
        frames = library.load(entry.scan_id).frames["right"]
        assert frames.shape == (len(record.sequence.patterns), HEIGHT_PX, WIDTH_PX)
    # Neither a step of a calibration nor a recovered scan has a cloud.
    for name in ("000001", "000002", "000005", "000006"):
        cloud = library.load(name).cloud()
        assert cloud is not None
        assert len(cloud.points_mm) == recorded.expected["scans"][f"scans/{name}"]["points"]
        assert 380.0 < float(np.median(cloud.points_mm[:, 2])) < 680.0
    scan = library.load("000002")
    assert scan.second is not None, "two exposures are still one scan"
    assert not np.array_equal(scan.second["left"], scan.frames["left"])


def test_calibrations_of_every_model_are_read_and_are_the_same_ones(recorded: Recorded) -> None:
    folder = recorded.root / "calibration"
    files = [path for path in (*folder.glob("*.json"), *folder.glob("kept/*.json")) if path.name != "beams.json"]
    found = {path: load_calibration(path) for path in files}
    for path, one in found.items():
        assert (one.rig_serial, one.rig.left.width_px, one.rig.left.height_px) == ("KF-SIM", WIDTH_PX, HEIGHT_PX)
        assert one.hash == json.loads(path.read_text(encoding="utf-8"))["sha256"], "scans name it by this"
    models = {(one.rig.left.correction is not None, one.rig.left.ray_shift is not None) for one in found.values()}
    assert models == {(False, False), (True, False), (False, True)}
    assert found[folder / "air.json"].air_covariance is not None


def test_an_archive_gives_the_scans_back_byte_for_byte(recorded: Recorded, tmp_path: Path) -> None:
    archive = recorded.root.parent / "archive"
    assert main(["archive", "unpack", str(archive), "--out", str(tmp_path / "root")]) == 0
    for name in ("000001", "000002"):
        scan, again = ((root / "scans" / name).iterdir() for root in (recorded.root, tmp_path / "root"))
        assert {path.name: path.read_bytes() for path in scan} == {path.name: path.read_bytes() for path in again}


def test_the_instrument_starts_with_what_was_in_use_and_recovers_what_was_not_decided(
    recorded: Recorded, tmp_path: Path
) -> None:
    root = shutil.copytree(recorded.root, tmp_path / "root")
    rig = load_rig(recorded.rig_file)
    rig = replace(rig, storage=replace(rig.storage, root=root))
    calibration = root / "calibration"
    assert Instrument(rig).calibration() == (load_calibration(calibration / "current.json"), ())
    assert start_of(rig) == load_calibration(calibration / "air.json")
    session = Calibrations(root, rig.rig.serial).session()
    assert [(check.step, check.scan_id) for check in session.trials] == [(Step.M3, "000004")]
    chosen, fault = ChoicesFile(root, standard_choices(rig)).read()
    assert (chosen.period_px, fault) == (16, None)
    for path in (calibration / "kept").glob("000[12]*.json"):
        assert HealthFile(root, load_calibration(path).hash).read().points
    pointers = pointers_of(rig)
    assert pointers is not None
    known = json.loads((calibration / "beams.json").read_text(encoding="utf-8"))["calibration"]
    assert BeamsFile(root, pointers).read(known) != pointers.beams(), "what the dots taught is not lost"
    (name,) = objects.object_names(root)
    stored = objects.read_object(root, name)
    assert [scan.name for scan in stored.scans] == ["000001", "000006"]
    assert errors_of(stored) is not None

    library = Library(root)
    outcome = library.recover()
    assert (outcome.recovered, outcome.set_aside, outcome.failed) == (("000008",), (), ())
    assert (library.verify("000008").ok, library.load("000008").manifest.recovered) == (True, True)
