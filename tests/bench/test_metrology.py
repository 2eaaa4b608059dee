"""The ladder's measurement is honest: unseen poses, all errors counted, tables that say what the files say."""

from __future__ import annotations

import numpy as np
import pytest

from bench.metrology.hidden import Effort, examine
from bench.metrology.poses import CALIBRATION_BARS, CALIBRATION_PLANES, unseen
from bench.metrology.table import as_json
from tests.support.calibrating import hidden_rig

SMALL = Effort(rungs=("pm_mapped", "ba_spline_4"), boards=8, bars=1, planes=1, frustums=1)


@pytest.mark.dive
def test_from_wires_to_numbers_a_bundle_beats_a_pinhole() -> None:
    done: list[str] = []
    rows = {r.rung: as_json(r) for r in examine("realistic", 3, 800, 600, SMALL, done.append)}
    assert len(done) == SMALL.scans == 7
    pinhole, bundle = rows["pm_mapped"], rows["ba_spline_4"]
    assert (pinhole["recordings"], bundle["recordings"]) == (0, 4)
    assert not pinhole["missing"]
    assert not bundle["missing"]
    assert bundle["E_Lb"] < 0.06
    assert bundle["E_Lp"] < min(0.10, 0.5 * pinhole["E_Lp"])
    assert bundle["E_F_sys"] < 0.03
    assert bundle["gap_mm"] < 0.02 < 0.1 < pinhole["gap_mm"], (
        "rays of a pinhole pass by each other, and are still judged"
    )
    assert 0.01 < bundle["noise_mm"] < 0.03


@pytest.mark.parametrize("truth_set", ["realistic", "paper"])
def test_unseen_poses_are_the_same_each_time_and_none_calibrates(truth_set: str) -> None:
    truth = hidden_rig(truth_set, 5)
    found = unseen(truth, 4, 3, 3)
    assert found == unseen(truth, 4, 3, 3)
    assert [name for name, _ in found] == ["ballbar"] * 4 + ["plane"] * 3 + ["frustum"] * 3
    for name, used in (("ballbar", CALIBRATION_BARS), ("plane", CALIBRATION_PLANES)):
        for pose in (pose for thing, pose in found if thing == name):
            assert min(np.abs(np.subtract(pose, other)).max() for other in used) > 3.0
