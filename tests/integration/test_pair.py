"""White labels on black rubber: the diver adds a second exposure with one key, moves meanwhile, and loses nothing by it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from appliance.cli.simrig import SimOptions, default_sim_rig, simulated
from appliance.config import Rig, load_rig
from appliance.offline.origin import calibration_for, open_source
from appliance.offline.reconstruct import reconstruct_scan
from appliance.offline.wish import Wish
from appliance.scan.verdict import Verdict
from appliance.service.app import run
from appliance.storage.library import Library, LibraryFolder
from appliance.storage.ply import read_ply
from appliance.storage.scan import StoredScan

pytestmark = pytest.mark.long

DIVE = """
wait state AIM 90
press scan
wait label down HOLD:* 120
press down 1.2
wait label down None 10
wait label up TURN 120
press scan
wait scans 1 60
wait state AIM 60
press scan
wait label down HOLD:* 120
fault camera.left off
press down 1.2
wait alert CAMERA_LOST 60
clear
wait state REVIEW 30
wait label down HOLD:* 60
press scan
wait scans 2 60
wait state AIM 60
wait gone CAMERA_LOST 60
press scan
wait label down HOLD:* 120
object frustum 30 0 520 0 9 0
press down 1.2
wait alert MOVED 90
wait state REVIEW 30
press scan
wait scans 3 60
end
"""


@pytest.fixture(scope="module")
def dive(tmp_path_factory: pytest.TempPathFactory) -> Rig:
    """The instrument's rig, after the dive."""
    folder = tmp_path_factory.mktemp("dive")
    script = folder / "dive.script"
    script.write_text(DIVE)
    options = SimOptions(
        root=folder / "root", object_name="frustum", texture="labels", truth="nominal", seed=4, size="400x300",
        script=script,
    )  # fmt: skip
    rig = simulated(load_rig(default_sim_rig()), options)
    assert run(rig) == 0
    return rig


@pytest.fixture(scope="module")
def scans(dive: Rig) -> list[StoredScan]:
    library = Library(dive.storage.root)
    assert [entry.ok for entry in library.entries()] == [True] * 3
    assert library.entries(LibraryFolder.REJECTED) == []
    return [library.load(entry.scan_id) for entry in library.entries()]


def verdicts(scan: StoredScan) -> dict[str, Verdict]:
    return {one.name: one for one in scan.manifest.record.verdicts}


def test_the_pair_is_one_scan_with_both_exposures_ledgers_and_verdicts(scans: list[StoredScan]) -> None:
    record = scans[0].manifest.record
    second = record.second
    assert second is not None
    assert record.exposure is not None
    assert second.exposure.light != record.exposure.light
    assert len(second.ledger["flips"]) == len(record.ledger["flips"]) == len(record.sequence.patterns)
    assert second.ledger["flips"] != record.ledger["flips"]
    assert {"ledger", "identity", "light", "water", "motion"} <= {one.name for one in second.verdicts}
    pair = verdicts(scans[0])["pair"]
    assert pair.passed
    first_points, points = pair.numbers["first_points"], pair.numbers["points"]
    assert first_points is not None
    assert points is not None
    assert points > 1.05 * first_points, "what the first could not show is there"
    assert points == record.cloud["points"]
    assert scans[0].second is not None
    assert scans[0].second["left"].shape == scans[0].frames["left"].shape


def test_the_desk_makes_the_same_points_of_it(dive: Rig, scans: list[StoredScan], tmp_path: Path) -> None:
    out = tmp_path / "again.ply"
    source = open_source(scans[0].folder, Wish())
    report = reconstruct_scan(source, calibration_for(source, Wish()), out, lambda what: None)
    assert source.rig == dive
    stored = scans[0].cloud()
    assert stored is not None
    np.testing.assert_array_equal(read_ply(out).points_mm, stored.points_mm)
    np.testing.assert_array_equal(read_ply(out).sigma_mm, stored.sigma_mm)
    assert "then" in report["exposure"]


@pytest.mark.parametrize("which", [1, 2], ids=["a camera is lost in it", "the instrument moves before it"])
def test_when_nothing_comes_of_the_second_exposure_the_first_one_is_whole(scans: list[StoredScan], which: int) -> None:
    scan = scans[which]
    assert scan.second is None
    assert scan.manifest.record.second is None
    assert "pair" not in verdicts(scan)
    cloud = scan.cloud()
    assert cloud is not None
    assert len(cloud.points_mm) == scan.manifest.record.cloud["points"]
