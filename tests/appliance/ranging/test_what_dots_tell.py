"""What is told of distance and tilt for given dots: which are believed, which bear each other out, and how certain it is."""

from __future__ import annotations

import math

import pytest

from appliance.ranging.beams import Pointers
from appliance.ranging.measure import Dot, Dots, Ranger
from appliance.ranging.reach import Range
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


def told(rangers: tuple[Ranger, Ranger], left: Dot | None, right: Dot | None) -> Range | None:
    return rangers[0].range_of(Dots(left, right))


def test_of_no_dot_nothing_is_told(rangers: tuple[Ranger, Ranger]) -> None:
    assert told(rangers, None, None) is None


def test_one_dot_tells_its_own_depth_and_no_tilt(rangers: tuple[Ranger, Ranger]) -> None:
    for pair in ((dot(-20.0, 480.0), None), (None, dot(20.0, 480.0))):
        assert told(rangers, *pair) == Range(480.0, None, 0.4, 1)


def test_the_distance_is_where_the_axis_meets_the_surface_between_two_dots(rangers: tuple[Ranger, Ranger]) -> None:
    """30 mm left of the axis at 470 mm, 10 mm right of it at 490 mm: three quarters of the way, and 26.6° of tilt."""
    found = told(rangers, dot(-30.0, 470.0, 0.8), dot(10.0, 490.0, 0.4))
    assert found is not None
    assert found.distance_mm == pytest.approx(485.0)
    assert found.tilt_deg == pytest.approx(math.degrees(math.atan(0.5)))
    assert found.sigma_mm == pytest.approx(math.hypot(0.25 * 0.8, 0.75 * 0.4))
    assert found.dots == 2


def test_a_surface_whose_left_side_is_farther_is_tilted_the_other_way(rangers: tuple[Ranger, Ranger]) -> None:
    found = told(rangers, dot(-20.0, 500.0), dot(20.0, 480.0))
    assert found is not None
    assert (found.distance_mm, found.tilt_deg) == pytest.approx((490.0, -math.degrees(math.atan(0.5))))


@pytest.mark.parametrize(
    ("behind_mm", "oblique"), [(0.0, True), (65.0, True), (-65.0, True), (73.0, False), (-73.0, False)]
)
def test_dots_that_would_make_a_surface_steeper_than_60_degrees_lie_on_two_and_the_nearer_counts(
    rangers: tuple[Ranger, Ranger], behind_mm: float, oblique: bool
) -> None:
    """40 mm apart: 58.4° at 65 mm, 61.3° at 73 mm."""
    found = told(rangers, dot(-20.0, 480.0, 0.3), dot(20.0, 480.0 + behind_mm, 0.5))
    assert found is not None
    assert found.dots == 2
    assert (found.tilt_deg is not None) == oblique
    if not oblique:
        nearer = (480.0, 0.3) if behind_mm > 0.0 else (480.0 + behind_mm, 0.5)
        assert (found.distance_mm, found.sigma_mm) == nearer


@pytest.mark.parametrize("right_x_mm", [-20.0, -25.0])
def test_dots_that_have_changed_sides_make_no_surface(rangers: tuple[Ranger, Ranger], right_x_mm: float) -> None:
    """Nearer than where the beams would cross one dot may lie before the other, or beyond it."""
    assert told(rangers, dot(-20.0, 480.0), dot(right_x_mm, 480.0)) == Range(480.0, None, 0.4, 2)


@pytest.mark.parametrize(
    ("clear", "faint", "distance_mm"),
    [
        ((100.0, 2), 45.0, 470.0),
        ((100.0, 2), 40.0, 470.0),
        ((100.0, 2), 35.0, None),
        ((100.0, 2), 16.0, None),
        ((100.0, 2), 15.0, None),
        ((100.0, 2), 14.0, 550.0),
        ((100.0, 1), 14.0, None),
        ((51.0, 2), 14.0, 550.0),
        ((50.0, 2), 14.0, 550.0),
        ((48.0, 2), 14.0, None),
    ],
)
def test_of_two_dots_on_two_surfaces_a_faint_one_may_be_none(
    rangers: tuple[Ranger, Ranger], clear: tuple[float, int], faint: float, distance_mm: float | None
) -> None:
    """Unless the clear one is beyond doubt nobody knows which of them is the dot."""
    contrast_dn, cameras = clear
    a, b = dot(-20.0, 550.0, contrast_dn=contrast_dn, cameras=cameras), dot(20.0, 470.0, contrast_dn=faint)
    found = told(rangers, a, b)
    assert (None if found is None else found.distance_mm) == distance_mm
    if found is not None:
        assert (found.tilt_deg, found.dots) == (None, 2 if distance_mm == 470.0 else 1)
    mirrored = told(rangers, dot(-20.0, 470.0, contrast_dn=faint), dot(20.0, 550.0, 0.4, contrast_dn, cameras))
    assert mirrored == found


@pytest.mark.parametrize(
    ("contrast_dn", "sigma_mm", "believed"),
    [
        (6.0, 0.5, False),
        (7.0, 0.5, True),
        (8.0, 2.0, True),
        (8.0, 2.5, True),
        (8.0, 2.8, False),
        (14.0, 2.8, False),
        (15.0, 2.8, True),
        (16.0, 2.8, True),
        (80.0, 4.8, True),
        (80.0, 5.0, True),
        (80.0, 5.2, False),
    ],
)
def test_the_fainter_a_lone_dot_the_more_certain_it_has_to_be(
    rangers: tuple[Ranger, Ranger], contrast_dn: float, sigma_mm: float, believed: bool
) -> None:
    assert (told(rangers, None, dot(20.0, 480.0, sigma_mm, contrast_dn)) is not None) == believed


def test_two_faint_dots_on_one_surface_bear_each_other_out(rangers: tuple[Ranger, Ranger]) -> None:
    assert told(rangers, dot(-20.0, 480.0, 3.0, 5.0), dot(20.0, 485.0, 3.0, 5.0)) is not None


def test_a_distance_by_the_drawing_is_uncertain_by_a_part_of_itself(rangers: tuple[Ranger, Ranger]) -> None:
    """By 1.5 %: nobody has measured where the cameras are."""
    for z_mm in (440.0, 560.0):
        found = rangers[1].range_of(Dots(None, dot(20.0, z_mm, 2.0)))
        assert found is not None
        assert found.distance_mm == z_mm
        assert found.sigma_mm == pytest.approx(math.hypot(2.0, 0.015 * z_mm))
