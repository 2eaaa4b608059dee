"""Judgement of a cloud: each point against the surface that its pixel sees, and completeness."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from appliance.measure.decode.phase import phase
from appliance.measure.decode.scratch import COORDINATE, DECODING_SIZE
from appliance.measure.light.patterns import Direction
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.points.table import Cloud
from bench.result import Measurement
from bench.scan_frames import ScanFrames
from tests.support import oracle, synthetic

FALSE_MM = 1.0
"""Error of a false correspondence, thirty times the noise."""


def completeness_percent(scan: ScanFrames, cloud: Cloud) -> float:
    """Return the percentage of reconstructed pixels, of those whose point both cameras and the projector see."""
    expected = np.isfinite(scan.right_uv_px).all(-1).reshape(-1)
    return 100.0 * float(np.count_nonzero(expected[cloud.pixel])) / float(np.count_nonzero(expected))


def false_ppm(scan: ScanFrames, cloud: Cloud) -> float:
    """Return the share of points more than a millimetre from the surface of their pixel, or without one, in ppm."""
    truth_mm = scan.points_mm.reshape(-1, 3)[cloud.pixel]
    near = np.linalg.norm(cloud.points_mm - truth_mm, axis=1) <= FALSE_MM
    return 1e6 * float(np.mean(~near))


def judge_cloud(scan: ScanFrames, cloud: Cloud) -> Iterator[Measurement]:
    """Yield the figures of a cloud of a smooth surface."""
    complete = completeness_percent(scan, cloud)
    yield Measurement("completeness", complete, "%", at_least=99.5, key="completeness_percent")
    false = false_ppm(scan, cloud)
    yield Measurement("false matches (> 1 mm)", false, "ppm", at_most=100.0, key="false_matches_ppm")
    uv_px = scan.right_uv_px.reshape(-1, 2)[cloud.pixel]
    is_known = np.isfinite(uv_px).all(-1)
    found_px = scan.calibration.rig.right.project(cloud.points_mm[is_known].astype(float), synthetic.WATER.index)
    bias = float(np.abs(np.mean(found_px - uv_px[is_known], 0)).max())
    yield Measurement("bias of the correspondence", bias, "px", at_most=0.001, key="bias_px")
    off_mm = (cloud.points_mm - scan.points_mm.reshape(-1, 3)[cloud.pixel])[:, 2]
    yield Measurement("noise of the depth", float(np.nanstd(off_mm)), "mm", key="noise_mm")


def judged_at_steps(scan: ScanFrames, cloud: Cloud) -> Iterator[Measurement]:
    """Yield the figures with a bar in front; pixels at its edges are left out deliberately, wrong ones are not."""
    complete = completeness_percent(scan, cloud)
    yield Measurement("completeness with a bar in front", complete, "%", key="step_completeness_percent")
    false = false_ppm(scan, cloud)
    yield Measurement("false matches with a bar in front", false, "ppm", at_most=100.0, key="step_false_matches_ppm")


def precision(scan: ScanFrames, pipeline: Pipeline) -> Iterator[Measurement]:
    """Measure 32-bit against 64-bit arithmetic, in pattern pixels, on the same frames."""
    worst = phase_error_px(scan)
    yield Measurement("float32 against float64: wrapped phase", worst, "px", at_most=1e-5, key="float32_max_px")
    exact = oracle.decode(scan.sequence, scan.frames["left"])
    maps = pipeline.decoded("left")
    valid = np.isfinite(maps.p_px)
    stored = np.abs(np.stack([maps.p_px, maps.q_px], -1)[valid] - exact.pq[valid]).max()
    yield Measurement("the same, coordinate stored in 32 bits", float(stored), "px", key="float32_coordinate_max_px")


def phase_error_px(scan: ScanFrames) -> float:
    """Return the largest difference of our wrapped phase from float64's, in pattern px, over all pixels."""
    worst = 0.0
    for direction in (Direction.X, Direction.Y):
        i0, i1, i2, i3 = (scan.frames["left"][k] for k in scan.sequence.axis(direction).sine)
        wrapped = np.empty(i0.shape, np.float32)
        scratch = np.empty(DECODING_SIZE, np.float32)
        for y, row in enumerate(wrapped):
            phase(i0[y], i1[y], i2[y], i3[y], scratch)
            row[:] = scratch[COORDINATE : COORDINATE + row.size]
        wide = [image.astype(float) for image in (i0, i1, i2, i3)]
        exact = np.arctan2(wide[3] - wide[1], wide[0] - wide[2]) / (2.0 * np.pi)
        difference = wrapped - exact
        difference -= np.rint(difference)
        worst = max(worst, float(np.abs(difference).max()) * scan.sequence.period_px)
    return worst
