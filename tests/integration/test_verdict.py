"""A dive on which images lie although every device says that all is well: what is wrong is named, and the next scan works."""

from __future__ import annotations

import pytest

from appliance.cli.simrig import SimOptions, default_sim_rig, simulated
from appliance.config import load_rig
from appliance.scan.verdict import Verdict
from appliance.service.app import run
from appliance.storage.library import Library, LibraryFolder

pytestmark = pytest.mark.dive

DIVE = """
wait state AIM 90
fault camera.right stuck frame=7
press scan
wait alert CAMERA_STUCK 90
wait state AIM 30
clear
pause 2
fault projector wrong
press scan
wait alert PROJECTOR_TIMING 90
wait state AIM 30
clear
pause 1
press scan
wait state REVIEW 90
pause 3
press scan
wait state AIM 60
motion velocity_mm_s=2,0,10 tremor_mm=0.1,0.1,0.1
press scan
wait alert COMPENSATED 90
press scan
wait state AIM 60
motion velocity_mm_s=30,0,0 tremor_mm=1,1,1 tremor_hz=15
press scan
wait alert MOVED 90
press scan
wait state AIM 60
end
"""


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Library:
    """After the dive."""
    folder = tmp_path_factory.mktemp("dive")
    script = folder / "dive.script"
    script.write_text(DIVE)
    options = SimOptions(
        root=folder / "root", object_name="pipe", truth="nominal", seed=4, size="400x300", script=script
    )
    rig = simulated(load_rig(default_sim_rig()), options)
    assert run(rig) == 0
    return Library(rig.storage.root)


def verdicts(library: Library, shelf: LibraryFolder) -> list[dict[str, Verdict]]:
    manifests = [entry.manifest for entry in library.entries(shelf)]
    return [{one.name: one for one in manifest.record.verdicts} for manifest in manifests if manifest is not None]


def test_images_that_lie_become_no_cloud_and_say_why(library: Library) -> None:
    stuck, late = verdicts(library, LibraryFolder.REJECTED)
    assert (stuck["ledger"].passed, stuck["identity"].passed) == (True, False), "only the images can tell"
    assert stuck["identity"].text.startswith("CAMERA_STUCK")
    assert "camera.right" in stuck["identity"].text
    assert stuck["identity"].numbers["frame"] in (6, 7), (
        "the image that stays is the last good one or the first bad one"
    )
    assert (late["ledger"].passed, late["identity"].passed) == (True, False)
    assert late["identity"].text.startswith("PROJECTOR_TIMING")


def test_a_good_scan_carries_every_judgement_with_its_numbers(library: Library) -> None:
    kept, *_ = verdicts(library, LibraryFolder.SCANS)
    assert {"ledger", "identity", "light", "water", "motion"} <= set(kept)
    assert all(verdict.passed is not False for verdict in kept.values()), kept
    assert kept["identity"].numbers["doubt"] is not None
    assert kept["identity"].numbers["doubt"] < 1.0
    veil = kept["water"].numbers["veil_percent"]
    assert veil is not None
    assert 0.0 <= veil < 10.0


def test_a_moved_scan_is_put_right_or_said_to_be_wrong_and_the_manifest_says_which(library: Library) -> None:
    _, corrected, wrong = verdicts(library, LibraryFolder.SCANS)
    assert (corrected["motion"].passed, corrected["compensation"].passed) == (False, True)
    speeds = [corrected["compensation"].numbers[f"speed_{axis}_mm_s"] for axis in "xyz"]
    assert speeds[2] == pytest.approx(-10.0, abs=3.0), "the scene comes nearer as the instrument goes on"
    assert (wrong["motion"].passed, wrong["compensation"].passed) == (False, False)
    added = wrong["motion"].numbers["added_noise_percent"]
    assert added is not None
    assert added > 50.0
    assert wrong["compensation"].text, "and why it stays as it is"
