"""Patches laid upon a plane whose distance, paint and noise are known in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.measure.overlap.albedo import Texture
from appliance.measure.overlap.fine import PreparedScan, correspond
from appliance.measure.overlap.patches import Patches, Projection
from appliance.measure.overlap.rigid import Rigid

BLOCK_PX, F_PX, DEPTH_MM = 4, 200.0, 500.0
ROWS, COLUMNS = 15, 20
PITCH_MM = BLOCK_PX * DEPTH_MM / F_PX
GRADIENT = np.array([0.003, -0.002, 0.0])
"""Of the paint, per mm, in the frame of A."""
SHIFT_MM = np.array([12.0, -7.0, 0.3])
"""From B's frame to A's: 1.2 patches across, 0.7 up, and 0.3 mm behind A's plane."""


def pinhole() -> Projection:
    """The image of a camera without refraction, whose polynomial is linear."""
    terms = np.zeros((20, 2))
    terms[0] = 0.5 * (BLOCK_PX * COLUMNS - 1), 0.5 * (BLOCK_PX * ROWS - 1)
    terms[1, 0] = terms[2, 1] = F_PX
    return Projection(terms, np.zeros(3), np.ones(3), (BLOCK_PX * ROWS, BLOCK_PX * COLUMNS))


def plane(sigma_mm: float, noise: float, moved_mm: NDArray[np.float64]) -> PreparedScan:
    """A plane that faces its camera, with the paint of A seen from ``moved_mm``."""
    row, column = np.mgrid[0:ROWS, 0:COLUMNS].astype(np.float64)
    middle = np.stack([column - 0.5 * (COLUMNS - 1), row - 0.5 * (ROWS - 1)], -1) * PITCH_MM
    centre = np.concatenate([middle, np.full((ROWS, COLUMNS, 1), DEPTH_MM)], -1)
    shape = (ROWS, COLUMNS)
    normal = np.broadcast_to([0.0, 0.0, -1.0], (*shape, 3)).copy()
    patches = Patches(
        centre, normal, np.full(shape, sigma_mm), np.zeros(shape), np.full(shape, noise), BLOCK_PX, pinhole()
    )
    value = (centre + moved_mm) @ GRADIENT
    return PreparedScan(patches, Texture(value, np.broadcast_to(GRADIENT, (*shape, 3)).copy(), np.full(shape, noise)))


A, B = plane(0.02, 0.01, np.zeros(3)), plane(0.03, 0.024, SHIFT_MM)
POSE = Rigid(np.eye(3), SHIFT_MM)


def changed(of: PreparedScan, row: int, column: int, **fields: object) -> PreparedScan:
    """A scan with one patch that is another one."""
    patches = of.patches
    for name, value in fields.items():
        array = getattr(patches, name).copy()
        array[row, column] = value
        patches = replace(patches, **{name: array})
    return replace(of, patches=patches)


def test_distance_paint_and_noise_of_every_patch_are_those_of_the_planes() -> None:
    laid = correspond(A, B, POSE, 1.0)
    # Of A's cells those between the first and the last but one: B's columns 0 … 17, and rows 2 … 14.
    wanted = np.add.outer(COLUMNS * np.arange(2, 15), np.arange(18)).ravel()
    np.testing.assert_array_equal(laid.source, wanted)
    assert laid.tested == len(wanted)
    np.testing.assert_allclose(laid.x_mm, B.patches.centre_mm.reshape(-1, 3)[wanted] + SHIFT_MM)
    np.testing.assert_allclose(laid.distance_mm, -0.3, atol=1e-12, err_msg="behind A's plane, against its normal")
    np.testing.assert_allclose(laid.normal_a, np.broadcast_to([0.0, 0.0, -1.0], laid.normal_a.shape))
    np.testing.assert_allclose(laid.normal_b, laid.normal_a)
    np.testing.assert_allclose(laid.sigma_mm, np.hypot(0.02, 0.03))
    # The same paint at the same place, and from cell to cell exactly by its gradient.
    np.testing.assert_allclose(laid.texture_a, laid.x_mm @ GRADIENT, atol=1e-12)
    np.testing.assert_allclose(laid.texture_b, laid.x_mm @ GRADIENT, atol=1e-12)
    np.testing.assert_allclose(laid.texture, 0.0, atol=1e-12)
    np.testing.assert_allclose(laid.texture_noise, np.hypot(0.01, 0.024))
    np.testing.assert_allclose(laid.gradient_a, np.broadcast_to(GRADIENT, laid.gradient_a.shape))
    np.testing.assert_allclose(laid.gradient_b, laid.gradient_a)
    assert not laid.missing.any()
    assert not laid.front.any()
    # Tiles of 15 mm: two patches of 10 mm are nearer to it than one.
    row, column = np.divmod(wanted, COLUMNS)
    np.testing.assert_array_equal(laid.tile, row // 2 * 1000 + column // 2)


def test_a_turn_takes_normals_and_gradients_along() -> None:
    angle = 0.02
    turn = np.array([[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]])
    middle = np.array([0.0, 0.0, DEPTH_MM])
    laid = correspond(A, B, Rigid(turn, middle - turn @ middle), 5.0)
    np.testing.assert_allclose(laid.normal_b, np.broadcast_to(turn @ [0.0, 0.0, -1.0], laid.normal_b.shape))
    np.testing.assert_allclose(laid.gradient_b, np.broadcast_to(turn @ GRADIENT, laid.gradient_b.shape))
    # Along the mean of both normals, from where the ray to the patch meets A: the mean of the four cells around.
    met = laid.x_mm * (DEPTH_MM / laid.x_mm[:, 2:])
    assert laid.distance_mm == pytest.approx(
        0.5 * ((laid.normal_a + laid.normal_b) * (laid.x_mm - met)).sum(1), abs=1e-9
    )


def place(index: int) -> int:
    """Where B's patch of that flat index stands among those that are tried."""
    wanted = np.add.outer(COLUMNS * np.arange(2, 15), np.arange(18)).ravel()
    return int(np.flatnonzero(wanted == index)[0])


def test_what_lies_before_the_surface_behind_it_or_over_nothing_meets_nothing_and_is_told_apart() -> None:
    row, column = 7, 9
    index = row * COLUMNS + column
    beside = B.patches.centre_mm[row, column]
    for depth_mm, front in ((DEPTH_MM - 5.0, True), (DEPTH_MM - 1.5, True), (DEPTH_MM + 5.0, False)):
        laid = correspond(A, changed(B, row, column, centre_mm=beside * (depth_mm / DEPTH_MM)), POSE, 1.0)
        assert index not in laid.source
        assert np.flatnonzero(laid.front).tolist() == ([place(index)] if front else [])
        assert not laid.missing.any()
    # Within the gate it is met, whatever side it lies on; of the front only what is beyond the gate.
    laid = correspond(A, changed(B, row, column, centre_mm=beside * ((DEPTH_MM - 5.0) / DEPTH_MM)), POSE, 9.0)
    assert laid.distance_mm[np.flatnonzero(laid.source == index)] == pytest.approx([4.7], abs=1e-6)
    assert not laid.front.any()
    # A hole of A's, of four cells: the patch that lies over all of them meets nothing; its neighbours do.
    nothing = A.patches.centre_mm.copy()
    column_a, row_a = column + 1, row - 1
    nothing[row_a : row_a + 2, column_a : column_a + 2] = np.nan
    hole = replace(A, patches=replace(A.patches, centre_mm=nothing))
    laid = correspond(hole, B, POSE, 1.0)
    assert np.flatnonzero(laid.missing).tolist() == [place(index)]
    assert not laid.front.any()
    assert index not in laid.source
    assert laid.distance_mm == pytest.approx(-0.3), "what is left of the four cells says it alone"
    assert laid.sigma_mm == pytest.approx(np.hypot(0.02, 0.03))


def test_patches_that_stand_otherwise_or_are_seen_from_behind_are_left_out() -> None:
    row, column = 7, 9
    index = row * COLUMNS + column
    for lean, tried, met in (
        (0.5, True, True),
        (0.7, True, False),
        (0.9, True, False),
        (1.35, False, False),
        (3.0, False, False),
    ):
        laid = correspond(A, changed(B, row, column, normal=[np.sin(lean), 0.0, -np.cos(lean)]), POSE, 1.0)
        assert (laid.tested == 18 * 13) is tried, lean
        assert (index in laid.source) is met, lean


def test_paint_that_either_does_not_know_is_unknown_and_the_distance_stays() -> None:
    row, column = 7, 9
    index = row * COLUMNS + column
    unknown = B.texture.value.copy()
    unknown[row, column] = np.nan
    laid = correspond(A, replace(B, texture=replace(B.texture, value=unknown)), POSE, 1.0)
    mine = laid.source == index
    np.testing.assert_array_equal(np.isnan(laid.texture), mine)
    np.testing.assert_array_equal(np.isnan(laid.texture_noise), mine)
    np.testing.assert_array_equal(laid.gradient_a[mine], np.zeros((1, 3)))
    np.testing.assert_array_equal(laid.gradient_b[mine], np.zeros((1, 3)))
    assert laid.distance_mm == pytest.approx(-0.3)
    brighter = correspond(A, replace(B, texture=replace(B.texture, value=B.texture.value + 0.25)), POSE, 1.0)
    np.testing.assert_allclose(brighter.texture, -0.25, atol=1e-12)
    # B's rows lie 0.7 above A's: without one of A's rows, 0.3 of the weight is left to the next one, 0.7 to its own.
    value = A.texture.value.copy()
    value[row, :] = np.nan
    laid = correspond(replace(A, texture=replace(A.texture, value=value)), B, POSE, 1.0)
    np.testing.assert_array_equal(np.isnan(laid.texture), laid.source // COLUMNS == row + 1)
    assert laid.texture_a[laid.source // COLUMNS == row] == pytest.approx(
        laid.x_mm[laid.source // COLUMNS == row] @ GRADIENT
    )
    assert laid.distance_mm == pytest.approx(-0.3)
    assert laid.texture_noise[~np.isnan(laid.texture)] == pytest.approx(np.hypot(0.01, 0.024))


def test_a_patch_is_met_where_nearly_half_of_the_weight_around_it_is_there() -> None:
    row, column = 7, 9
    index = row * COLUMNS + column
    # The four cells of A around it weigh 0.56 and 0.14 above, 0.24 and 0.06 below.
    above, below = row - 1, row
    for lost, met in (
        (((above, column + 2), (below, column + 1)), True),
        (((above, column + 1),), False),
        (((above, column + 2), (below, column + 1), (below, column + 2)), True),
    ):
        centre = A.patches.centre_mm.copy()
        for cell in lost:
            centre[cell] = np.nan
        laid = correspond(replace(A, patches=replace(A.patches, centre_mm=centre)), B, POSE, 1.0)
        assert (index in laid.source) is met, lost
        assert not laid.missing.any()
