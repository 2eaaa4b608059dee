"""The cloud is shown as the camera saw it: right way round, near before far, no point invented."""

from __future__ import annotations

from collections.abc import Iterator

import moderngl
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.instrument.screens.cloud import MAX_POINTS, CloudPainter, Relief, spread, thin
from appliance.instrument.screens.theme import colour_table

Cloud = NDArray[np.float32]


class Stage:
    def __init__(self, context: moderngl.Context) -> None:
        self.target = context.framebuffer([context.renderbuffer((300, 200), 4)])
        self.cloud = CloudPainter(context, (300, 200))

    def picture(
        self, points: Cloud, values: NDArray[np.float32] | None = None, time_s: float = 0.0, turn: int = 0
    ) -> NDArray[np.uint8]:
        """(200, 300, 3) uint8 RGB; the background is black."""
        self.cloud.show(points, points[:, 2].copy() if values is None else values, bright_is_high=False)
        self.target.use()
        self.target.clear()
        self.cloud.draw(self.target, (0, 0, 300, 200), time_s, turn)
        return np.frombuffer(self.target.read(components=3, alignment=1), np.uint8).reshape(200, 300, 3)


@pytest.fixture
def stage(context: moderngl.Context) -> Iterator[Stage]:
    with context:
        made = Stage(context)
        yield made
        made.cloud.close()
        made.target.release()


def plane(z_mm: float = 500.0, pitch_mm: float = 1.0, half_mm: float = 60.0) -> Cloud:
    line = np.arange(-half_mm, half_mm, pitch_mm)
    x, y = np.meshgrid(line, line)
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, z_mm)], axis=1).astype(np.float32)


def lit(picture: NDArray[np.uint8]) -> NDArray[np.bool_]:
    return np.asarray(picture.max(axis=2) > 0)


def test_x_goes_right_and_y_goes_down(stage: Stage) -> None:
    points = plane()
    quarter = points[(points[:, 0] < 0) | (points[:, 1] < 0)]  # the lower right quarter is missing
    seen = lit(stage.picture(quarter))
    assert [bool(seen[at]) for at in ((130, 180), (130, 120), (70, 180), (70, 120))] == [False, True, True, True]


def test_near_hides_far_whatever_the_order(stage: Stage) -> None:
    near, far = plane(470.0, half_mm=20.0), plane(530.0)
    for points in (np.concatenate([near, far]), np.concatenate([far, near])):
        values = np.where(points[:, 2] < 500, 0.0, 1.0).astype(np.float32)
        middle, edge = stage.picture(points, values)[[100, 60], [150, 100]].astype(int)
        assert middle.sum() > 1.5 * edge.sum()  # the bright end of the colours is the low end


def test_what_lies_behind_an_edge_is_in_its_shadow(stage: Stage) -> None:
    points = np.concatenate([plane(470.0, half_mm=20.0), plane(530.0)])
    row = stage.picture(points, np.where(points[:, 2] < 500, 0.0, 1.0).astype(np.float32))[100].astype(int).sum(axis=1)
    assert row[85] == row[110] > 0
    assert 0 < row[85:150].min() < 0.9 * row[85]


def test_a_closed_surface_has_no_holes_and_a_hole_stays_one(stage: Stage) -> None:
    points = plane()
    whole = lit(stage.picture(points))
    rows, columns = np.nonzero(whole)
    inside = whole[rows.min() + 4 : rows.max() - 4, columns.min() + 4 : columns.max() - 4]
    assert inside.all()
    pierced = lit(stage.picture(points[np.hypot(points[:, 0], points[:, 1]) > 12]))
    assert not pierced[95:105, 145:155].any()


def test_it_turns_gently_and_comes_back(stage: Stage) -> None:
    points = plane()
    points[:, 2] += points[:, 0] * 0.3
    at_rest, turned, back = (stage.picture(points, time_s=t).copy() for t in (0.0, 2.75, 11.0 * 17.0))
    assert (at_rest != turned).any(axis=2).mean() > 0.05
    np.testing.assert_array_equal(at_rest, back)


def test_the_divers_steps_turn_it_to_either_side(stage: Stage) -> None:
    depth = plane(half_mm=40.0)
    left, straight, right = (lit(stage.picture(depth, turn=turn)) for turn in (-2, 0, 2))
    narrow, wide, other = (np.ptp(np.nonzero(seen)[1]) for seen in (left, straight, right))
    assert max(narrow, other) < 0.9 * wide
    heights = [seen[:, :150].any(axis=1).sum() - seen[:, 150:].any(axis=1).sum() for seen in (left, right)]
    assert heights[0] * heights[1] < 0  # the near side is the larger one: left for one, right for the other


@pytest.mark.parametrize("number", [10, MAX_POINTS, MAX_POINTS + 1])
def test_thinning_is_even_bounded_and_repeatable(number: int) -> None:
    chosen = thin(number)
    assert len(np.unique(chosen)) == len(chosen) == min(number, MAX_POINTS)
    assert chosen.max() < number
    np.testing.assert_array_equal(chosen, thin(number))
    quarters = np.histogram(chosen, bins=4, range=(0, number))[0]
    assert np.ptp(quarters) <= 0.02 * len(chosen) + 2


def test_colours_are_ordered_by_lightness() -> None:
    table = colour_table().astype(float)
    grey = table @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(grey) > -0.6).all()
    assert grey[-1] - grey[0] > 120


def test_the_slope_of_a_plane_is_its_slope() -> None:
    points = plane(half_mm=50.0)
    points[:, 2] += 0.2 * points[:, 0] - 0.1 * points[:, 1]
    slopes = Relief(points, points.min(axis=0), points.max(axis=0)).slopes(points)
    inner = (np.abs(points[:, :2]) < 40).all(axis=1)
    np.testing.assert_allclose(slopes[inner], np.broadcast_to((0.2, -0.1), (inner.sum(), 2)), atol=0.03)


def test_the_covered_area_leaves_holes_out() -> None:
    points = plane(half_mm=50.0)
    low, high = points.min(axis=0), points.max(axis=0)
    for part, area_mm2 in ((points, 10_000), (points[points[:, 0] * points[:, 1] > 0], 5_000)):
        assert Relief(part, low, high).area_mm2 == pytest.approx(area_mm2, rel=0.08)


def test_odd_clouds_are_drawn_all_the_same(stage: Stage) -> None:
    points = plane()
    whole = lit(stage.picture(points)).sum()
    stray = np.concatenate([points, np.array([[4000, 0, 9000]], np.float32)])
    assert lit(stage.picture(stray)).sum() > 0.9 * whole, "it does not make the cloud small"
    for few in (points[:1], points[::2000]):
        assert lit(stage.picture(few)).any()
    tall = np.ascontiguousarray(points[:, [1, 0, 2]] * np.array([0.3, 1.0, 1.0], np.float32))
    assert lit(stage.picture(tall)).sum() < 0.6 * whole, "the next one replaces the last"
    values = np.full(len(points), np.nan, np.float32)
    values[100:200] = np.linspace(0, 1, 100)
    assert spread(values) == pytest.approx((0.02, 0.98), abs=0.005)
    low, high = spread(np.full(10, 3.0, np.float32))
    assert low < 3.0 < high
    points[:50] = np.nan
    assert lit(stage.picture(points, values)).any()
    taken = stage.cloud._shown
    stage.picture(points[:], values)
    assert stage.cloud._shown is taken
    stage.picture(points, points[:, 0])  # other values of the same points
    assert stage.cloud._shown is not taken
    stage.cloud.show(points[:0], values[:0], bright_is_high=False)
    assert stage.cloud.empty
