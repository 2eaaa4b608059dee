"""The second camera's testimony: along the ray of what one camera sees alone, and on what a dark frame shows of a laser."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.ranging.dots import contrast_of
from appliance.ranging.other_camera import OtherCamera
from appliance.ranging.witness import shines_in_the_dark
from tests.appliance.ranging.test_spots_in_pictures import Array, Bench, on
from tests.support.truth import WATER

CONTRAST_DN = 100.0


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench(400)


def ray(bench: Bench, side: int, through_mm: tuple[float, float, float]) -> tuple[Array, Array]:
    """From one camera's eye through a place of the instrument's frame: start and direction."""
    camera = (bench.rig.left, bench.rig.right)[side]
    start = bench.frame.from_left(np.array(camera.translation_mm))
    way = np.array(through_mm) - start
    return start, way / np.linalg.norm(way)


def beyond(start: Array, ahead: Array, z_mm: float) -> Array:
    return np.asarray(start + ahead * (z_mm - start[2]) / ahead[2])


def nothing_like(bench: Bench, side: int, through_mm: tuple[float, float, float], picture: NDArray[np.uint8]) -> bool:
    """What the camera that is not ``side`` says of a spot of ``CONTRAST_DN``."""
    start, ahead = ray(bench, side, through_mm)
    own = np.full_like(picture, 77)
    images = (own, picture) if side == 0 else (picture, own)
    return OtherCamera(bench.rig, bench.frame, WATER.index).sees_nothing_like(side, start, ahead, images, CONTRAST_DN)


def spot(bench: Bench, share: float, at: Array) -> NDArray[np.uint8]:
    """A spot of that share of ``CONTRAST_DN``, as near as grey values allow."""
    heights = np.arange(10.0, 250.0, 0.5)
    found = [float(contrast_of(bench.picture((at, height))).max()) for height in heights[::20]]
    height = float(np.interp(share * CONTRAST_DN, found, heights[::20]))
    picture = bench.picture((at, height))
    assert contrast_of(picture).max() == pytest.approx(share * CONTRAST_DN, rel=0.08)
    return picture


THROUGH = ((20.9, 5.4, 490.0), (-20.9, 5.4, 490.0))
"""A place that either camera sees, by the number of the camera, whose ray the other one sees from 330 mm on."""


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("z_mm", [345.0, 420.0, 500.0, 610.0, 690.0])
def test_what_shows_anywhere_on_the_ray_is_seen_by_the_other_camera_too(bench: Bench, side: int, z_mm: float) -> None:
    start, ahead = ray(bench, side, THROUGH[side])
    at = bench.seen(beyond(start, ahead, z_mm))[1 - side]
    assert nothing_like(bench, side, THROUGH[side], np.zeros((300, 400), np.uint8))
    assert nothing_like(bench, side, THROUGH[side], spot(bench, 0.2, at)), "nothing like it"
    assert not nothing_like(bench, side, THROUGH[side], spot(bench, 0.32, at))


@pytest.mark.parametrize(("off_px", "beside"), [(0.0, False), (2.6, False), (-2.6, False), (7.0, True), (-7.0, True)])
def test_what_shows_beside_the_ray_is_something_else(bench: Bench, off_px: float, beside: bool) -> None:
    start, ahead = ray(bench, 0, THROUGH[0])
    at = bench.seen(beyond(start, ahead, 500.0))[1] + (0.0, off_px)
    assert nothing_like(bench, 0, THROUGH[0], spot(bench, 0.4, at)) == beside


@pytest.mark.parametrize(("off_px", "beside"), [(4, False), (-4, False), (5, True), (-5, True)])
def test_the_way_along_the_ray_ends_a_few_px_to_either_side(bench: Bench, off_px: int, beside: bool) -> None:
    """By a spot that is like it in one px alone."""
    start, ahead = ray(bench, 0, THROUGH[0])
    at = np.rint(bench.seen(beyond(start, ahead, 500.0))[1]) + np.array([0.0, off_px])
    picture = spot(bench, 0.28, at)
    assert np.count_nonzero(contrast_of(picture) > 0.25 * CONTRAST_DN) == 1
    assert nothing_like(bench, 0, THROUGH[0], picture) == beside


def test_pictures_of_full_size_are_looked_at_in_the_same_way() -> None:
    full = Bench(1600)
    start, ahead = ray(full, 0, THROUGH[0])
    for z_mm, off_px, beside in ((450.0, 0.0, False), (600.0, 8.0, False), (500.0, 40.0, True)):
        at = full.seen(beyond(start, ahead, z_mm))[1] + (0.0, off_px)
        assert nothing_like(full, 0, THROUGH[0], full.picture((at, 120.0))) == beside


@pytest.mark.parametrize(
    ("through_mm", "tells"),
    [
        ((20.9, 0.0, 490.0), True),
        ((-20.9, 0.0, 490.0), False),
        ((60.0, 0.0, 500.0), True),
        ((85.0, 0.0, 500.0), False),
        ((20.9, 120.0, 490.0), False),
    ],
)
def test_a_camera_that_does_not_see_the_ray_as_far_as_the_volume_goes_cannot_tell(
    bench: Bench, through_mm: tuple[float, float, float], tells: bool
) -> None:
    """The right picture shows 330 mm of the first ray and 620 mm of the third one; what is beyond does not matter."""
    start, ahead = ray(bench, 0, through_mm)
    inside = [bool(0 < bench.seen(beyond(start, ahead, z))[1][0] < 400) for z in (200.0, 330.0, 620.0, 715.0)]
    assert inside[1:3] == [through_mm[0] > 0.0, through_mm[0] < 80.0]
    assert not inside[0], "nearer than the volume it never sees it"
    assert not (inside[3] and through_mm[0] > 50.0), "nor does it see all of the third ray beyond"
    assert nothing_like(bench, 0, through_mm, np.zeros((300, 400), np.uint8)) == tells


def test_a_speck_before_the_volume_counts_where_the_other_camera_sees_it(bench: Bench) -> None:
    through = (60.0, 0.0, 500.0)
    start, ahead = ray(bench, 0, through)
    at = bench.seen(beyond(start, ahead, 289.0))[1]
    assert 10.0 < at[0] < 40.0
    assert not nothing_like(bench, 0, through, bench.picture((at, 200.0)))


# ------------------------------------------------------------------------------------------------- the dark frame


def frames(
    bench: Bench, ground_dn: float, heights_dn: tuple[float, float]
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Both cameras' pictures with a spot where the right pointer's dot is at 490 mm."""
    left, right = (
        bench.picture((uv, height), ground_dn=ground_dn)
        for uv, height in zip(bench.seen(on(1, 490.0)), heights_dn, strict=True)
    )
    return left, right


@pytest.mark.parametrize(("height_dn", "counts"), [(21.0, False), (34.0, True)])
def test_a_dot_in_the_dark_frame_is_evidence_from_15_grey_values_on(
    bench: Bench, height_dn: float, counts: bool
) -> None:
    dark, bright = frames(bench, 5.0, (height_dn, height_dn)), frames(bench, 105.0, (height_dn, height_dn))
    contrast = contrast_of(dark[0]).max()
    assert 16.0 < contrast < 25.0 if counts else 9.0 < contrast < 14.0
    assert shines_in_the_dark(bench.ranger(), bright, dark) == (("right",) if counts else ())


def test_what_one_camera_sees_in_the_dark_proves_nothing(bench: Bench) -> None:
    dark, bright = frames(bench, 5.0, (120.0, 0.0)), frames(bench, 105.0, (120.0, 0.0))
    ranger = bench.ranger()
    assert [shines_in_the_dark(ranger, bright, dark) for _ in range(6)] == 6 * [()]


@pytest.mark.parametrize(
    ("more_dn", "shines"), [((0.0, 0.0), True), ((75.0, 75.0), True), ((130.0, 130.0), False), ((0.0, 130.0), False)]
)
def test_a_print_becomes_brighter_in_the_projectors_light_and_a_laser_does_not(
    bench: Bench, more_dn: tuple[float, float], shines: bool
) -> None:
    """Ambient light is a ninth of the projector's: a print of 30 grey values would show 270 more, a third of it is enough."""
    dark = frames(bench, 8.0, (30.0, 30.0))
    bright = frames(bench, 80.0, (30.0 + more_dn[0], 30.0 + more_dn[1]))
    assert shines_in_the_dark(bench.ranger(), bright, dark) == (("right",) if shines else ())


def test_in_daylight_what_does_not_become_brighter_is_a_lasers_too(bench: Bench) -> None:
    """Ambient light is ten times the projector's: a print of 30 grey values would show 3 more, of which nothing is there."""
    dark, bright = frames(bench, 100.0, (32.0, 32.0)), frames(bench, 110.0, (32.0, 32.0))
    assert shines_in_the_dark(bench.ranger(), bright, dark) == ("right",)
    print_dn = 1.0  # a third of it, and a bit
    more = frames(bench, 110.0, (32.0 + 2.0 * print_dn, 32.0 + 2.0 * print_dn))
    assert shines_in_the_dark(bench.ranger(), more, dark) == ()


def test_where_the_bright_frame_is_saturated_it_explains_nothing(bench: Bench) -> None:
    """There the print, too, would show no more light; the other camera decides, and where there is none the dot is a laser's."""
    dark = frames(bench, 8.0, (30.0, 30.0))
    bright = frames(bench, 80.0, (160.0, 160.0))
    white = np.full_like(bright[0], 255)
    ranger = bench.ranger()
    assert shines_in_the_dark(ranger, bright, dark) == ()
    assert shines_in_the_dark(ranger, (white, bright[1]), dark) == ()
    assert shines_in_the_dark(ranger, (bright[0], white), dark) == ()
    assert shines_in_the_dark(ranger, (white, white), dark) == ("right",)
