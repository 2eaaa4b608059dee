"""Hands with jerk, swell and a shoulder: where the object is seen follows from where the rig has gone."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hw_sim.objects.hand_track import HandTrack
from hw_sim.objects.motion import pose_matrix

R0, T0 = pose_matrix((10.0, -20.0, 530.0, 5.0, -8.0, 20.0))
POINT = np.array([30.0, -40.0, 12.0])


def seen(track: HandTrack, time_s: float) -> np.ndarray:
    R, t = track.seen(R0, T0, time_s)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    return np.asarray(R @ POINT + t)


def test_at_time_zero_nothing_has_moved() -> None:
    track = HandTrack.drawn(np.random.default_rng(1))
    np.testing.assert_allclose(seen(track, 0.0), R0 @ POINT + T0, atol=1e-12)
    np.testing.assert_allclose(seen(HandTrack(), 3.0), R0 @ POINT + T0, atol=1e-12)


def test_jerk_is_the_third_derivative() -> None:
    track = HandTrack(jerk_mm_s3=(60.0, -30.0, 12.0))
    h = 0.01
    third = (seen(track, 3 * h) - 3 * seen(track, 2 * h) + 3 * seen(track, h) - seen(track, 0.0)) / h**3
    np.testing.assert_allclose(third, [-60.0, 30.0, -12.0], rtol=1e-6)


def test_a_swell_comes_back_after_its_period_and_goes_as_far_as_it_says() -> None:
    track = HandTrack(swell_mm=(0.4, 0.0, 0.0), swell_hz=0.8, swell_phase_rad=0.7)
    np.testing.assert_allclose(seen(track, 1.25), seen(track, 0.0), atol=1e-12)
    x = [seen(track, s)[0] for s in np.linspace(0.0, 1.25, 400)]
    assert np.ptp(x) == pytest.approx(0.8, rel=1e-3)


def test_turns_leave_the_shoulder_where_it_is_and_swing_the_rig_by_its_arm() -> None:
    track = HandTrack(shoulder_deg=(0.0, 0.05, 0.0), shoulder_hz=1.0, shoulder_mm=(0.0, 0.0, -450.0))
    # A point that stands in the shoulder stays there; a far one seems to go by angle times distance from it.
    R, t = track.seen(np.eye(3), np.array([0.0, 0.0, -450.0]), 0.25)
    np.testing.assert_allclose(t, [0.0, 0.0, -450.0], atol=1e-12)
    _, t = track.seen(np.eye(3), np.array([0.0, 0.0, 550.0]), 0.25)
    assert t[0] == pytest.approx(-1000.0 * math.radians(0.05), rel=1e-6)
    assert math.degrees(math.acos((np.trace(R) - 1.0) / 2.0)) == pytest.approx(0.05, rel=1e-5)


def test_drawn_tracks_go_every_way_and_mostly_are_small() -> None:
    tracks = [HandTrack.drawn(np.random.default_rng(seed)) for seed in range(300)]
    directions = np.array([t.jerk_mm_s3 for t in tracks]) / [[np.linalg.norm(t.jerk_mm_s3)] for t in tracks]
    assert np.abs(directions.mean(axis=0)).max() < 0.15
    sizes = np.array([np.linalg.norm(t.swell_mm) for t in tracks])
    assert sizes.min() >= 0.03
    assert sizes.max() <= 0.6
    assert np.median(sizes) == pytest.approx((0.03 * 0.6) ** 0.5, rel=0.3), "evenly over the logarithms"
    assert 100 < sum(t.shoulder_mm[0] > 0 for t in tracks) < 200
    with pytest.raises(ValueError, match=r"hands: swell_hz = 0.0; allowed are 0..30"):
        replace(tracks[0], swell_hz=0.0)
