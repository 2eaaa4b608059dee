"""Backscatter that moves rows is no knock: what is not known of it counts as scatter, what it did to the reference cancels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from appliance.calibration.gaps import DOUBTS, MODES
from appliance.calibration.health import LEARNT_SCANS, MOST_VEIL_UM, HealthTrend, judge
from appliance.calibration.judgement import PATCHES
from appliance.calibration.patches import COUNT, PatchGaps

Array = NDArray[np.float64]
Y, X = np.divmod(np.arange(COUNT), PATCHES[0])
X, Y = 2.0 * X / (PATCHES[0] - 1.0) - 1.0, 2.0 * Y / (PATCHES[1] - 1.0) - 1.0
PATTERNS = np.stack([np.ones(COUNT), 1.5 * X, 1.5 * Y, 2.4 * X * Y], -1)
CAUSES = np.stack([0.5 * X + Y * Y, X + 0.5, X * Y - 0.3], -1)
"""Shapes of what a wrong strength and a wrong place of the projector do, µm."""


def gaps(rng: np.random.Generator, moved_um: Array, doubts_um: float | None) -> PatchGaps:
    """Return a scan whose gaps are moved by ``moved_um`` (48,), with ``doubts_um`` rms of each cause."""
    noise = np.full(COUNT, 0.8)
    known = {} if doubts_um is None else {
        "veil_um": np.zeros(COUNT), "doubts_um": doubts_um * CAUSES, "shape_um": np.full(COUNT, 0.1 * doubts_um)
    }  # fmt: skip
    return PatchGaps(np.arange(COUNT), moved_um + rng.normal(0.0, noise), noise, PATTERNS, 5_000, 1.33, **known)


def learnt(rng: np.random.Generator, moved_um: Array, doubts_um: float | None) -> HealthTrend:
    trend = HealthTrend()
    for _ in range(LEARNT_SCANS):
        trend, said = judge(trend, gaps(rng, moved_um, doubts_um))
        assert not said.alarm
    return trend


def test_turbid_water_after_a_reference_in_clear_water_is_no_alarm() -> None:
    rng = np.random.default_rng(10_001)
    trend = learnt(rng, np.zeros(COUNT), None)
    veiled = 5.0 * CAUSES @ np.array([0.8, -1.0, 0.9])
    for _ in range(10):
        trend, said = judge(trend, gaps(rng, veiled, 5.0))
        assert not said.alarm
    # The same without the doubt is what the alarm is for.
    trend = learnt(np.random.default_rng(1), np.zeros(COUNT), None)
    for _ in range(2):
        trend, told = judge(trend, gaps(rng, veiled, None))
    assert told.alarm


def test_what_backscatter_does_to_the_reference_is_no_alarm_in_clear_water() -> None:
    rng = np.random.default_rng(10_002)
    trend = learnt(rng, 5.0 * CAUSES @ np.array([1.0, 0.8, -0.9]), 5.0)
    for _ in range(10):
        trend, said = judge(trend, gaps(rng, np.zeros(COUNT), None))
        assert not said.alarm


def test_a_reference_of_the_same_water_sees_a_knock_that_one_of_other_water_does_not() -> None:
    """The causes are wrong in the same way in every scan: what counts is the difference."""
    rng = np.random.default_rng(10_003)
    veiled = 8.0 * CAUSES @ np.array([1.0, 0.8, -0.9])
    # A turn about y: for those about x and z the drift of mounts is allowed for as well.
    yaw = PATTERNS @ np.array([0.0, 0.0, 0.0, 10.0])
    _, same = judge(learnt(rng, veiled, 8.0), gaps(rng, veiled + yaw, 8.0))
    _, other = judge(learnt(rng, np.zeros(COUNT), None), gaps(rng, yaw, 8.0))
    assert same.point is not None
    assert other.point is not None
    assert same.alarm
    assert not other.alarm
    assert same.point.score > 1.5 * other.point.score


def test_a_scan_in_which_backscatter_could_hide_a_knock_is_not_judged() -> None:
    rng = np.random.default_rng(10_004)
    rms = float(np.sqrt(np.mean(np.sum(CAUSES**2, axis=1) + 0.01)))
    for doubts_um, judged in ((0.9 * MOST_VEIL_UM / rms, True), (1.1 * MOST_VEIL_UM / rms, False)):
        trend, said = judge(HealthTrend(), gaps(rng, np.zeros(COUNT), doubts_um))
        assert (said.point is not None) == judged
        assert trend.judged == int(judged)
    assert "backscatter" in said.text
    assert "22" in said.text


def test_the_doubts_have_a_place_for_each_cause() -> None:
    trend = learnt(np.random.default_rng(10_005), np.zeros(COUNT), 4.0)
    kept = np.array(trend.reference.doubts_um).reshape(COUNT, DOUBTS + 1)
    assert np.allclose(kept[:, :DOUBTS] / kept[:1, :DOUBTS], CAUSES / CAUSES[:1])
    assert len(MODES) == PATTERNS.shape[1]
