"""What both lenses do beyond their coefficients is found from boards in air, with a covariance that holds for boards not used."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.calibration.air.adjustment import NO_PORT
from appliance.calibration.air.free_form import adjust_with_field
from appliance.calibration.air.linearised import BoardView
from appliance.calibration.field import AIR_VALUES, INTERVALS, AirField
from appliance.optics.correction import basis_matrix, node_count
from appliance.optics.model import HousedCamera, StereoRig
from appliance.optics.pinhole import Lens
from appliance.optics.rotation import matrix3

Array = NDArray[np.float64]
SIZE_PX = (1600, 1200)
F_PX, TURN_RAD, BASE_MM = 2400.0, np.array([0.0, -0.42, 0.0]), np.array([225.0, 2.0, 40.0])
NOISE_PX, BOW_MM, SCALE_SD = 0.02, 0.06, 4e-4
NODES = node_count(INTERVALS)


def field_px(eye: int, uv: Array) -> Array:
    """What the lens of each eye does beyond its coefficients: waves that no polynomial of theirs makes, up to 0.15 px."""
    x, y = uv[:, 0] / 1600.0, uv[:, 1] / 1600.0
    if eye == 0:
        return 0.15 * np.stack([np.sin(9.0 * x + 1.0) * np.cos(5.0 * y), 0.8 * np.cos(7.0 * (x + y))], 1)
    return 0.15 * np.stack([np.cos(8.0 * y - 2.0 * x), 0.7 * np.sin(10.0 * x) * np.sin(6.0 * y + 0.5)], 1)


def turned(vector: Array) -> Array:
    return np.asarray(cv2.Rodrigues(np.asarray(vector, np.float64))[0])


def by_opencv(points: Array, values: Array) -> list[Array]:
    """Pixels (n, 2) of both cameras without fields; ``values``: the 22 changes of the rig."""
    found = []
    for eye, (R, t) in enumerate(
        ((np.eye(3), np.zeros(3)), (turned(TURN_RAD) @ turned(values[16:19]), BASE_MM + values[19:22]))
    ):
        f, u, v, *bends = values[8 * eye : 8 * eye + 8]
        matrix = np.array([[F_PX + f, 0.0, 799.5 + u], [0.0, F_PX + f, 599.5 + v], [0.0, 0.0, 1.0]])
        seen, _ = cv2.projectPoints(points, cv2.Rodrigues(R.T)[0], -R.T @ t, matrix, np.array(bends))
        found.append(np.asarray(seen, np.float64).reshape(-1, 2))
    return found


def board(rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Corners (154, 3) and the place of one of the boards."""
    x, y = np.meshgrid((np.arange(14) - 6.5) * 18.0, (np.arange(11) - 5.0) * 18.0)
    place = turned(rng.uniform([-0.5, -0.5, -3.0], [0.5, 0.5, 3.0]))
    shift = np.array([rng.uniform(60.0, 140.0), rng.uniform(-30.0, 30.0), rng.uniform(470.0, 600.0)])
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]), place, shift


def as_seen(corners: Array, place: Array, shift: Array) -> list[Array]:
    """Where both cameras with their fields see a flat board: pixel u is where u − field(u) is that of the coefficients."""
    found = []
    for eye, ideal in enumerate(by_opencv(corners @ place.T + shift, np.zeros(22))):
        uv = ideal.copy()
        for _ in range(20):
            uv = ideal + field_px(eye, uv)
        found.append(uv)
    return found


def inside(uv: list[Array]) -> NDArray[np.bool_]:
    """Which corners lie in both images."""
    return np.asarray(np.all([(one >= 0.0) & (one <= np.array(SIZE_PX) - 1.0) for one in uv], axis=(0, 2)))


@dataclass(frozen=True)
class Case:
    rig: StereoRig
    places: list[tuple[Array, Array]]
    views: list[BoardView]

    def found(self, scale_sd: float, noise_px: float) -> AirField:
        return adjust_with_field(self.rig, self.places, self.views, np.zeros(5), BOW_MM, scale_sd, noise_px)


def drawn() -> Case:
    """Twelve boards, bent by the bow that is allowed, as the cameras see them with a little noise."""
    rng = np.random.default_rng(20_001)
    places, views = [], []
    for k in range(12):
        corners, place, shift = board(rng)
        bent = corners.copy()
        bent[:, 2] = 0.05 * (1.0 - 2.0 * np.sum((corners[:, :2] / 117.0) ** 2, axis=1))
        left, right = (uv + rng.normal(0.0, NOISE_PX, uv.shape) for uv in as_seen(bent, place, shift))
        keep = inside([left, right])
        views.append(BoardView(f"board {k}", corners[keep], left[keep], right[keep]))
        places.append((place, shift))
    lens = Lens((F_PX, F_PX), (799.5, 599.5))
    right_camera = HousedCamera(*SIZE_PX, lens, NO_PORT, matrix3(turned(TURN_RAD)), (225.0, 2.0, 40.0))
    return Case(StereoRig(HousedCamera(*SIZE_PX, lens, NO_PORT), right_camera), places, views)


@pytest.fixture(scope="module")
def case() -> Case:
    return drawn()


@pytest.fixture(scope="module")
def sure(case: Case) -> AirField:
    """The field with a print whose scale is known."""
    return case.found(0.0, 3.0 * NOISE_PX)


def slopes(function: Callable[[Array], Array], at: Array, steps: Array) -> Array:
    return np.stack([(function(at + s) - function(at - s)) / (2.0 * s.sum()) for s in np.diag(steps)], 1)


def of_boards_not_used(field: AirField | None) -> tuple[float, float]:
    """RMS by which boards that were not used are seen elsewhere than computed, in px, and what the covariance makes expect of
    it. Each board's place is fitted."""
    values = np.zeros(AIR_VALUES) if field is None else np.array(field.mean[:AIR_VALUES])
    nodes = np.zeros(4 * NODES) if field is None else np.array(field.mean[AIR_VALUES:])
    squares, variances, count = 0.0, 0.0, 0
    rng = np.random.default_rng(20_002)
    for _ in range(4):
        off, by_all, by_place = of_board(*board(rng), values, nodes)
        aside = np.eye(len(off)) - by_place @ np.linalg.pinv(by_place)
        squares += float(np.sum((aside @ off) ** 2))
        count += len(off) - 6
        if field is not None:
            J = aside @ by_all
            variances += float(np.sum((J @ field.covariance) * J))
    return float(np.sqrt(squares / count)), float(np.sqrt(variances / count))


def of_board(corners: Array, place: Array, shift: Array, values: Array, nodes: Array) -> tuple[Array, Array, Array]:
    """Seen less computed (4 n,), and the slopes of what is computed by values and nodes and by the board's place."""
    uv = as_seen(corners, place, shift)
    keep = inside(uv)
    corners, uv = corners[keep], [one[keep] for one in uv]

    def computed(v: Array, moved: Array) -> Array:
        points = corners @ (place @ turned(moved[:3])).T + shift + moved[3:]
        return np.concatenate(by_opencv(points, v)).ravel()

    there = np.zeros(6)
    steps = np.array([1e-2, 1e-2, 1e-2, 1e-4, 1e-4, 1e-5, 1e-5, 1e-4] * 2 + [1e-5] * 3 + [1e-2] * 3)
    by_values = slopes(lambda v: computed(v, there), values, steps)
    by_place = slopes(lambda m: computed(values, m), there, np.array([1e-5] * 3 + [1e-2] * 3))
    n = 2 * len(corners)
    by_nodes = np.zeros((2 * n, 4 * NODES))
    for block in range(4):  # left across, left down, right across, right down
        eye, component = divmod(block, 2)
        rows = slice(n * eye + component, n * (eye + 1), 2)
        by_nodes[rows, block * NODES : (block + 1) * NODES] = basis_matrix(uv[eye], SIZE_PX, INTERVALS)
    off = np.concatenate(uv).ravel() - computed(values, there) - by_nodes @ nodes
    return off, np.concatenate([by_values, by_nodes], 1), by_place


def test_boards_that_were_not_used_are_seen_where_the_field_says_within_its_covariance(sure: AirField) -> None:
    plain, _ = of_boards_not_used(None)
    assert plain > 0.06, "a field that does nothing proves nothing"
    left, expected = of_boards_not_used(sure)
    assert left < 0.005
    assert left / expected == pytest.approx(1.0, abs=0.3)


def test_the_scale_of_the_print_is_doubt_of_the_base_and_of_nothing_else(case: Case, sure: AirField) -> None:
    unsure = case.found(SCALE_SD, 3.0 * NOISE_PX)
    assert unsure.mean == sure.mean
    more = unsure.covariance - sure.covariance
    # A larger print makes everything larger: the base grows with it, and no picture shows it.
    assert more[19:22, 19:22] == pytest.approx(SCALE_SD**2 * np.outer(BASE_MM, BASE_MM), rel=0.01, abs=5e-6)
    # Beside its own variance: how the inverse of a large matrix is rounded depends on the processor.
    grown = np.abs(np.diag(more)) / np.diag(sure.covariance)
    assert grown[:19].max() < 1e-6
    assert grown[22:].max() < 1e-6
    assert grown[19] > 1.0, "what the print's scale does to the base is millions of times that"
