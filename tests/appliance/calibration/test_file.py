"""A calibration file gives back what was written, and says what is wrong with it otherwise."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from appliance.calibration.depth_error import COUNT
from appliance.calibration.design import Design, design_calibration
from appliance.calibration.file import Calibration, CalibrationError, decode, encode, load
from appliance.checksummed_file import with_checksum
from appliance.optics.ray_shift import RayShift
from appliance.optics.volume import STANDARD, WorkingVolume
from appliance.optics.water import Water

DESIGN = Design(11.5, 4.5, 230.0, 12.41, 30.0, 5.0, 1.77)


@pytest.fixture
def calibration() -> Calibration:
    return design_calibration(DESIGN, "KF-0001", 1600, 1200, Water(20.0, 0.0, 530.0))


def test_round_trip(calibration: Calibration) -> None:
    assert decode(encode(calibration)) == calibration
    assert decode(encode(calibration)).hash == calibration.hash


def test_design_axes_meet_500_mm_before_the_windows(calibration: Calibration) -> None:
    centre = calibration.rig.volume_centre_mm(calibration.water.index)
    assert np.linalg.norm(centre) == pytest.approx(522.5 / np.cos(np.radians(12.41)), abs=0.5)
    assert calibration.rig.right.translation_mm[0] > 0, "the right camera is to the right"


@settings(max_examples=300, deadline=None)
@given(st.integers(0, 10**6), st.integers(0, 255))
def test_any_damaged_byte_is_noticed(where: int, value: int) -> None:
    original = design_calibration(DESIGN, "KF-0001", 1600, 1200, Water(20.0, 0.0, 530.0))
    data = bytearray(encode(original))
    data[where % len(data)] = value
    if bytes(data) == encode(original):
        return
    try:
        result = decode(bytes(data))
    except CalibrationError:
        return
    assert result == original, "only a change of white space may pass"


def test_a_value_out_of_range_is_named_although_the_checksum_fits(calibration: Calibration) -> None:
    port = replace(calibration.rig.left.port, thickness_mm=500.0)
    wrong = replace(calibration, rig=replace(calibration.rig, left=replace(calibration.rig.left, port=port)))
    with pytest.raises(CalibrationError, match=r"thickness_mm is 500\.0; allowed: 0\.\.100"):
        decode(encode(wrong))


def test_another_schema_is_refused(calibration: Calibration) -> None:
    content = json.loads(encode(calibration))
    del content["sha256"]
    with pytest.raises(CalibrationError, match="schema 4; this version reads schema 1"):
        decode(with_checksum({**content, "schema": 4}))


def test_a_field_of_rays_and_a_lens_in_water_are_carried(calibration: Calibration) -> None:
    rng = np.random.default_rng(1)
    shift = RayShift(1600, 1200, (4, 3), tuple(rng.normal(0.0, 0.01, 84)))
    left = replace(calibration.rig.left, ray_shift=shift)
    for changed in (left, replace(calibration.rig.left, lens_in_water=True)):
        rich = replace(calibration, rig=replace(calibration.rig, left=changed))
        assert decode(encode(rich)) == rich


def test_what_is_stated_of_the_shared_depth_error_is_kept_and_must_be_a_covariance(calibration: Calibration) -> None:
    half = np.random.default_rng(4).normal(0.0, 0.01, (COUNT, COUNT))
    rows = half @ half.T + 1e-6 * np.eye(COUNT)
    stated = tuple(tuple(row) for row in (0.5 * (rows + rows.T)).tolist())
    rich = replace(calibration, depth_error_mm2=stated)
    assert decode(encode(rich)) == rich
    assert rich.hash != calibration.hash
    assert decode(encode(calibration)).depth_error_mm2 is None
    wrong = replace(calibration, depth_error_mm2=(*stated[:-1], (0.0,) * COUNT))
    with pytest.raises(CalibrationError, match=r"depth_error_mm2 .* a symmetric, positive definite matrix"):
        decode(encode(wrong))


def test_a_volume_of_its_own_is_kept(calibration: Calibration) -> None:
    assert decode(encode(calibration)).rig.volume == STANDARD
    small = replace(calibration, rig=replace(calibration.rig, volume=WorkingVolume(264.0, 300.0, 336.0)))
    assert decode(encode(small)) == small
    assert small.hash != calibration.hash
    content = {key: value for key, value in json.loads(encode(small)).items() if key != "sha256"}
    content["volume"]["working_mm"] = 700.0
    with pytest.raises(CalibrationError, match="nearest < working < farthest"):
        decode(with_checksum(content))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"nowhere\.json: cannot be read \(No such file"):
        load(tmp_path / "nowhere.json")
