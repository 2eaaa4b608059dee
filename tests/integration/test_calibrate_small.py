"""Small pictures: recordings that are refused by name, one that will do, and where each of them lies afterwards."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from appliance.calibration.guide import Refusal, Step
from appliance.cli.simrig import SimOptions, default_sim_rig, simulated
from appliance.config import load_rig
from appliance.service.app import run
from appliance.storage.calibrations import Calibrations
from appliance.storage.library import Library, LibraryFolder

DIVE = """
wait state AIM 90
press up                    # the menu
press down
press down
press down
press scan
wait step M1 10
press scan                  # a plane: no ball bar
wait result NOT_FOUND 60
press down
press down
wait step M3 10
press scan
wait result FITS 60
wait step M1 10             # the first that is not done
press down
press down
wait step M3 10
object plane 0 0 570 8 -10 0
press scan                  # too far; the one of before stays
wait result TOO_FAR 60
press back
wait state AIM 10
pause 0.5
end
"""


@pytest.mark.dive
def test_recordings_are_refused_and_accepted_with_words(tmp_path: Path) -> None:
    script = tmp_path / "dive.script"
    script.write_text(DIVE)
    options = SimOptions(
        root=tmp_path / "dive", object_name="plane", texture="none", truth="nominal", seed=3, size="400x300",
        script=script,
    )  # fmt: skip
    rig = simulated(load_rig(default_sim_rig()), options)
    pose = (0.0, 0.0, 478.0, 8.0, -10.0, 0.0)
    rig = replace(rig, rig=replace(rig.rig, wires_options={**rig.rig.wires_options, "object_pose": list(pose)}))

    assert run(rig) == 0

    session = Calibrations(rig.storage.root, rig.rig.serial).session()
    assert [check.step for check in session.trials] == [Step.M3]
    library = Library(rig.storage.root)
    (kept,) = library.entries()
    assert kept.scan_id == session.trials[0].scan_id
    assert kept.ok
    assert kept.manifest is not None
    verdict = next(v for v in kept.manifest.record.verdicts if v.name == "calibration")
    assert verdict.text.startswith("M3: plane 478 mm away")
    reasons = [e.manifest.reason for e in library.entries(LibraryFolder.REJECTED) if e.manifest is not None]
    assert [reason.split(": ")[1] for reason in reasons] == [Refusal.NOT_FOUND.value, Refusal.TOO_FAR.value]
