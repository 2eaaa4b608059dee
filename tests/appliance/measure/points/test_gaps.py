"""The gaps of a scan are read from its images as they are, whatever the quality limits think of the points."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from appliance.measure.calibration.file import Calibration
from appliance.measure.calibration.gaps import signed_gap_mm
from appliance.measure.calibration.parameters import RIG_PARAMETERS
from appliance.measure.cloud import PatchGaps
from appliance.measure.light.patterns import build_sequence
from appliance.measure.points.pipeline import Cloud, Pipeline
from tests.support import synthetic

SEQUENCE = build_sequence(16)
CALIBRATION = synthetic.calibration()
INDEX = CALIBRATION.water.index
NORMAL = np.array([0.1, -0.15, 1.0]) / np.linalg.norm([0.1, -0.15, 1.0])
OFFSET = float(NORMAL @ CALIBRATION.rig.volume_centre_mm(INDEX))


@pytest.fixture(scope="module")
def images() -> dict[str, np.ndarray]:
    return synthetic.wall(CALIBRATION, SEQUENCE, NORMAL)


def turned(pitch_deg: float, roll_deg: float) -> Calibration:
    """A calibration whose right camera is elsewhere than the one that took the images."""
    x = np.zeros(RIG_PARAMETERS.count)
    x[22], x[24] = math.radians(pitch_deg), math.radians(roll_deg)
    return replace(CALIBRATION, rig=RIG_PARAMETERS.changed(CALIBRATION.rig, x))


def cloud(images: dict[str, np.ndarray], calibration: Calibration) -> Cloud:
    with Pipeline(calibration, CALIBRATION.water, SEQUENCE) as pipeline:
        synthetic.push_all(pipeline, images)
        assert pipeline.coarse().gaps is None
        return pipeline.full()


def exact_um(other: Calibration, patch: int) -> float:
    """Return a patch's mean gap in closed form: a lattice of left pixels, its points on the plane, seen by the true right camera."""
    v, u = np.mgrid[2:50:5, 0:50:5].reshape(2, -1) + 50 * np.array(divmod(patch, 8))[:, None]
    points = synthetic.plane_points(CALIBRATION.rig.left, NORMAL, OFFSET)[v, u]
    right = CALIBRATION.rig.right.project(points, INDEX)
    return 1000.0 * float(signed_gap_mm(other.rig, INDEX, np.stack([u, v], -1).astype(float), right).mean())


def test_every_patch_has_the_gap_of_the_exact_rays(images: dict[str, np.ndarray]) -> None:
    other = turned(pitch_deg=0.02, roll_deg=0.03)
    gaps = cloud(images, other).gaps
    assert gaps is not None
    assert len(gaps.patch) > 0.6 * PatchGaps.COUNT
    inner = [k for k, p in enumerate(gaps.patch) if 0 < p % 8 < 7 and 0 < p // 8 < 5]
    assert len(inner) >= 20
    for k in inner:
        assert gaps.gap_um[k] == pytest.approx(exact_um(other, gaps.patch[k]), abs=4.0 * gaps.noise_um[k] + 1.0)
    assert np.ptp(gaps.gap_um) > 40.0, "the roll is a slope across the image"


def test_a_knock_that_leaves_no_point_is_still_measured(images: dict[str, np.ndarray]) -> None:
    """0.05° of pitch opens every ray gap beyond the limit of 0.25 mm: the cloud is empty, the evidence is not."""
    other = turned(pitch_deg=0.05, roll_deg=0.0)
    found = cloud(images, other)
    assert found.summary.points == 0
    assert found.gaps is not None
    assert len(found.gaps.patch) > 0.6 * PatchGaps.COUNT
    assert float(np.median(np.abs(found.gaps.gap_um))) == pytest.approx(460.0, rel=0.05)
    # Far beyond noise, the length of the rays' common normal shows; in a corner most.
    exact = [exact_um(other, patch) for patch in found.gaps.patch]
    np.testing.assert_allclose(found.gaps.gap_um, exact, rtol=0.005)
