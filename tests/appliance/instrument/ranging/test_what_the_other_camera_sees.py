"""The second camera's testimony: along the ray of what one camera sees alone, and on what a dark frame shows of a laser."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.instrument.ranging.dots import contrast_of
from appliance.instrument.ranging.ranger import OtherCamera, shines_in_the_dark
from tests.appliance.instrument.ranging.test_spots_in_pictures import Array, Bench, on
from tests.support.truth import WATER

CONTRAST_DN = 100.0
Place = tuple[float, float, float]


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench(400)


def on_ray(bench: Bench, side: int, through_mm: Place, z_mm: float) -> Array:
    """Where the other camera sees the ray of one camera's eye through a place of the instrument's frame, at a depth."""
    start = bench.frame.from_left(np.array((bench.rig.left, bench.rig.right)[side].translation_mm))
    ahead = np.array(through_mm) - start
    return bench.seen(np.asarray(start + ahead * (z_mm - start[2]) / ahead[2]))[1 - side]


def nothing_like(bench: Bench, side: int, through_mm: Place, picture: NDArray[np.uint8]) -> bool:
    """What the camera that is not ``side`` says of a spot of ``CONTRAST_DN``."""
    start = bench.frame.from_left(np.array((bench.rig.left, bench.rig.right)[side].translation_mm))
    ahead = np.array(through_mm) - start
    own = np.full_like(picture, 77)
    images = (own, picture) if side == 0 else (picture, own)
    other = OtherCamera(bench.rig, bench.frame, WATER.index)
    return other.sees_no_match(side, start, ahead / np.linalg.norm(ahead), images, CONTRAST_DN)


def spot(bench: Bench, share: float, at: Array) -> NDArray[np.uint8]:
    """A spot of that share of ``CONTRAST_DN``, as near as grey values allow."""
    heights = np.arange(10.0, 250.0, 10.0)
    found = [float(contrast_of(bench.picture((at, height))).max()) for height in heights]
    picture = bench.picture((at, float(np.interp(share * CONTRAST_DN, found, heights))))
    assert contrast_of(picture).max() == pytest.approx(share * CONTRAST_DN, rel=0.08)
    return picture


THROUGH: tuple[Place, Place] = (20.9, 5.4, 490.0), (-20.9, 5.4, 490.0)
"""A place that either camera sees, by the number of the camera, whose ray the other one sees from 330 mm on."""


@pytest.mark.parametrize(("side", "z_mm"), [(0, 345.0), (0, 690.0), (1, 500.0)])
def test_what_shows_anywhere_on_the_ray_is_seen_by_the_other_camera_too(bench: Bench, side: int, z_mm: float) -> None:
    at = on_ray(bench, side, THROUGH[side], z_mm)
    assert nothing_like(bench, side, THROUGH[side], np.zeros((300, 400), np.uint8))
    assert nothing_like(bench, side, THROUGH[side], spot(bench, 0.2, at)), "nothing like it"
    assert not nothing_like(bench, side, THROUGH[side], spot(bench, 0.32, at))


def test_the_way_along_the_ray_ends_a_few_px_to_either_side(bench: Bench) -> None:
    """By a spot that is like it in one px alone."""
    for off_px, beside in ((4, False), (-4, False), (5, True), (-5, True)):
        at = np.rint(on_ray(bench, 0, THROUGH[0], 500.0)) + np.array([0.0, off_px])
        picture = spot(bench, 0.28, at)
        assert np.count_nonzero(contrast_of(picture) > 0.25 * CONTRAST_DN) == 1
        assert nothing_like(bench, 0, THROUGH[0], picture) == beside, off_px


def test_pictures_of_full_size_are_looked_at_in_the_same_way() -> None:
    full = Bench(1600)
    for z_mm, off_px, beside in ((600.0, 8.0, False), (500.0, 40.0, True)):
        at = on_ray(full, 0, THROUGH[0], z_mm) + np.array([0.0, off_px])
        assert nothing_like(full, 0, THROUGH[0], full.picture((at, 120.0))) == beside


def test_a_camera_that_does_not_see_the_ray_as_far_as_the_volume_goes_cannot_tell(bench: Bench) -> None:
    """The right picture shows 330 mm of the first ray and 620 mm of the third one; what is beyond does not matter."""
    for through_mm, tells in (
        ((20.9, 0.0, 490.0), True), ((-20.9, 0.0, 490.0), False), ((60.0, 0.0, 500.0), True), ((85.0, 0.0, 500.0), False),
        ((20.9, 120.0, 490.0), False),
    ):  # fmt: skip
        inside = [bool(0 < on_ray(bench, 0, through_mm, z_mm)[0] < 400) for z_mm in (330.0, 620.0)]
        assert inside == [through_mm[0] > 0.0, through_mm[0] < 80.0]
        assert nothing_like(bench, 0, through_mm, np.zeros((300, 400), np.uint8)) == tells, through_mm


def frames(bench: Bench, ground_dn: float, *heights_dn: float) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Both cameras' pictures with a spot where the right pointer's dot is at 490 mm."""
    left, right = (
        bench.picture((uv, height), ground_dn=ground_dn)
        for uv, height in zip(bench.seen(on(1, 490.0)), heights_dn, strict=True)
    )
    return left, right


@pytest.mark.parametrize(
    ("dark", "bright", "shines"),
    [
        # A dot of 15 grey values of contrast and more is evidence, if both cameras see it.
        ((5.0, 21.0, 21.0), (105.0, 21.0, 21.0), False), ((5.0, 34.0, 34.0), (105.0, 34.0, 34.0), True), ((5.0, 120.0, 0.0), (105.0, 120.0, 0.0), False),
        # Ambient light is a ninth of the projector's: a print of 30 would show 270 more, a third of it is enough.
        ((8.0, 30.0, 30.0), (80.0, 105.0, 105.0), True), ((8.0, 30.0, 30.0), (80.0, 160.0, 160.0), False), ((8.0, 30.0, 30.0), (80.0, 30.0, 160.0), False),
        # In daylight, ten times the projector's light, a print of 30 would show 3 more.
        ((100.0, 32.0, 32.0), (110.0, 32.0, 32.0), True), ((100.0, 32.0, 32.0), (110.0, 34.0, 34.0), False),
    ],
)  # fmt: skip
def test_a_print_becomes_brighter_in_the_projectors_light_and_a_laser_does_not(
    bench: Bench, dark: tuple[float, ...], bright: tuple[float, ...], shines: bool
) -> None:
    """Ground, and the spot's height in the left and the right picture."""
    ranger = bench.ranger()
    found = [shines_in_the_dark(ranger, frames(bench, *bright), frames(bench, *dark)) for _ in range(5)]
    assert found == 5 * [("right",) if shines else ()]


def test_where_the_bright_frame_is_saturated_it_explains_nothing(bench: Bench) -> None:
    """There the print, too, would show no more light; the other camera decides, and where there is none the dot is a laser's."""
    dark, (left, right) = frames(bench, 8.0, 30.0, 30.0), frames(bench, 80.0, 160.0, 160.0)
    white = np.full_like(left, 255)
    for bright, found in (((white, right), ()), ((left, white), ()), ((white, white), ("right",))):
        assert shines_in_the_dark(bench.ranger(), bright, dark) == found
