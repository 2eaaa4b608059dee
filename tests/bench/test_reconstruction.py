"""What the product is compared with does the same work, and what is reported is what was measured."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from appliance.measure.points.pipeline import Pipeline
from bench import references
from bench.judgement import completeness_percent, false_ppm
from bench.scan_frames import ScanFrames, make_scan
from bench.stages import one_scan
from tests.support import synthetic


@pytest.fixture(scope="module")
def scan() -> ScanFrames:
    return make_scan(400, 300)


@pytest.fixture(scope="module")
def pipeline(scan: ScanFrames) -> Iterator[Pipeline]:
    """The product after that scan."""
    with Pipeline(scan.calibration, synthetic.WATER, scan.sequence) as made:
        one_scan(made, scan)
        yield made


def test_the_others_decode_the_same_coordinates_and_find_the_same_points(scan: ScanFrames, pipeline: Pipeline) -> None:
    maps = pipeline.decoded("left")
    ours = np.stack([maps.p_px, maps.q_px], -1)
    inside = np.isfinite(ours).all(-1)
    for decode in (references.numpy_decode, references.opencv_decode):
        theirs = np.stack(decode(scan.sequence, scan.frames["left"]), -1)
        assert np.quantile(np.abs(theirs - ours)[inside], 0.999) < 1e-3
    points = pipeline.full().summary.points
    assert references.reference_scan(scan) == pytest.approx(points, rel=0.03), "it masks no edges"


def test_a_point_that_is_missing_or_elsewhere_is_counted(scan: ScanFrames, pipeline: Pipeline) -> None:
    cloud = pipeline.full()
    whole = completeness_percent(scan, cloud)
    assert whole > 99.0
    half = replace(cloud, points_mm=cloud.points_mm[::2], pixel=cloud.pixel[::2])
    assert completeness_percent(scan, half) == pytest.approx(whole / 2, rel=0.02)
    assert false_ppm(scan, cloud) < 100.0
    points_mm = cloud.points_mm.copy()
    points_mm[:3, 2] += 1.2
    assert false_ppm(scan, replace(cloud, points_mm=points_mm)) == pytest.approx(3e6 / len(points_mm))
    off_the_disc = replace(cloud, pixel=np.zeros_like(cloud.pixel))
    assert false_ppm(scan, off_the_disc) == 1e6, "a pixel that sees nothing can have no true point"
