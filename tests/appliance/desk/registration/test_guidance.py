"""While aiming: the overlap that a scan from here would have, and the way to a good one, or no word where nobody can tell."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.instrument.worker.memory import reduced
from appliance.measure.guidance import LEAST_GOOD, MOST_GOOD, Guidance, Move
from appliance.measure.overlap.next_view import Guide, Sight, long_axis
from appliance.measure.overlap.overlap import CoarseView
from appliance.measure.overlap.patches import projection_of
from tests.appliance.desk.registration.test_overlap import coarse, main_at, seen, true_share
from tests.support import synthetic
from tests.support.views import CALIBRATION, PROJECTION

SIGHT = Sight(
    CALIBRATION.rig.left, synthetic.WATER.index, PROJECTION,
    projection_of(CALIBRATION.rig.right, synthetic.WATER.index),
)  # fmt: skip
KEPT = ("main", "slight", main_at(-20.0), 1)
WITHIN = 0.08


@cache
def live(name: str, paint: str, pose: tuple[float, ...], seed: int) -> NDArray[np.uint8]:
    return reduced(seen(name, paint, pose, seed).cloud.grey)


def again(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The same some tenths of a second later: two pixels on, with other noise."""
    noise = np.random.default_rng(8).normal(size=picture.shape)
    return np.clip(np.roll(picture, 2, axis=1) + noise, 0, 255).astype(np.uint8)


def said(kept: CoarseView, *pictures: NDArray[np.uint8]) -> Guidance | None:
    """What is said of the last of some live pictures."""
    guide, last = Guide(SIGHT), None
    for picture in pictures:
        *waits, last = [*guide.look(kept, picture)]
        assert not any(waits), "nothing but the last word is an answer"
    return last


@pytest.mark.parametrize(("step_mm", "move"), [(45.0, Move.GO_ON), (105.0, Move.SCAN_NOW)])
def test_the_overlap_of_a_scan_from_here_is_told_and_the_way_to_a_good_one(step_mm: float, move: Move) -> None:
    here = ("main", "slight", main_at(-20.0 + step_mm, 1.0), 2)
    told = said(coarse(*KEPT), live(*here))
    assert told is not None
    assert told.expected.share == pytest.approx(true_share(seen(*KEPT), seen(*here)), abs=WITHIN)
    assert told.move is move
    if move is Move.SCAN_NOW:
        assert told.toward is None
    else:
        # The main has gone to the right: so has what was scanned, and new surface comes from the left.
        assert told.toward is not None
        assert told.toward[0] * (1.0 if move is Move.GO_BACK else -1.0) > 0.95
        assert np.hypot(*told.toward) == pytest.approx(1.0)


def test_two_live_pictures_that_know_each_other_but_not_the_kept_scan_send_back() -> None:
    first = live("main", "slight", main_at(-340.0, 1.0), 2)
    assert said(coarse(*KEPT), first) is None, "one picture may be blurred"
    told = said(coarse(*KEPT), first, again(first))
    assert told is not None
    assert (told.move, told.expected.none) == (Move.GO_BACK, True)


def test_in_the_dark_and_in_noise_nothing_is_said() -> None:
    dark = np.full((360, 480), 3, np.uint8)
    noise = np.random.default_rng(3).integers(0, 255, (2, *dark.shape), np.uint8)
    assert said(coarse(*KEPT), dark, dark) is None
    assert said(coarse(*KEPT), *noise) is None


@pytest.mark.parametrize(("wide_px", "long"), [(54, False), (58, True)])
def test_an_axis_is_a_way_from_one_and_two_fifths_of_the_width_on(wide_px: int, long: bool) -> None:
    lit = np.zeros((60, 80), bool)
    lit[10:50, 10 : 10 + wide_px] = True
    axis = long_axis(lit.T)
    assert (long_axis(lit) is not None, axis is not None) == (long, long)
    assert axis is None or abs(axis[1]) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("share", "aside_mm", "way"),
    [
        (LEAST_GOOD - 0.01, 13.0, 1.0), (LEAST_GOOD, 13.0, None), (MOST_GOOD, 13.0, None), (MOST_GOOD + 0.01, 13.0, -1.0),
        (MOST_GOOD + 0.01, 11.0, None),
    ],
)  # fmt: skip
def test_the_way_leads_to_the_kept_view_or_away_from_it(share: float, aside_mm: float, way: float | None) -> None:
    centre = np.array([[(SIGHT.camera.width_px - 1) / 2.0, (SIGHT.camera.height_px - 1) / 2.0]])
    middle = np.append(SIGHT.directions(centre, 550.0)[0] * 550.0, 550.0)
    found = Guide(SIGHT)._direction_to_good_view(np.ones((60, 80), bool), middle[None] + (aside_mm, 0.0, 0.0), share)
    assert (found is None) == (way is None)
    assert found is None or found == pytest.approx((way, 0.0), abs=1e-6)


@pytest.mark.parametrize(("kept_dn", "dn", "lit"), [(100, 52, True), (100, 48, False), (12, 9, True), (12, 7, False)])
def test_a_cell_is_lit_by_half_of_what_the_kept_scans_faintest_points_had(kept_dn: int, dn: int, lit: bool) -> None:
    points = np.full((120, 160, 3), 500.0, np.float32)
    picture = np.full((480, 640), kept_dn, np.uint8)
    kept = CoarseView(points, points[..., 0], 4, (picture, picture), 1.0, PROJECTION)
    here = picture.copy()
    here[:40, :80] = dn
    found = Guide(SIGHT)._surface_cells(kept, here)
    assert found.shape == (60, 80)
    assert bool(found[:5, :10].any()) is lit
    assert found[6:, 12:].all()
