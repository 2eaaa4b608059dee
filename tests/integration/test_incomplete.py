"""A camera that is lost while the second direction is recorded: what was recorded before is kept apart, where the rig asks for it, and
makes a cloud at the desk that says that nothing has checked it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.cli.simrig import SimOptions, default_sim_rig, simulated
from appliance.config import load_rig
from appliance.scan.sides import SIDES
from appliance.service.app import run
from appliance.storage import incomplete
from appliance.storage.library import Library, LibraryFolder
from appliance.storage.ply import read_ply
from tests.support.commands import kingfisher

pytestmark = pytest.mark.dive

DIVE = """
wait state AIM 90
fault camera.left off frame=9
press scan
wait action LEFT CAM LOST: REPEAT 20
clear
wait device camera.left ok 20
fault camera.right off frame=18
press scan
wait action RIGHT CAM LOST: REPEAT 20
clear
wait device camera.right ok 20
press scan
wait state REVIEW 60
press scan
wait scans 1 30
end
"""


@pytest.fixture(scope="module", params=[False, True], ids=["as usual", "when asked"])
def root(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, bool]:
    """The storage root after a dive in which two scans broke, and whether what they left was to be kept."""
    folder = tmp_path_factory.mktemp("dive")
    (folder / "dive.script").write_text(DIVE)
    options = SimOptions(
        root=folder / "root",
        object_name="frustum",
        truth="nominal",
        seed=4,
        size="400x300",
        script=folder / "dive.script",
    )
    rig = simulated(load_rig(default_sim_rig()), options)
    keeping: bool = request.param
    assert run(replace(rig, storage=replace(rig.storage, keep_incomplete=keeping))) == 0
    return folder / "root", keeping


def test_nothing_is_kept_unasked_and_what_is_kept_is_no_scan(root: tuple[Path, bool], tmp_path: Path) -> None:
    place, keeping = root
    library = Library(place)
    assert library.count() == 1
    assert [entry.ok for entry in library.entries()] == [True]
    assert [library.entries(shelf) for shelf in LibraryFolder if shelf is not LibraryFolder.SCANS] == [[], [], []]
    folders = sorted(path.name for path in (place / incomplete.FOLDER).glob("*")) if keeping else []
    # The first scan broke in its first direction: nothing can be made of that.
    assert folders == (["000001"] if keeping else [])
    assert (place / incomplete.FOLDER).exists() == keeping
    if not keeping:
        return
    recording = incomplete.load(place / incomplete.FOLDER / "000001")
    frames = recording.scan.frames
    assert 14 <= len(frames["left"]) == len(frames["right"]) <= 18
    assert recording.scan.manifest.reason.startswith("CAMERA_LOST: ")
    assert recording.missing[-1] == "sine-y-270"
    assert len(recording.missing) == 24 - len(frames["left"])
    for side in SIDES:
        bright, dark = frames[side][:2]
        assert np.median(bright) > 60 > 30 > np.median(dark)
    out = tmp_path / "rescued.ply"
    said = kingfisher("rescue", "1", "--root", place, "--out", out, "--json")
    assert said.code == 0, said.err
    report = said.document
    assert "CAMERA_LOST" in report["unchecked"]
    cloud = read_ply(out)
    assert cloud.unchecked == report["unchecked"]
    assert cloud.salvaged is None
    assert len(cloud.points_mm) == report["points"]
    whole = library.load(library.ids()[0]).cloud()
    assert whole is not None
    assert whole.unchecked is None
    # Taken a moment before from the same place, as steady as a simulated hand is.
    assert len(cloud.points_mm) > 0.95 * len(whole.points_mm)
    assert np.median(cloud.points_mm[:, 2]) == pytest.approx(np.median(whole.points_mm[:, 2]), abs=1.0)
    assert np.isnan(cloud.ray_gap_mm).all()
