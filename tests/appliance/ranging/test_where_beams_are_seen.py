"""Where the live light is dark, where the marks are drawn, and what the instrument's own frame is, for beams of given places."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from appliance.patterns.sequence import BRIGHT_CODE, DARK_CODE
from appliance.ranging.beams import Pointers
from appliance.ranging.expected_light import live_light
from appliance.ranging.marks import marks_of
from appliance.ranging.rig_frame import RigFrame
from tests.appliance.ranging.test_spots_in_pictures import BEAMS, Bench
from tests.support.truth import WATER

Row = tuple[float, float, float]
POINTERS = Pointers((60.0, 10.0, 30.0), (20.0, 5.0, 500.0), 1.0)


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench(400)


def test_without_pointers_the_live_light_is_white(bench: Bench) -> None:
    light = live_light(bench.rig.left, None, WATER.index)
    assert light.shape == (300, 400)
    assert np.all(light == BRIGHT_CODE)


@pytest.mark.parametrize("z_mm", [352.0, 440.0, 600.0, 716.0])
@pytest.mark.parametrize("pointer", [0, 1])
def test_the_live_light_is_dark_around_a_beam_as_far_as_it_may_lean_and_no_farther(
    bench: Bench, pointer: int, z_mm: float
) -> None:
    """5 mm, and three times the tolerance from the window on; here a camera at the frame's origin stands for the projector."""
    projector = bench.rig.left
    light = live_light(projector, POINTERS, WATER.index)
    middle = POINTERS.beams()[pointer].at(np.array(z_mm))
    free_mm = 5.0 + 3.0 * math.radians(1.0) * (z_mm - 30.0)
    seen = []
    for share in (0.0, 0.93, -0.93, 1.1, -1.1):
        (u, v), *_ = projector.project((middle + np.array([0.0, share * free_mm, 0.0]))[None], WATER.index)
        seen.append((round(float(u)), round(float(v))))
    codes = [int(light[v, u]) for u, v in seen if 0 <= u < 400]
    assert codes in ([DARK_CODE] * 3 + [BRIGHT_CODE] * 2, [])


def test_the_live_light_is_dark_nowhere_else(bench: Bench) -> None:
    """Nearer than 350 mm and farther than 720 mm nobody looks for a dot. Each px against both beams, 1 mm for 1 mm."""
    projector = bench.rig.left
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


@pytest.mark.parametrize("shift_mm", range(-160, 161, 20))
def test_a_mark_is_drawn_where_the_whole_way_through_the_volume_is_in_the_picture(bench: Bench, shift_mm: int) -> None:
    beams = tuple(replace(one, line=(one.line[0] + shift_mm, *one.line[1:])) for one in BEAMS)
    marks = marks_of(bench.rig, bench.frame, WATER.index, (beams[0], beams[1]))
    for side, tracks in enumerate((marks.left, marks.right)):
        expected = []
        for beam in beams:
            places = np.array([bench.seen(beam.at(np.array(z_mm)))[side] for z_mm in (440.0, 500.0, 560.0)])
            inside = (places > -0.5).all() and (places[:, 0] < 399.5).all() and (places[:, 1] < 299.5).all()
            if inside:
                expected.append(places)
        assert len(tracks) == len(expected)
        for track, places in zip(tracks, expected, strict=True):
            shares = np.array([track.near, track.middle, track.far])
            assert shares * (400, 300) - 0.5 == pytest.approx(places, abs=0.05)


def test_some_of_these_marks_are_in_one_picture_and_not_in_the_other(bench: Bench) -> None:
    counts = set()
    for shift_mm in range(-160, 161, 20):
        beams = tuple(replace(one, line=(one.line[0] + shift_mm, *one.line[1:])) for one in BEAMS)
        marks = marks_of(bench.rig, bench.frame, WATER.index, (beams[0], beams[1]))
        counts.add((len(marks.left), len(marks.right)))
    assert {(2, 2), (0, 0)} < counts
    assert any(a != b for a, b in counts)


def test_the_instruments_frame_lies_between_both_cameras_and_looks_where_both_look() -> None:
    """Two cameras 200 mm apart that are of which the second one looks down by 10° more, and then is 30 mm lower."""
    rig = Bench(400).rig

    def turned(deg: float) -> tuple[Row, Row, Row]:
        c, s = math.cos(math.radians(deg)), math.sin(math.radians(deg))
        return (1.0, 0.0, 0.0), (0.0, c, s), (0.0, -s, c)

    left = replace(rig.left, rotation=turned(0.0), translation_mm=(0.0, 0.0, 0.0))
    right = replace(rig.right, rotation=turned(10.0), translation_mm=(200.0, 0.0, 0.0))
    frame = RigFrame.of(replace(rig, left=left, right=right))
    assert frame.t_mm == pytest.approx((100.0, 0.0, 0.0))
    assert frame.R[:, 0] == pytest.approx((1.0, 0.0, 0.0)), "x runs along the baseline"
    half = math.radians(5.0)
    assert frame.R[:, 1] == pytest.approx((0.0, math.cos(half), -math.sin(half)))
    assert frame.R[:, 2] == pytest.approx((0.0, math.sin(half), math.cos(half)))
    lifted = RigFrame.of(replace(rig, left=left, right=replace(right, translation_mm=(200.0, 30.0, 0.0))))
    assert np.linalg.det(lifted.R) == pytest.approx(1.0)
    assert np.allclose(lifted.R.T @ lifted.R, np.eye(3))
    assert lifted.R[:, 0] == pytest.approx(np.array([200.0, 30.0, 0.0]) / math.hypot(200.0, 30.0))
    places = np.array([[3.0, -5.0, 480.0], [40.0, 7.0, 510.0]])
    assert lifted.from_left(lifted.to_left(places)) == pytest.approx(places)
    assert lifted.to_left(np.zeros(3)) == pytest.approx((100.0, 15.0, 0.0))
    assert lifted.turn_from_left(lifted.R[:, 2]) == pytest.approx((0.0, 0.0, 1.0))


@pytest.mark.parametrize("translation_mm", [(0.0, 0.0, 0.0), (0.0, 0.0, 200.0)])
def test_cameras_behind_each_other_have_no_frame(translation_mm: tuple[float, float, float]) -> None:
    rig = Bench(400).rig
    one = replace(rig.left, translation_mm=(0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="no baseline across their axes"):
        RigFrame.of(replace(rig, left=one, right=replace(one, translation_mm=translation_mm)))
