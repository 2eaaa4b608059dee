"""The signed ray gap: zero for true pairs, with the sign and the pattern that each change of the instrument gives it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from appliance.calibration.gaps import MODES, TURNS, GapModes, pairs_in_volume, signed_gap_mm
from appliance.calibration.health import likeliest
from appliance.optics.model import StereoRig
from hw_sim.mount_shift import MountShift, with_mount_shifted
from hw_sim.truth import TrueRig, project, ray
from tests.support.calibrating import hidden_rig, inside
from tests.support.truth import WATER, true_calibration

TRUTH = hidden_rig("modelled", 3)
RIG = true_calibration(TRUTH).rig


def pairs_of(truth: TrueRig) -> tuple[np.ndarray, np.ndarray]:
    """True pairs, made by the simulator's own optics."""
    uv, _ = pairs_in_volume(RIG, WATER.index)
    origin, direction = ray(truth, "left", uv)
    points = origin + direction * ((520.0 - origin[:, 2:]) / direction[:, 2:])
    right = project(truth, "right", points)
    keep = inside(right)
    return uv[keep], right[keep]


def test_rays_of_true_pairs_meet_and_the_gap_is_positive_where_the_left_ray_passes_below() -> None:
    """The right camera sinks: the calibration believes it higher than it is, so its rays are reported too high."""
    for y_mm, abs_mm in ((0.0, 1e-6), (0.05, 0.003)):
        gap = signed_gap_mm(RIG, WATER.index, *pairs_of(with_mount_shifted(TRUTH, MountShift("right", y_mm=y_mm))))
        assert gap == pytest.approx(y_mm, abs=abs_mm)


def test_patterns_are_independent_of_unit_size_and_turn_as_the_model_derives() -> None:
    modes = GapModes(RIG, WATER.index)
    at = modes.at(*modes.field_px)
    assert at.T @ at / len(at) == pytest.approx(np.eye(len(MODES)), abs=1e-6)
    answers = modes.of_parameters(TURNS)
    for name, turn_um in zip(TURNS, modes.turns_um, strict=True):
        assert turn_um == pytest.approx(np.radians(answers[name][0]), rel=0.01, abs=0.5)


def test_a_knock_has_the_pattern_that_the_model_derives() -> None:
    modes = GapModes(RIG, WATER.index)
    answers = modes.of_parameters()
    turns = {name: answer for name, answer in answers.items() if "right camera's" in name}

    def amplitudes(**knock: float) -> np.ndarray:
        left, right = pairs_of(with_mount_shifted(TRUTH, MountShift("right", **knock)))
        gap_um = 1000.0 * signed_gap_mm(RIG, WATER.index, left, right)
        return np.linalg.lstsq(modes.at(left, right), gap_um, rcond=None)[0]

    for axis, way, deg in (("x", "pitch_deg", 0.02), ("y", "yaw_deg", -0.02), ("z", "roll_deg", 0.02)):
        # The calibration has not made the turn, so the gap is what taking it back would do.
        name, back, found = f"right camera's turn {axis} (rad)", -math.radians(deg), amplitudes(**{way: deg})
        predicted, rest_um = answers[name]
        assert found == pytest.approx(back * predicted, rel=0.03, abs=0.3)
        assert rest_um * abs(back) < 0.6, "four patterns hold all of a turn"
        said, size, share = likeliest(tuple(found), turns)
        assert said == name
        assert size == pytest.approx(back, rel=0.1)
        assert share > 0.97
    assert likeliest(tuple(amplitudes(y_mm=0.05)), turns)[2] > 0.97


def test_cameras_that_share_no_volume_are_refused() -> None:
    away = replace(RIG.right, translation_mm=(5000.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="share too little"):
        GapModes(StereoRig(RIG.left, away), WATER.index)
