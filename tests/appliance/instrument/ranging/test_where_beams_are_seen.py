"""Where the live light is dark, where the marks are drawn, and what the instrument's own frame is, for beams of given places."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from appliance.instrument.ranging.beams import Pointers, RigFrame
from appliance.instrument.ranging.expected_light import live_light
from appliance.instrument.ranging.reach import marks_of
from appliance.measure.light.patterns import BRIGHT_CODE, DARK_CODE
from tests.appliance.instrument.ranging.test_spots_in_pictures import BEAMS, Bench
from tests.support.truth import WATER

Row = tuple[float, float, float]
POINTERS = Pointers((60.0, 10.0, 30.0), (20.0, 5.0, 500.0), 1.0)


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench(400)


def test_the_live_light_is_dark_around_a_beam_as_far_as_it_may_lean_and_nowhere_else(bench: Bench) -> None:
    """5 mm, and three times the tolerance from the window on; a camera at the frame's origin stands for the projector. Nearer than
    350 mm and farther than 720 mm nobody looks for a dot. Each px against both beams, 1 mm for 1 mm."""
    projector = bench.rig.left
    white = live_light(projector, None, WATER.index)
    assert white.shape == (300, 400)
    assert np.all(white == BRIGHT_CODE)
    dark = live_light(projector, POINTERS, WATER.index) == DARK_CODE
    v, u = np.mgrid[:300:3, :400:3]
    nearest = np.full(u.shape, np.inf)
    for beam in POINTERS.beams():
        for z_mm in np.arange(350.0, 720.0, 1.0):
            place = np.array([beam.at(np.array(z_mm))])
            at, beside = (projector.project(one, WATER.index)[0] for one in (place, place + np.array([0.0, 1.0, 0.0])))
            radius_px = (5.0 + 3.0 * math.radians(1.0) * (z_mm - 30.0)) * float(np.linalg.norm(beside - at))
            nearest = np.minimum(nearest, np.hypot(u - at[0], v - at[1]) / radius_px)
    assert dark[v, u][nearest < 0.95].all()
    assert not dark[v, u][nearest > 1.1].any()
    assert min(np.mean(nearest < 0.95), np.mean(nearest > 1.1)) > 0.1


def test_a_mark_is_drawn_where_the_whole_way_through_the_volume_is_in_the_picture(bench: Bench) -> None:
    counts = set()
    for shift_mm in range(-160, 161, 40):
        beams = tuple(replace(one, line=(one.line[0] + shift_mm, *one.line[1:])) for one in BEAMS)
        marks = marks_of(bench.rig, bench.frame, WATER.index, (beams[0], beams[1]))
        counts.add((len(marks.left), len(marks.right)))
        for side, tracks in enumerate((marks.left, marks.right)):
            ways = [np.array([bench.seen(one.at(np.array(z)))[side] for z in (440.0, 500.0, 560.0)]) for one in beams]
            expected = [way for way in ways if ((way > -0.5) & (way < (399.5, 299.5))).all()]
            assert len(tracks) == len(expected)
            for track, places in zip(tracks, expected, strict=True):
                shares = np.array([track.near, track.middle, track.far])
                assert shares * (400, 300) - 0.5 == pytest.approx(places, abs=0.05)
    assert {(2, 2), (0, 0)} < counts
    assert any(a != b for a, b in counts), "some are in one picture and not in the other"


def test_the_instruments_frame_lies_between_both_cameras_and_looks_where_both_look() -> None:
    """Two cameras 200 mm apart that are of which the second one looks down by 10° more, and then is 30 mm lower."""
    rig = Bench(400).rig

    def turned(deg: float) -> tuple[Row, Row, Row]:
        c, s = math.cos(math.radians(deg)), math.sin(math.radians(deg))
        return (1.0, 0.0, 0.0), (0.0, c, s), (0.0, -s, c)

    left = replace(rig.left, rotation=turned(0.0), translation_mm=(0.0, 0.0, 0.0))
    right = replace(rig.right, rotation=turned(10.0), translation_mm=(200.0, 0.0, 0.0))
    frame = RigFrame.of(replace(rig, left=left, right=right))
    c, s = math.cos(math.radians(5.0)), math.sin(math.radians(5.0))
    assert frame.t_mm == pytest.approx((100.0, 0.0, 0.0))
    np.testing.assert_allclose(frame.R, [[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]], atol=1e-12, err_msg="x: baseline")
    lifted = RigFrame.of(replace(rig, left=left, right=replace(right, translation_mm=(200.0, 30.0, 0.0))))
    np.testing.assert_allclose(lifted.R.T @ lifted.R, np.eye(3), atol=1e-12)
    assert np.linalg.det(lifted.R) == pytest.approx(1.0)
    assert lifted.R[:, 0] == pytest.approx(np.array([200.0, 30.0, 0.0]) / math.hypot(200.0, 30.0))
    places = np.array([[3.0, -5.0, 480.0], [40.0, 7.0, 510.0]])
    assert lifted.from_left(lifted.to_left(places)) == pytest.approx(places)
    assert lifted.to_left(np.zeros(3)) == pytest.approx((100.0, 15.0, 0.0))
    assert lifted.turn_from_left(lifted.R[:, 2]) == pytest.approx((0.0, 0.0, 1.0))
    behind = replace(left, translation_mm=(0.0, 0.0, 200.0))
    for other in (left, behind):
        with pytest.raises(ValueError, match="no baseline across their axes"):
            RigFrame.of(replace(rig, left=left, right=other))
