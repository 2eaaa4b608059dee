"""Files of calibrations, noise and responses come back as they were written, say what is wrong otherwise, and count where they belong."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from appliance.base.sealed_file import ContentError
from appliance.calibrate.projector_response import CameraImages, ResponseError, measure_response
from appliance.measure.calibration.depth_error import DEPTH_ERROR_TERMS
from appliance.measure.calibration.design import design_calibration
from appliance.measure.calibration.field import AirField
from appliance.measure.calibration.file import Calibration, CalibrationError, decode_calibration, encode_calibration
from appliance.measure.calibration.noise_file import NOISE as NOISE_SEAL
from appliance.measure.calibration.noise_file import BothFigures, CameraFigures, StoredNoise
from appliance.measure.calibration.response_file import RESPONSE as RESPONSE_SEAL
from appliance.measure.calibration.response_file import StoredResponse
from appliance.measure.light.correction import ImageCorrection
from appliance.measure.light.exposure import Exposure
from appliance.measure.light.patterns import build_sequence
from appliance.measure.light.ray_shift import RayShift
from appliance.measure.light.volume import WorkingVolume
from appliance.store.config import Rig, load_rig, parse_rig
from appliance.store.instrument import NOISE_FILE, RESPONSE_FILE, Instrument, load_calibration
from tests.appliance.cli.test_measure import RIG
from tests.support.calibrating import DESIGN
from tests.support.golden_texts import Says
from tests.support.sealing import sealed
from tests.support.truth import WATER

calibration_file = SimpleNamespace(encode=encode_calibration, decode=decode_calibration)

CALIBRATION = design_calibration(DESIGN, "KF-0001", 1600, 1200, WATER)
LEFT, RIGHT = CameraFigures("KF-CAM-L", 9_100.0, 4.5, 6.0), CameraFigures("KF-CAM-R", 18_000.0, 25.0, 1.5)
NOISE = StoredNoise("KF-SIM", ("000007",), BothFigures(LEFT, RIGHT))
RESPONSE = StoredResponse("KF-1", ("000007",), 0.0107, (0.45, 0.53, 0.05, -0.02))


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    rig = load_rig(RIG)
    return replace(rig, storage=replace(rig.storage, root=tmp_path))


def left_with(**changes: Any) -> Calibration:
    left = replace(CALIBRATION.rig.left, **changes)
    return replace(CALIBRATION, rig=replace(CALIBRATION.rig, left=left))


def depth_errors() -> tuple[tuple[float, ...], ...]:
    half = np.random.default_rng(4).normal(0.0, 0.01, (DEPTH_ERROR_TERMS, DEPTH_ERROR_TERMS))
    rows = half @ half.T + 1e-6 * np.eye(DEPTH_ERROR_TERMS)
    return tuple(tuple(row) for row in (0.5 * (rows + rows.T)).tolist())


CORRECTION = ImageCorrection(1600, 1200, (6, 5), tuple(np.random.default_rng(1).normal(0.0, 0.2, 144)))
SHIFT = RayShift(1600, 1200, (4, 3), tuple(np.random.default_rng(1).normal(0.0, 0.01, 84)))
STATED = replace(CALIBRATION, depth_error_mm2=depth_errors())
FIELDED = replace(CALIBRATION, air_field=AirField.of((2, 1), np.zeros(102), np.eye(102)))
SMALL = replace(CALIBRATION, rig=replace(CALIBRATION.rig, volume=WorkingVolume(264.0, 300.0, 336.0)))


@pytest.mark.parametrize(
    ("module", "load", "stored"),
    [
        *((calibration_file, load_calibration, one) for one in (CALIBRATION, left_with(ray_shift=SHIFT), left_with(lens_in_water=True), left_with(correction=CORRECTION), STATED, SMALL, FIELDED)),
        (NOISE_SEAL, NOISE_SEAL.load, NOISE), (RESPONSE_SEAL, RESPONSE_SEAL.load, RESPONSE),
        (RESPONSE_SEAL, RESPONSE_SEAL.load, replace(RESPONSE, exposure_us=12_000, trigger_delay_us=500)),
    ],
)  # fmt: skip
def test_what_was_written_comes_back(module: Any, load: Callable[[Path], Any], stored: Any, tmp_path: Path) -> None:
    path = tmp_path / "stored.json"
    path.write_bytes(module.encode(stored))
    assert load(path) == stored
    for optional in ("depth_error_mm2", "air_field", "exposure_us"):
        assert (optional.encode() in module.encode(stored)) == (getattr(stored, optional, None) is not None)
    if module is calibration_file:
        assert load(path).hash == stored.hash
        assert (stored.hash == CALIBRATION.hash) == (stored == CALIBRATION)


def resigned(module: Any, stored: Any, change: Callable[[Any], object]) -> bytes:
    """A file with another content and the checksum that fits it."""
    content = {key: value for key, value in json.loads(module.encode(stored)).items() if key != "sha256"}
    change(content)
    return sealed(content)


def response(**changes: object) -> bytes:
    return resigned(RESPONSE_SEAL, RESPONSE, lambda content: content.update(changes))


def noise(side: str, **values: object) -> bytes:
    return resigned(NOISE_SEAL, NOISE, lambda content: content["cameras"][side].update(values))


def calibration(**changes: object) -> bytes:
    return resigned(calibration_file, CALIBRATION, lambda content: content.update(changes))


BARE = {"schema": 1, "rig_serial": "KF-1", "made_from": []}
THICK = left_with(port=replace(CALIBRATION.rig.left.port, thickness_mm=500.0))
TURNED = left_with(rotation=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0)))
AWRY = left_with(port=replace(CALIBRATION.rig.left.port, normal=(0.9, 0.0, 0.0)))
FOLDED = left_with(lens=replace(CALIBRATION.rig.left.lens, distortion=(0.0,) * 12))
SKEW = replace(STATED, depth_error_mm2=(*depth_errors()[:-1], (0.0,) * DEPTH_ERROR_TERMS))
WRONG_FILES: list[tuple[Any, bytes, str]] = [
    (calibration_file, encode_calibration(CALIBRATION).replace(b"1.77", b"1.78"), "checksum"),
    (calibration_file, calibration(schema=4), "schema 4"),
    (
        calibration_file,
        resigned(calibration_file, FIELDED, lambda content: content["air_field"].update(root="AAAA")),
        r"air_field\.root is .* allowed: the factor of a covariance",
    ),
    (calibration_file, encode_calibration(THICK), r"thickness_mm is 500\.0; allowed: 0\.\.100"),
    (calibration_file, encode_calibration(SKEW), "depth_error_mm2"),
    (
        calibration_file,
        encode_calibration(TURNED),
        r"cameras\.left: rotation is .*; allowed: a rotation matrix; restore",
    ),
    (
        calibration_file,
        encode_calibration(AWRY),
        r"cameras\.left: port\.normal is .*; allowed: a unit vector",
    ),
    (
        calibration_file,
        encode_calibration(FOLDED),
        r"cameras\.left: distortion is .*; allowed: a list of 5",
    ),
    (
        calibration_file,
        resigned(
            calibration_file,
            left_with(ray_shift=SHIFT),
            lambda content: content["cameras"]["left"]["ray_shift"]["coefficients_mm"].pop(),
        ),
        r"cameras\.left: ray shift with 83",
    ),
    (calibration_file, calibration(air_covariance=None), "air_covariance is None"),
    (calibration_file, calibration(air_covariance=[[1.0]]), "air_covariance is .*; allowed: 22 lists of 22"),
    (calibration_file, calibration(volume={"nearest_mm": 264.0, "working_mm": 700.0, "farthest_mm": 336.0}), "nearest"),
    (RESPONSE_SEAL, RESPONSE_SEAL.encode(RESPONSE).replace(b"0.53", b"0.54"), "checksum"),
    (RESPONSE_SEAL, RESPONSE_SEAL.encode(RESPONSE)[:40], "JSON"),
    (RESPONSE_SEAL, b"[]", "object"),
    (RESPONSE_SEAL, b" " * 70_000, "65536"),
    (RESPONSE_SEAL, response(schema=2), "schema 2"),
    (RESPONSE_SEAL, response(harmonics=[0.5, "0.5"]), "harmonics"),
    (RESPONSE_SEAL, response(harmonics=[0.5, -0.5]), "grow"),
    (RESPONSE_SEAL, response(rig_serial=None), "rig_serial"),
    (RESPONSE_SEAL, response(exposure_us=12000.5), r"exposure_us is 12000\.5"),
    (RESPONSE_SEAL, response(trigger_delay_us=-1), "trigger_delay_us is -1"),
    (NOISE_SEAL, NOISE_SEAL.encode(NOISE).replace(b"9100.0", b"9200.0"), "checksum"),
    (NOISE_SEAL, NOISE_SEAL.encode(NOISE)[:40], "JSON"),
    (NOISE_SEAL, sealed({"schema": 2}), "schema 2"),
    (NOISE_SEAL, sealed(BARE), "cameras"),
    (NOISE_SEAL, sealed({**BARE, "cameras": {}}), "cameras.left"),
    (NOISE_SEAL, noise("right", full_well_e=400.0), r"cameras.right.full_well_e is 400\.0; allowed: 500\.\.900000"),
    (NOISE_SEAL, noise("left", read_noise_e="4"), r"cameras.left.read_noise_e is '4'; allowed: 0\.\.900"),
    (NOISE_SEAL, noise("left", black_level_dn=True), r"cameras.left.black_level_dn is True; allowed: 0\.\.63"),
]


@pytest.mark.parametrize(("module", "data", "named"), WRONG_FILES)
def test_what_is_no_such_file_is_refused_with_what_is_wrong(module: Any, data: bytes, named: str) -> None:
    errors = CalibrationError, ContentError
    with pytest.raises(errors, match=named):
        module.decode(data, "here")


def test_a_file_that_cannot_be_read_is_no_missing_one(tmp_path: Path, says: Says) -> None:
    assert NOISE_SEAL.load(tmp_path / "none.json") is None
    assert RESPONSE_SEAL.load(tmp_path / "none.json") is None
    with pytest.raises(ContentError) as unreadable:
        RESPONSE_SEAL.load(tmp_path)
    with pytest.raises(CalibrationError) as missing:
        load_calibration(tmp_path / "none.json")
    says(unreadable.value, missing.value)
    centre = CALIBRATION.rig.volume_centre_mm(CALIBRATION.water.index)
    assert np.linalg.norm(centre) == pytest.approx(522.5 / np.cos(np.radians(12.41)), abs=0.5)
    assert CALIBRATION.rig.right.translation_mm[0] > 0, "the right camera is to the right"


def put(rig: Rig, name: Path, data: bytes) -> None:
    path = rig.storage.root / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(data)


def noise_of_its_cameras(rig: Rig) -> StoredNoise:
    left, right = replace(LEFT, serial=rig.camera.left.serial), replace(RIGHT, serial=rig.camera.right.serial)
    return StoredNoise(rig.rig.serial, ("000007",), BothFigures(left, right))


def test_what_was_measured_takes_the_place_of_the_data_sheets_and_goes_with_the_scans(rig: Rig) -> None:
    put(rig, NOISE_FILE, NOISE_SEAL.encode(noise_of_its_cameras(rig)))
    used = Instrument(rig).with_measured_noise()
    for gain_db in (0.0, 6.0):
        measured = Instrument(used).noise(Exposure(8_000, gain_db))
        # At 0 dB and grey value g over black: read noise and photons in electrons, and rounding.
        for camera, figures in ((measured.left, LEFT), (measured.right, RIGHT)):
            per_e = 255.0 / figures.full_well_e * 10.0 ** (gain_db / 20.0)
            expected = (figures.read_noise_e * per_e) ** 2 + 100.0 * per_e + 1.0 / 12.0
            assert camera.variance_dn2(100.0 + figures.black_level_dn) == pytest.approx(expected)
    carried = parse_rig(Instrument(used).origin(Instrument(used).design()).rig.decode(), "the scan's")
    assert Instrument(carried).noise() == Instrument(used).noise()
    assert Instrument(used).exposures == Instrument(rig).exposures, "and nothing else is changed"
    assert replace(used, camera=rig.camera) == rig


def test_noise_of_other_cameras_or_damaged_is_told_and_not_used(rig: Rig, caplog: pytest.LogCaptureFixture) -> None:
    assert Instrument(rig).with_measured_noise() == rig
    mine = noise_of_its_cameras(rig)
    others = (
        replace(mine, rig_serial="KF-9"),
        replace(mine, cameras=BothFigures(RIGHT, mine.cameras.right)),
        replace(mine, cameras=BothFigures(mine.cameras.left, LEFT)),
    )
    with caplog.at_level(logging.WARNING, "kingfisher"):
        for data in (*map(NOISE_SEAL.encode, others), b"{}"):
            put(rig, NOISE_FILE, data)
            assert Instrument(rig).with_measured_noise() == rig
    assert len(caplog.records) == 4


def test_a_response_counts_at_its_trigger_delay_and_else_is_told(rig: Rig, caplog: pytest.LogCaptureFixture) -> None:
    """Bit planes: what begins at another moment of the projector's frame sees other bits."""
    exposure_us, delay_us = round(1000 * rig.camera.left.exposure_ms), rig.board.trigger_delay_us
    mine = replace(RESPONSE, rig_serial=rig.rig.serial)
    caplog.set_level(logging.WARNING, "kingfisher")
    for exposed_us, delayed_us, used, warned in (
        (None, None, mine.response, 0), (exposure_us, delay_us, mine.response, 0), (exposure_us - 1, delay_us, mine.response, 1),
        (exposure_us, delay_us + 7, None, 2),
    ):  # fmt: skip
        stored = replace(mine, exposure_us=exposed_us, trigger_delay_us=delayed_us)
        put(rig, RESPONSE_FILE, RESPONSE_SEAL.encode(stored))
        assert (Instrument(rig).response(), len(caplog.records)) == (used, warned)


def test_two_codes_are_too_few_for_ten_harmonics() -> None:
    """Coordinates that jump by half a period from pixel to pixel have the same two means everywhere."""
    sequence = build_sequence(64, 640, 480)
    frames = np.full((len(sequence), 120, 160), 90, np.uint8)
    frames[sequence.bright], frames[sequence.dark] = 180, 0
    jumps = 200.0 + 32.0 * (np.indices((120, 160)).sum(axis=0) % 2).astype(np.float32)
    with pytest.raises(ResponseError, match=r"harmonic \d"):
        measure_response(sequence, [CameraImages(frames, jumps, jumps)])
