"""A file of the cameras' noise comes back as it was written, is used where it belongs, and goes with every scan."""

from __future__ import annotations

import json
import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from appliance.calibration.noise_file import CameraFigures, NoiseFileError, StoredNoise, decode, encode, load
from appliance.checksummed_file import with_checksum
from appliance.config import Rig, load_rig, parse_rig
from appliance.instrument import NOISE_FILE, design_of, exposures_of, noise_of, origin_of, with_measured_noise
from appliance.scan.exposure import Exposure
from tests.appliance.cli.test_measure import RIG

LEFT, RIGHT = CameraFigures("KF-CAM-L", 9_100.0, 4.5, 6.0), CameraFigures("KF-CAM-R", 18_000.0, 25.0, 1.5)
STORED = StoredNoise("KF-SIM", ("000007",), LEFT, RIGHT)


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    rig = load_rig(RIG)
    return replace(rig, storage=replace(rig.storage, root=tmp_path))


def put(rig: Rig, stored: StoredNoise) -> None:
    path = rig.storage.root / NOISE_FILE
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(encode(stored))


def of(rig: Rig) -> StoredNoise:
    cameras = rig.camera
    return replace(
        STORED,
        rig_serial=rig.rig.serial,
        left=replace(LEFT, serial=cameras.left.serial),
        right=replace(RIGHT, serial=cameras.right.serial),
    )


def test_it_comes_back_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "noise.json"
    assert load(path) is None
    path.write_bytes(encode(STORED))
    assert load(path) == STORED


def changed(side: str, **values: Any) -> bytes:
    content = json.loads(encode(STORED))
    content.pop("sha256")
    content["cameras"][side] |= values
    return with_checksum(content)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (encode(STORED).replace(b"9100.0", b"9200.0"), "checksum"),
        (encode(STORED)[:40], "not readable as JSON"),
        (with_checksum({"schema": 2}), "schema 2; this version reads schema 1"),
        (with_checksum({"schema": 1, "rig_serial": "KF-1", "made_from": []}), "cameras is missing"),
        (
            with_checksum({"schema": 1, "rig_serial": "KF-1", "made_from": [], "cameras": {}}),
            "cameras.left or its serial",
        ),
        (changed("right", full_well_e=400.0), "cameras.right.full_well_e is 400.0; allowed are 500..900000"),
        (changed("left", read_noise_e="4"), "cameras.left.read_noise_e is '4'; allowed are 0..900"),
        (changed("left", black_level_dn=True), "cameras.left.black_level_dn is True; allowed are 0..63"),
    ],
)
def test_what_is_no_noise_is_refused_with_a_remedy(data: bytes, said: str) -> None:
    with pytest.raises(NoiseFileError, match=r"^here: .*measure") as refused:
        decode(data, "here")
    assert said in str(refused.value)


def test_what_was_measured_takes_the_place_of_the_data_sheets_and_goes_with_the_scans(rig: Rig) -> None:
    put(rig, of(rig))
    used = with_measured_noise(rig)
    for gain_db in (0.0, 6.0):
        noise = noise_of(used, Exposure(8_000, gain_db))
        # At 0 dB and grey value g over black: read noise and photons in electrons, and rounding.
        for camera, figures in ((noise.left, LEFT), (noise.right, RIGHT)):
            per_e = 255.0 / figures.full_well_e * 10.0 ** (gain_db / 20.0)
            expected = (figures.read_noise_e * per_e) ** 2 + 100.0 * per_e + 1.0 / 12.0
            assert camera.variance_dn2(100.0 + figures.black_level_dn) == pytest.approx(expected)
    carried = parse_rig(origin_of(used, design_of(used)).rig.decode(), "the scan's")
    assert noise_of(carried) == noise_of(used)
    assert exposures_of(used) == exposures_of(rig), "and nothing else is changed"
    assert replace(used, camera=rig.camera) == rig


def test_of_other_cameras_or_damaged_it_is_not_used_and_the_log_says_so(
    rig: Rig, caplog: pytest.LogCaptureFixture
) -> None:
    assert with_measured_noise(rig) == rig
    mine = of(rig)
    with caplog.at_level(logging.WARNING, "kingfisher"):
        for other in (
            replace(mine, rig_serial="KF-9"),
            replace(mine, left=replace(mine.left, serial="KF-CAM-X")),
            replace(mine, right=replace(mine.right, serial="KF-CAM-X")),
        ):
            put(rig, other)
            assert with_measured_noise(rig) == rig
        (rig.storage.root / NOISE_FILE).write_bytes(b"{}")
        assert with_measured_noise(rig) == rig
    assert len(caplog.records) == 4
    assert all("the data sheets' noise is believed" in record.getMessage() for record in caplog.records)
