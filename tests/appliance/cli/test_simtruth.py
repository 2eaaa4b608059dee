"""The simulated instrument that is as drawn comes calibrated: like the true rig to the last pixel, and never instead of another."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.cli.output import UsageError
from appliance.cli.simrig import SimOptions, apply_options, default_sim_rig
from appliance.cli.simtruth import bring_calibration, true_calibration
from appliance.store.config import Rig, load_rig
from appliance.store.instrument import Instrument, load_calibration
from appliance.store.names import CALIBRATION_FILE
from hw_sim.truth import project
from hw_sim.world import true_rig


def rig_of(root: Path, truth: str, size: str = "800x600") -> Rig:
    return apply_options(load_rig(default_sim_rig()), SimOptions(root=root, truth=truth, size=size, seed=5))


@pytest.mark.parametrize("truth", ["nominal", "modelled"])
def test_the_calibration_sees_every_point_where_the_true_cameras_see_it(truth: str, tmp_path: Path) -> None:
    rig = rig_of(tmp_path, truth)
    calibration = true_calibration(rig)
    hidden = true_rig(rig.rig.wires_options)
    in_rig = np.random.default_rng(1).uniform((-60.0, -50.0, 430.0), (60.0, 50.0, 600.0), (200, 3))
    left = np.array(hidden.left.R), np.array(hidden.left.t_mm)
    in_left = (in_rig - left[1]) @ left[0]
    for side, camera in (("left", calibration.rig.left), ("right", calibration.rig.right)):
        told = camera.project(in_left, calibration.water.index)
        assert np.abs(told - project(hidden, side, in_rig)).max() < 1e-6, side


@pytest.mark.parametrize("size", ["400x300", "1600x1200"])
def test_a_nominal_start_is_calibrated_at_any_size_and_what_is_there_is_never_touched(
    size: str, tmp_path: Path
) -> None:
    rig = rig_of(tmp_path, "nominal", size)
    assert Instrument(rig).calibration()[1], "without a calibration the screen says UNCALIBRATED"
    bring_calibration(rig)
    calibration, conditions = Instrument(rig).calibration()
    assert (calibration.method, conditions) == ("truth", ())
    path = tmp_path / CALIBRATION_FILE
    path.write_bytes(path.read_bytes().replace(b"unknown", b"mine"))
    mine, at = path.read_bytes(), path.stat().st_mtime_ns
    for other in (size, "800x600"):
        bring_calibration(rig_of(tmp_path, "nominal", other))
    assert (path.read_bytes(), path.stat().st_mtime_ns) == (mine, at)


@pytest.mark.parametrize("theirs", ["calibration/air.json", "calibration/kept/20260101.json"])
def test_nothing_is_brought_where_somebody_has_begun_to_calibrate(theirs: str, tmp_path: Path) -> None:
    (tmp_path / theirs).parent.mkdir(parents=True)
    (tmp_path / theirs).write_text("{}", encoding="utf-8")
    bring_calibration(rig_of(tmp_path, "nominal"))
    assert not (tmp_path / CALIBRATION_FILE).exists()


def test_the_rigs_that_are_there_to_be_calibrated_get_none(tmp_path: Path) -> None:
    in_air = rig_of(tmp_path, "nominal")
    in_air = replace(in_air, rig=replace(in_air.rig, wires_options={**in_air.rig.wires_options, "medium": "air"}))
    for rig in (in_air, *(rig_of(tmp_path, truth) for truth in ("realistic", "hard", "paper", "modelled"))):
        bring_calibration(rig)
    assert not (tmp_path / CALIBRATION_FILE).exists()


def test_another_true_rig_is_not_measured_with_the_nominal_calibration(tmp_path: Path) -> None:
    bring_calibration(rig_of(tmp_path, "nominal"))
    with pytest.raises(UsageError, match=r"this start differs.*give another folder, truth=nominal, or remove"):
        bring_calibration(rig_of(tmp_path, "realistic"))
    assert load_calibration(tmp_path / CALIBRATION_FILE).method == "truth"
