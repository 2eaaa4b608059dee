"""A slab is found from points seen through it: drawn by Fermat's principle, and one tank of water that others photographed."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from appliance.measure.light.pinhole import Lens
from tests.support.slab import fit_slab

Array = NDArray[np.float64]

LENS = Lens((2800.0, 2810.0), (1500.0, 1000.0))
TURN, MOVE_MM = Rotation.from_euler("xyz", [8.0, -15.0, 4.0], degrees=True), np.array([-150.0, -120.0, 640.0])
NORMAL = np.array([-0.19, -0.09, 1.0]) / np.sqrt(1.0 + 0.19**2 + 0.09**2)
THICKNESS_MM, DISTANCE_MM = 120.0, 60.0


def drawn(index: float, behind: float) -> tuple[Array, Array]:
    """Points of two walls of a corner, in mm, and the pixels at which they are seen: light takes the path of least time."""
    a, b = np.meshgrid(np.arange(0.0, 300.0, 30.0), np.arange(0.0, 240.0, 40.0))
    walls = [np.stack([a, b, 0.0 * a], -1), np.stack([a, 0.0 * a, -b], -1)]
    points = np.concatenate([wall.reshape(-1, 3) for wall in walls])
    end = TURN.apply(points) + MOVE_MM
    one, other = np.linalg.svd(NORMAL[None])[2][1:]
    faces = np.array([DISTANCE_MM, DISTANCE_MM + THICKNESS_MM])[:, None] * NORMAL
    # By Newton on the crossings of both faces, each by two coordinates: optical length is the sum of n |leg|, and convex.
    axes = np.stack([one, other])
    at = np.stack([(end / (end @ NORMAL)[:, None] * (face @ NORMAL)) @ axes.T for face in faces], 1)
    for _ in range(12):
        cross = [faces[k] + at[:, k] @ axes for k in (0, 1)]
        legs = [cross[0], cross[1] - cross[0], end - cross[1]]
        long = [np.linalg.norm(leg, axis=1)[:, None, None] for leg in legs]
        unit = [(leg / size[:, :, 0]) @ axes.T for leg, size in zip(legs, long, strict=True)]
        n = (1.0, index, behind)
        bent = [n[k] * (np.eye(2) - unit[k][:, :, None] * unit[k][:, None]) / long[k] for k in range(3)]
        slope = np.concatenate([n[0] * unit[0] - n[1] * unit[1], n[1] * unit[1] - n[2] * unit[2]], 1)
        curve = np.block([[bent[0] + bent[1], -bent[1]], [-bent[1], bent[1] + bent[2]]])
        at -= np.linalg.solve(curve, slope[..., None])[..., 0].reshape(-1, 2, 2)
    seen = faces[0] + at[:, 0] @ axes
    return points, seen[:, :2] / seen[:, 2:] * np.array(LENS.f_px) + np.array(LENS.c_px)


@pytest.mark.parametrize(("index", "behind"), [(1.34, 1.0), (1.52, 1.34)])
def test_a_slab_is_where_light_says_and_as_sure_as_it_says(index: float, behind: float) -> None:
    points, uv_px = drawn(index, behind)
    exact = fit_slab(LENS, points, uv_px, index, behind)
    assert exact.residual_px < 1e-6
    assert np.allclose(exact.port.normal, NORMAL, atol=1e-8)
    assert exact.port.thickness_mm == pytest.approx(THICKNESS_MM, abs=1e-4)
    assert np.allclose(exact.translation_mm, MOVE_MM, atol=1e-4)
    assert np.allclose(exact.rotation, TURN.as_matrix(), atol=1e-7)
    off = []
    for seed in range(2):
        noise_px = np.random.default_rng(seed).normal(0.0, 0.1, uv_px.shape)
        found = fit_slab(LENS, points, uv_px + noise_px, index, behind)
        assert 0.12 < found.residual_px < 0.16
        tilts = np.degrees(np.arctan(NORMAL[:2] / NORMAL[2]))
        off += [(found.port.thickness_mm - THICKNESS_MM) / found.thickness_sigma_mm]
        off += list((np.array(found.tilt_deg) - tilts) / found.tilt_sigma_deg)
        off += list((np.array(found.translation_mm) - MOVE_MM) / found.translation_sigma_mm)
        if found.distance_sigma_mm is not None:
            off += [(found.port.distance_mm - DISTANCE_MM) / found.distance_sigma_mm]
    assert 0.7 < float(np.sqrt(np.mean(np.square(off)))) < 1.4
    assert (exact.distance_sigma_mm is None) == (behind == 1.0)


def test_too_few_points_are_refused() -> None:
    points, uv_px = drawn(1.34, 1.0)
    with pytest.raises(ValueError, match="5 points; give at least 6"):
        fit_slab(LENS, points[:5], uv_px[:5], 1.34, 1.0)


@pytest.mark.skipif("KINGFISHER_REAL_PICTURES" not in os.environ, reason="KINGFISHER_REAL_PICTURES names no folder")
def test_a_tank_of_water_that_others_photographed() -> None:
    """A tank 260 mm thick, by 144 corners whose place is known; the pose that was measured in air is not told (docs/refraction.md)."""
    data = scipy.io.loadmat(str(Path(os.environ["KINGFISHER_REAL_PICTURES"]) / "refraction" / "RealData.mat"))
    (fx, _, cx), (_, fy, cy), _ = data["KK"]
    lens, points, uv_px = Lens((fx, fy), (cx, cy)), data["Pall"].T, data["CameraRays"][:2].T
    for index, least_mm in ((1.33, 255.0), (1.34, 254.0)):
        found = fit_slab(lens, points, uv_px, index, 1.0)
        turn = Rotation.from_matrix(found.rotation) * Rotation.from_matrix(data["Rgt"]).inv()
        turned_deg = float(np.degrees(turn.magnitude()))
        off_mm = float(np.linalg.norm(np.array(found.translation_mm) - data["Tgt"].ravel()))
        print(f"index {index}: {found}\npose: {turned_deg:.3f} deg and {off_mm:.2f} mm from the one measured in air")
        assert found.residual_px <= 0.48
        assert least_mm <= found.port.thickness_mm <= 261.0
        assert turned_deg < 0.1
        assert off_mm < 3.0
    # Without any slab a pinhole's pose is 86 mm off and does not explain the picture.
    bare = fit_slab(lens, points, uv_px, 1.0 + 1e-6, 1.0)
    print(
        f"pinhole: {bare.residual_px:.2f} px, {np.linalg.norm(np.array(bare.translation_mm) - data['Tgt'].ravel()):.1f} mm off"
    )
    assert bare.residual_px > 14.0
