"""A dive before a pipe: cameras are lost, images lie, hands shake. What is wrong is named, the next scan works, and it lies on the pipe."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.instrument.service.app import run
from appliance.measure.light.sides import SIDES
from appliance.measure.verdict import Verdict
from appliance.store import incomplete
from appliance.store.config import Rig
from appliance.store.incomplete import IncompleteRecording
from appliance.store.library import Library, LibraryFolder
from tests.integration.dived import calibrate_exactly, instrument, off_surface_mm
from tests.support.commands import Shell

DIVE = """
wait state AIM 90
fault camera.left off frame=9                      # in the first direction: nothing can be made of that
press scan
wait headline SCAN FAILED 20
wait action LEFT CAM LOST: REPEAT 20
wait label scan REPEAT 1
clear
wait device camera.left ok 20
fault camera.right off frame=18                    # in the second
press scan
wait action RIGHT CAM LOST: REPEAT 20
clear
wait device camera.right ok 20
press scan
wait state REVIEW 90
pause 3
press scan
wait scans 1 60
wait state AIM 60
fault camera.right stuck frame=7                   # the same image again and again, with running numbers
press scan
wait headline RIGHT CAM STUCK 90
wait state AIM 30
clear
pause 2
fault projector wrong                              # everything one frame later than it says
press scan
wait headline PROJECTOR TIMING 90
wait state AIM 30
clear
pause 1
motion velocity_mm_s=2,0,25 tremor_mm=0.1,0.1,0.1
press scan
wait alert COMPENSATED 90
press scan
wait scans 2 60
wait state AIM 60
motion velocity_mm_s=30,0,0 tremor_mm=1,1,1 tremor_hz=15
press scan
wait headline MOVED * px 90
wait action REPEAT 1
press scan
wait scans 3 60
wait state AIM 60
end
"""


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Rig:
    """The instrument after the dive; it was to keep what is left of broken scans."""
    rig = instrument(tmp_path_factory.mktemp("dive"), DIVE, object_name="pipe", truth="modelled", seed=11)
    calibrate_exactly(rig)
    rig = replace(rig, storage=replace(rig.storage, keep_incomplete=True))
    assert run(rig) == 0
    return rig


@pytest.fixture(scope="module")
def library(rig: Rig) -> Library:
    return Library(rig.storage.root)


def verdicts(library: Library, shelf: LibraryFolder) -> list[dict[str, Verdict]]:
    manifests = [entry.manifest for entry in library.entries(shelf)]
    return [{one.name: one for one in manifest.record.verdicts} for manifest in manifests if manifest is not None]


def test_what_was_kept_is_whole_lies_on_the_pipe_and_is_the_same_at_the_desk(
    rig: Rig, library: Library, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = library.ids()[0]
    assert [library.verify(scan).ok for scan in library.ids()] == [True] * 3
    assert library.entries(LibraryFolder.SET_ASIDE) == []
    off_mm = off_surface_mm(rig, kept)
    assert len(off_mm) > 40_000
    assert np.sqrt(np.mean(off_mm**2)) < 0.06
    assert set(library.load(kept).manifest.record.stage_times_s) >= {"recording", "coarse", "full", "saved"}
    said = Shell(capsys)("cloud", kept, "--root", library.root, "--out", tmp_path / "again.ply", "--json")
    assert said.document["stored_cloud"] == "the same, byte for byte"


def test_images_that_lie_become_no_cloud_and_say_why(library: Library) -> None:
    stuck, late = verdicts(library, LibraryFolder.REJECTED)
    assert (stuck["ledger"].passed, stuck["identity"].passed) == (True, False), "only the images can tell"
    assert stuck["identity"].text.startswith("CAMERA_STUCK")
    assert "camera.right" in stuck["identity"].text
    assert stuck["identity"].numbers["frame"] in (6, 7), "the last good image or the first bad one"
    assert (late["ledger"].passed, late["identity"].passed) == (True, False)
    assert late["identity"].text.startswith("PROJECTOR_TIMING")


def test_a_good_scan_carries_every_judgement_with_its_numbers(library: Library) -> None:
    kept, *_ = verdicts(library, LibraryFolder.SCANS)
    assert {"ledger", "identity", "light", "water", "motion"} <= set(kept)
    assert all(verdict.passed is not False for verdict in kept.values()), kept
    assert 0.0 <= (kept["identity"].numbers["doubt"] or np.nan) < 1.0
    assert 0.0 <= (kept["water"].numbers["veil_percent"] or 0.0) < 10.0


def test_a_moved_scan_is_put_right_or_said_to_be_wrong_and_the_manifest_says_which(library: Library) -> None:
    _, corrected, wrong = verdicts(library, LibraryFolder.SCANS)
    assert (corrected["motion"].passed, corrected["compensation"].passed) == (False, True)
    speeds = [corrected["compensation"].numbers[f"speed_{axis}_mm_s"] for axis in "xyz"]
    assert speeds[2] == pytest.approx(-25.0, abs=4.0), "the scene comes nearer as the instrument goes on"
    assert (wrong["motion"].passed, wrong["compensation"].passed) == (False, False)
    assert (wrong["motion"].numbers["added_noise_percent"] or 0.0) > 50.0
    assert wrong["compensation"].text, "and why it stays as it is"


def test_what_is_left_of_a_scan_that_broke_in_its_second_direction_is_kept_apart_and_rescued_unchecked(
    library: Library, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its points are those of a whole scan: ``tests/appliance/desk/test_rescue.py``."""
    (folder,) = (library.root / incomplete.INCOMPLETE_FOLDER).iterdir()
    recording = IncompleteRecording.load(folder)
    frames = recording.scan.frames
    assert 14 <= len(frames["left"]) == len(frames["right"]) == 24 - len(recording.missing) <= 18
    assert recording.scan.manifest.reason.startswith("CAMERA_LOST: ")
    for bright, dark in (frames[side][:2] for side in SIDES):
        assert np.percentile(bright, 90) > 60 > 30 > np.percentile(dark, 90)
    said = Shell(capsys)(
        "cloud", f"incomplete:{folder.name}", "--root", library.root, "--out", tmp_path / "rescued.ply", "--json"
    )
    assert said.code == 0, said.err
    assert "CAMERA_LOST" in said.document["unchecked"]
    # Taken a moment before a whole one from the same place, as steady as a simulated hand is.
    whole = library.load(library.ids()[0]).manifest.record.cloud["points"]
    assert said.document["points"] > 0.95 * (whole or 0.0) > 0.0
