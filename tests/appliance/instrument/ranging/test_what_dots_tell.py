"""What given dots tell: which are believed, where a surface is and how certain, and the word that tells the diver to go closer or back."""

from __future__ import annotations

import itertools
import math

import pytest

from appliance.instrument.ranging.beams import Pointers
from appliance.instrument.ranging.ranger import Dot, Dots, Ranger
from appliance.instrument.ranging.reach import Range, Reach, reach_of
from appliance.measure.light.volume import STANDARD, WorkingVolume
from hw_sim.truth import draw_truth
from tests.support.truth import WATER, true_calibration

POINTERS = Pointers((60.0, 10.0, 30.0), (20.0, 5.0, 500.0), 1.0)


@pytest.fixture(scope="module")
def rangers() -> tuple[Ranger, Ranger]:
    """With a measured calibration, and with the drawing."""
    rig = true_calibration(draw_truth("modelled", 3, 400, 300, WATER.index)).rig
    beams = POINTERS.beams()
    return Ranger(rig, WATER.index, beams), Ranger(rig, WATER.index, beams, measured=False)


def dot(x_mm: float, z_mm: float, sigma_mm: float = 0.4, contrast_dn: float = 80.0, cameras: int = 2) -> Dot:
    return Dot((x_mm, 3.0, z_mm), sigma_mm, contrast_dn, cameras)


@pytest.mark.parametrize(
    ("left", "right", "told"),
    [
        (None, None, None),
        (dot(-20.0, 480.0), None, Range(480.0, None, 0.4, 1)),
        (None, dot(20.0, 480.0), Range(480.0, None, 0.4, 1)),
        # 30 mm left of the axis at 470 mm, 10 mm right of it at 490 mm: three quarters of the way.
        (dot(-30.0, 470.0, 0.8), dot(10.0, 490.0, 0.4), Range(485.0, 26.56505, math.hypot(0.2, 0.3), 2)),
        (dot(-20.0, 500.0), dot(20.0, 480.0), Range(490.0, -26.56505, 0.4 * math.sqrt(0.5), 2)),
        # 40 mm apart: 58.4° at 65 mm, 61.3° at 73 mm, where they lie on two surfaces and the nearer counts.
        (dot(-20.0, 480.0, 0.3), dot(20.0, 545.0, 0.5), Range(512.5, 58.3925, 0.5 * math.hypot(0.3, 0.5), 2)),
        (dot(-20.0, 480.0, 0.3), dot(20.0, 553.0, 0.5), Range(480.0, None, 0.3, 2)),
        (dot(-20.0, 480.0, 0.3), dot(20.0, 407.0, 0.5), Range(407.0, None, 0.5, 2)),
        # They have changed sides: nearer than where the beams would cross one may lie before the other, or beyond it.
        (dot(-20.0, 480.0), dot(-20.0, 480.0), Range(480.0, None, 0.4, 2)),
        (dot(-20.0, 480.0), dot(-25.0, 480.0), Range(480.0, None, 0.4, 2)),
        # Two faint ones on one surface bear each other out.
        (dot(-20.0, 480.0, 3.0, 5.0), dot(20.0, 480.0, 3.0, 5.0), Range(480.0, 0.0, 3.0 * math.sqrt(0.5), 2)),
    ],
)  # fmt: skip
def test_the_distance_is_where_the_axis_meets_the_surface_between_the_dots(
    rangers: tuple[Ranger, Ranger], left: Dot | None, right: Dot | None, told: Range | None
) -> None:
    found = rangers[0].range_of(Dots(left, right))
    if found is None or told is None:
        assert found is told
        return
    assert (found.distance_mm, found.sigma_mm, found.dots) == pytest.approx(
        (told.distance_mm, told.sigma_mm, told.dots)
    )
    assert found.tilt_deg == (told.tilt_deg if told.tilt_deg is None else pytest.approx(told.tilt_deg, abs=1e-3))


def test_of_two_dots_on_two_surfaces_a_faint_one_may_be_none(rangers: tuple[Ranger, Ranger]) -> None:
    """Unless the clear one is beyond doubt nobody knows which of them is the dot."""
    for clear_dn, cameras, faint_dn, distance_mm in (
        (100.0, 2, 40.0, 470.0), (100.0, 2, 35.0, None), (100.0, 2, 16.0, None), (100.0, 2, 14.0, 550.0), (100.0, 1, 14.0, None),
        (51.0, 2, 14.0, 550.0), (48.0, 2, 14.0, None),
    ):  # fmt: skip
        for side in (1.0, -1.0):
            clear, faint = dot(-20.0 * side, 550.0, 0.4, clear_dn, cameras), dot(20.0 * side, 470.0, 0.4, faint_dn)
            found = rangers[0].range_of(Dots(clear, faint) if side > 0.0 else Dots(faint, clear))
            assert (None if found is None else found.distance_mm) == distance_mm, (clear_dn, cameras, faint_dn)
            if found is not None:
                assert (found.tilt_deg, found.dots) == (None, 2 if distance_mm == 470.0 else 1)


def test_the_fainter_a_lone_dot_the_more_certain_it_has_to_be(rangers: tuple[Ranger, Ranger]) -> None:
    for contrast_dn, sigma_mm, believed in (
        (6.0, 0.5, False), (7.0, 0.5, True), (8.0, 2.5, True), (8.0, 2.8, False), (14.0, 2.8, False), (15.0, 2.8, True),
        (80.0, 5.0, True), (80.0, 5.2, False),
    ):  # fmt: skip
        found = rangers[0].range_of(Dots(None, dot(20.0, 480.0, sigma_mm, contrast_dn)))
        assert (found is not None) == believed, (contrast_dn, sigma_mm)


def test_a_distance_by_the_drawing_is_uncertain_by_a_part_of_itself(rangers: tuple[Ranger, Ranger]) -> None:
    """By 1.5 %: nobody has measured where the cameras are."""
    found = rangers[1].range_of(Dots(None, dot(20.0, 560.0, 2.0)))
    assert found is not None
    assert (found.distance_mm, found.sigma_mm) == pytest.approx((560.0, math.hypot(2.0, 0.015 * 560.0)))


SMALL = WorkingVolume(264.0, 300.0, 336.0)


def at(distance_mm: float) -> Range:
    return Range(distance_mm, None, 0.3, 1)


def test_the_measuring_volume_is_60_mm_to_either_side_of_500_and_another_housings_its_own() -> None:
    for volume, distance_mm, word in (
        (STANDARD, 439.0, Reach.BACK), (STANDARD, 441.0, Reach.OK), (STANDARD, 559.0, Reach.OK), (STANDARD, 561.0, Reach.CLOSER),
        (SMALL, 250.0, Reach.BACK), (SMALL, 330.0, Reach.OK), (SMALL, 350.0, Reach.CLOSER),
    ):  # fmt: skip
        assert reach_of(at(distance_mm), volume=volume) is word
        assert reach_of(None, word) is Reach.UNKNOWN, "without a dot no word is invented"


@pytest.mark.parametrize("limit_mm", [440.0, 560.0])
def test_hands_that_tremble_at_a_limit_do_not_make_the_word_flicker(limit_mm: float) -> None:
    word, words = reach_of(at(limit_mm - 20.0)), []
    for step in range(40):
        drift_mm, tremor_mm = step - 20.0, 2.0 * (-1) ** step
        word = reach_of(at(limit_mm + drift_mm + tremor_mm), word)
        words.append(word)
    assert sum(a is not b for a, b in itertools.pairwise(words)) == 1
