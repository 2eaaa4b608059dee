"""What both lenses do beyond their coefficients is found from boards in air, with a covariance that holds for boards not used."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.calibrate.air.adjustment import adjust_with_field
from appliance.calibrate.air.calibrate import NO_PORT
from appliance.calibrate.air.linearised import SHAPES, BoardView, bend_of, linearise_view, rig_steps
from appliance.calibrate.field import FIELD_CELLS
from appliance.measure.calibration.field import AIR_VALUES, AirField
from appliance.measure.calibration.parameters import RIG_PARAMETERS
from appliance.measure.light.correction import SplineGrid, node_count
from appliance.measure.light.model import HousedCamera, StereoRig
from appliance.measure.light.pinhole import Lens
from appliance.measure.light.rotation import matrix3

Array = NDArray[np.float64]
SIZE_PX = (1600, 1200)
NOISE_PX, BOW_MM, SCALE_SD = 0.02, 0.06, 4e-4
NODES = node_count(FIELD_CELLS)


def turned(vector: Array) -> Array:
    return np.asarray(cv2.Rodrigues(np.asarray(vector, np.float64))[0])


LENS = Lens((2400.0, 2400.0), (799.5, 599.5))
TURN, BASE_MM = turned(np.array([0.0, -0.42, 0.0])), np.array([225.0, 2.0, 40.0])
RIG = StereoRig(HousedCamera(*SIZE_PX, LENS, NO_PORT), HousedCamera(*SIZE_PX, LENS, NO_PORT, matrix3(TURN), (225.0, 2.0, 40.0)))  # fmt: skip


def field_px(eye: int, uv: Array) -> Array:
    """What the lens of each eye does beyond its coefficients: waves that no polynomial of theirs makes, up to 0.15 px."""
    x, y = uv[:, 0] / 1600.0, uv[:, 1] / 1600.0
    if eye == 0:
        return 0.15 * np.stack([np.sin(9.0 * x + 1.0) * np.cos(5.0 * y), 0.8 * np.cos(7.0 * (x + y))], 1)
    return 0.15 * np.stack([np.cos(8.0 * y - 2.0 * x), 0.7 * np.sin(10.0 * x) * np.sin(6.0 * y + 0.5)], 1)


def board(rng: np.random.Generator, bow_mm: float, noise_px: float) -> tuple[BoardView, tuple[Array, Array]]:
    """A board of 154 corners somewhere, as both cameras with their fields see it: pixel u is where u − field(u) is that of the
    coefficients."""
    x, y = np.meshgrid((np.arange(14) - 6.5) * 18.0, (np.arange(11) - 5.0) * 18.0)
    corners = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    place = turned(rng.uniform([-0.5, -0.5, -3.0], [0.5, 0.5, 3.0]))
    shift = np.array([rng.uniform(60.0, 140.0), rng.uniform(-30.0, 30.0), rng.uniform(470.0, 600.0)])
    bent = corners.copy()
    bent[:, 2] = bow_mm * (1.0 - 2.0 * np.sum((corners[:, :2] / 117.0) ** 2, axis=1))
    matrix = np.array([[2400.0, 0.0, 799.5], [0.0, 2400.0, 599.5], [0.0, 0.0, 1.0]])
    seen = []
    for eye, (R, t) in enumerate(((np.eye(3), np.zeros(3)), (TURN, BASE_MM))):
        points = bent @ place.T + shift
        ideal, _ = cv2.projectPoints(points, cv2.Rodrigues(R.T)[0], -R.T @ t, matrix, np.zeros(5))
        uv = ideal = np.asarray(ideal, np.float64).reshape(-1, 2)
        for _ in range(20):
            uv = ideal + field_px(eye, uv)
        seen.append(uv + rng.normal(0.0, noise_px, uv.shape))
    keep = np.all([(one >= 0.0) & (one <= np.array(SIZE_PX) - 1.0) for one in seen], axis=(0, 2))
    return BoardView("board", corners[keep], seen[0][keep], seen[1][keep]), (place, shift)


@cache
def found(scale_sd: float) -> AirField:
    """The field of twelve boards, bent by the bow that is allowed, with a print whose scale is so unsure."""
    rng = np.random.default_rng(20_001)
    views, places = zip(*(board(rng, 0.05, NOISE_PX) for _ in range(12)), strict=True)
    # A few corners that the left camera alone sees.
    alone = [np.arange(len(view.corners_mm)) < 10 for view in views]
    views = tuple(
        replace(v, right_px=np.where(rows[:, None], np.nan, v.right_px)) for v, rows in zip(views, alone, strict=True)
    )
    alike = [np.repeat(np.concatenate([np.ones(len(rows)), ~rows]), 2) for rows in alone]
    return adjust_with_field(RIG, places, views, np.zeros(SHAPES), BOW_MM, scale_sd, 3.0 * NOISE_PX, alike)


def of_boards_not_used(field: AirField | None) -> tuple[float, float]:
    """RMS by which flat boards that were not used are seen elsewhere than computed, in px, and what the covariance makes expect of
    it. Each board's place is fitted."""
    mean = np.zeros(AIR_VALUES + 4 * NODES) if field is None else np.array(field.mean)
    values = np.zeros(RIG_PARAMETERS.count)
    values[RIG_PARAMETERS.air] = mean[:AIR_VALUES]
    squares, variances, count = 0.0, 0.0, 0
    rng = np.random.default_rng(20_002)
    for _ in range(4):
        view, place = board(rng, 0.0, 0.0)
        changed = rig_steps(RIG, values[RIG_PARAMETERS.air])
        now = linearise_view(
            RIG_PARAMETERS.changed(RIG, values), changed, place, view, bend_of([view]), np.zeros(SHAPES)
        )
        by_nodes = np.zeros((len(now.residual), 4 * NODES))
        for block in range(4):  # left across, left down, right across, right down
            eye, component = divmod(block, 2)
            half = len(now.residual) // 2
            rows = slice(half * eye + component, half * (eye + 1), 2)
            seen = (view.left_px, view.right_px)[eye]
            by_nodes[rows, block * NODES : (block + 1) * NODES] = SplineGrid(SIZE_PX, FIELD_CELLS).matrix(seen)
        aside = np.eye(len(now.residual)) - now.by_pose @ np.linalg.pinv(now.by_pose)
        squares += float(np.sum((aside @ (now.residual - by_nodes @ mean[AIR_VALUES:])) ** 2))
        count += len(now.residual) - 6
        if field is not None:
            J = aside @ np.concatenate([now.by_rig[:, :AIR_VALUES], by_nodes], 1)
            variances += float(np.sum((J @ field.covariance) * J))
    return float(np.sqrt(squares / count)), float(np.sqrt(variances / count))


def test_boards_that_were_not_used_are_seen_where_the_field_says_within_its_covariance() -> None:
    plain, _ = of_boards_not_used(None)
    assert plain > 0.06, "a field that does nothing proves nothing"
    left, expected = of_boards_not_used(found(0.0))
    assert left < 0.005
    assert left / expected == pytest.approx(1.0, abs=0.3)


def test_the_scale_of_the_print_is_doubt_of_the_base_and_of_nothing_else() -> None:
    sure, unsure = found(0.0), found(SCALE_SD)
    assert unsure.mean == sure.mean
    more = unsure.covariance - sure.covariance
    # A larger print makes everything larger: the base grows with it, and no picture shows it.
    assert more[19:22, 19:22] == pytest.approx(SCALE_SD**2 * np.outer(BASE_MM, BASE_MM), rel=0.01, abs=5e-6)
    # Beside its own variance: how the inverse of a large matrix is rounded depends on the processor.
    grown = np.abs(np.diag(more)) / np.diag(sure.covariance)
    assert grown[:19].max() < 1e-6
    assert grown[22:].max() < 1e-6
    assert grown[19] > 1.0, "what the print's scale does to the base is millions of times that"
