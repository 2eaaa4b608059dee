"""A plane is scanned, projector's response and cameras' noise are measured in it, and used from the next start on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from appliance.base import silent
from appliance.desk.measuring import noise_of_scan, noise_to_store, response_of_scan
from appliance.instrument.service.app import run
from appliance.measure.calibration.noise_file import NOISE
from appliance.measure.calibration.response_file import RESPONSE
from appliance.store.config import Rig, load_rig
from appliance.store.config.rig import ScanRig
from appliance.store.instrument import Instrument
from appliance.store.library import Library
from tests.integration.dived import instrument

CAMERAS = {"seed": 10_003, "families": ["cameras"]}
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
    """Return the folder of the one scan that is taken and kept."""
    assert run(rig) == 0
    library = Library(rig.storage.root)
    return library.entry(library.ids()[-1]).folder


def test_response_and_noise_measured_under_water_are_used_from_the_next_start_on(tmp_path: Path) -> None:
    rig = replace(instrument(tmp_path, DIVE, object_name="plane", truth="nominal"), scan=ScanRig(64))
    # Cameras of another make than the rig file's data sheets: 18,300 instead of 13,000 electrons.
    rig = replace(rig, rig=replace(rig.rig, wires_options={**rig.rig.wires_options, "outside": CAMERAS}))
    before = dive(rig)
    found = noise_of_scan(rig, before)
    (Instrument(rig).noise_file).parent.mkdir(parents=True, exist_ok=True)
    (Instrument(rig).noise_file).write_bytes(NOISE.encode(noise_to_store(rig, before, found)))
    stored, bent = response_of_scan(rig, before, silent)
    (Instrument(rig).response_file).write_bytes(RESPONSE.encode(stored))
    after = dive(rig)
    _, straight = response_of_scan(rig, after, silent)

    assert bent.phase_error_rad > 0.03
    assert straight.phase_error_rad < bent.phase_error_rad / 3.0
    library = Library(rig.storage.root)
    hashes = [library.load(folder.name).manifest.record.response_hash for folder in (before, after)]
    assert hashes == [None, stored.response.hash]
    # Each scan carries what it was taken with: the data sheets' noise, then the measured one.
    for folder, expects in ((before, 13_000.0), (after, found["left"][0].full_well_e)):
        assert load_rig(folder / "rig.toml").camera.left.full_well_e == pytest.approx(expects)
    for measured, expected in noise_of_scan(load_rig(after / "rig.toml"), after).values():
        light_dn, variance_dn2 = measured.variance_at_dn2
        assert expected.variance_dn2(light_dn) == pytest.approx(variance_dn2, rel=0.08)
    for measured, data_sheet in found.values():
        light_dn, variance_dn2 = measured.variance_at_dn2
        assert data_sheet.variance_dn2(light_dn) > 1.2 * variance_dn2
