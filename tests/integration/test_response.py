"""A plane is scanned, the projector's response measured in it, and after the next start the same plane's fringes are pure."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from appliance.calibration.response.file import encode
from appliance.cli.simrig import SimOptions, default_sim_rig, simulated
from appliance.config import Rig, load_rig
from appliance.config.rig import ScanRig
from appliance.instrument import RESPONSE_FILE
from appliance.offline.measuring import response_of_scan
from appliance.service.app import run
from appliance.storage.atomic import replace_file
from appliance.storage.filesystem import LocalFileSystem
from appliance.storage.library import Library

DIVE = """
wait state AIM 90
press scan
wait state REVIEW 60
pause 1
press scan
wait state AIM 60
end
"""


def dive(rig: Rig) -> Path:
    """One scan, kept; its folder."""
    assert run(rig) == 0
    library = Library(rig.storage.root)
    last = library.last_id()
    assert last is not None
    return library.entry(last).folder


def test_a_response_measured_under_water_is_used_from_the_next_start_on(tmp_path: Path) -> None:
    script = tmp_path / "dive.script"
    script.write_text(DIVE)
    options = SimOptions(root=tmp_path / "dive", object_name="plane", truth="nominal", size="400x300", script=script)
    rig = replace(simulated(load_rig(default_sim_rig()), options), scan=ScanRig(64))

    before = dive(rig)
    stored, bent = response_of_scan(rig, before, lambda what, part: None)
    path = rig.storage.root / RESPONSE_FILE
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_file(LocalFileSystem(), path, encode(stored))
    after = dive(rig)
    _, straight = response_of_scan(rig, after, lambda what, part: None)

    assert bent.phase_error_rad > 0.03
    assert straight.phase_error_rad < bent.phase_error_rad / 3.0
    library = Library(rig.storage.root)
    hashes = [library.load(folder.name).manifest.record.response_hash for folder in (before, after)]
    assert hashes == [None, stored.response.hash]
