"""What the product is compared with does the same work, and what is reported is what was measured."""

from __future__ import annotations

import json
import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from appliance.reconstruct.pipeline import Pipeline
from bench import references, roofline
from bench.bench_reconstruction import judged, one_scan
from bench.picture import draw_bars
from bench.result import Measured
from bench.runner import note_latest
from bench.scan_frames import ScanFrames, make_scan
from tests.support import synthetic


@pytest.fixture(scope="module")
def scan() -> ScanFrames:
    return make_scan(400, 300)


def test_the_others_decode_the_same_coordinates(scan: ScanFrames) -> None:
    with Pipeline(scan.calibration, synthetic.WATER, scan.sequence) as pipeline:
        one_scan(pipeline, scan)
        maps = pipeline.decoded("left")
        ours = np.stack([maps.p_px, maps.q_px], -1)
    inside = np.isfinite(ours).all(-1)
    for decode in (references.numpy_decode, references.opencv_decode):
        theirs = np.stack(decode(scan.sequence, scan.frames["left"]), -1)
        assert np.quantile(np.abs(theirs - ours)[inside], 0.999) < 1e-3


def test_the_reference_finds_the_same_points(scan: ScanFrames) -> None:
    with Pipeline(scan.calibration, synthetic.WATER, scan.sequence) as pipeline:
        one_scan(pipeline, scan)
        points = pipeline.full().summary.points
        said = {number.key: number for number in judged(scan, pipeline.full(), pipeline)}
    assert references.reference_scan(scan) == pytest.approx(points, rel=0.03), "it masks no edges"
    assert said["false_matches_ppm"].value < 100.0
    assert said["float32_max_px"].kept
    assert 0.01 < said["noise_mm"].value < 0.2


def test_a_small_part_of_the_disc_is_missed_and_counted(scan: ScanFrames) -> None:
    with Pipeline(scan.calibration, synthetic.WATER, scan.sequence) as pipeline:
        one_scan(pipeline, scan)
        cloud = pipeline.full()
        whole = next(iter(judged(scan, cloud, pipeline))).value
        half = cloud.pixel % 2 == 0
        less = type(cloud)(
            *(getattr(cloud, name)[half] for name in ("points_mm", "intensity", "modulation_dn", "ray_gap_mm")),
            cloud.sigma_mm[half], cloud.pixel[half], cloud.summary,
        )  # fmt: skip
        assert next(iter(judged(scan, less, pipeline))).value == pytest.approx(whole / 2, rel=0.02)


def test_memory_sets_a_limit() -> None:
    assert roofline.scan_ms(1_920_000, 24, 1_300_000, 48.0, 20.0) == pytest.approx(
        (92.16 + 30.72) / 48.0 + (30.72 + 33.8) / 20.0
    )


def test_the_latest_number_of_each_key_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "latest.json"
    note_latest([Measured("a", 1.0, "ms", key="a_ms"), Measured("b", 2.0, "ms")], path)
    note_latest([Measured("c", math.nan, "ms", key="c_ms", why="no network")], path)
    said = json.loads(path.read_text())
    assert (said["a_ms"], said["c_ms"], said["why"]) == (1.0, None, {"c_ms": "no network"})
    note_latest([Measured("c", 3.0, "ms", key="c_ms")], path)
    said = json.loads(path.read_text())
    assert (said["c_ms"], said["why"]) == (3.0, {})


def test_a_longer_bar_is_longer(tmp_path: Path) -> None:
    draw_bars(tmp_path / "bars.png", [("title", {"short": 1.5, "long": 900.0})])
    picture = cv2.imread(str(tmp_path / "bars.png"))
    assert picture is not None
    inked = (picture == (170, 120, 40)).all(-1).sum(1)
    assert inked.max() > 4 * np.min(inked[inked > 0])
