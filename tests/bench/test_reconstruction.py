"""What the product is compared with does the same work, and what is reported is what was measured."""

from __future__ import annotations

import dataclasses
import json
import math
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from appliance.reconstruct.pipeline import Pipeline
from bench import references, roofline
from bench.bench_reconstruction import Effort, measured_with
from bench.document import BEGIN, END, ENDURANCE, TABLES, write_figures
from bench.foreign import PROGRAMS, Peer, PeerFailed, prepare
from bench.judgement import completeness_percent, false_ppm
from bench.picture import BAR, LATE, Bar, Panel, draw
from bench.result import Measured
from bench.rivals import Rounds
from bench.runner import note_latest
from bench.scan_frames import ScanFrames, make_scan
from bench.stages import one_scan
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
    assert references.reference_scan(scan) == pytest.approx(points, rel=0.03), "it masks no edges"


def test_a_point_that_is_missing_or_elsewhere_is_counted(scan: ScanFrames) -> None:
    with Pipeline(scan.calibration, synthetic.WATER, scan.sequence) as pipeline:
        one_scan(pipeline, scan)
        cloud = pipeline.full()
    whole = completeness_percent(scan, cloud)
    assert whole > 99.0
    half = dataclasses.replace(cloud, points_mm=cloud.points_mm[::2], pixel=cloud.pixel[::2])
    assert completeness_percent(scan, half) == pytest.approx(whole / 2, rel=0.02)
    assert false_ppm(scan, cloud) < 100.0
    points_mm = cloud.points_mm.copy()
    points_mm[:3, 2] += 1.2
    assert false_ppm(scan, dataclasses.replace(cloud, points_mm=points_mm)) == pytest.approx(3e6 / len(points_mm))
    off_the_disc = dataclasses.replace(cloud, pixel=np.zeros_like(cloud.pixel))
    assert false_ppm(scan, off_the_disc) == 1e6, "a pixel that sees nothing can have no true point"


def test_a_bar_stands_before_the_disc_and_throws_a_shadow(scan: ScanFrames) -> None:
    with_bar = make_scan(200, 150, bar_height_mm=15.0)
    without = make_scan(200, 150)
    nearer_mm = without.points_mm[..., 2] - with_bar.points_mm[..., 2]
    on_bar = nearer_mm > 5.0
    assert 0.08 < on_bar.mean() / np.isfinite(nearer_mm).mean() < 0.25
    assert np.all(np.abs(nearer_mm[np.isfinite(nearer_mm) & ~on_bar]) < 1e-6)
    seen, seen_without = (np.isfinite(s.right_uv_px).all(-1) for s in (with_bar, without))
    lost = seen_without & ~seen
    assert 0.005 < lost.mean() < 0.1, "shadow, and what the bar hides from the right camera"
    dark = with_bar.frames["left"][0] < 12
    assert (dark & lost).sum() > 0.2 * lost.sum()


@pytest.fixture(scope="module")
def small_run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Measured]]:
    folder = tmp_path_factory.mktemp("out")
    effort = Effort(400, 300, 3, 1, 1, 2, 2, ask_peers=False)
    numbers = list(measured_with(effort, folder))
    note_latest(numbers, folder / "latest.json")
    return folder, {number.key: number for number in numbers if number.key is not None}


def test_one_run_gives_every_number_that_was_promised(small_run: tuple[Path, dict[str, Measured]]) -> None:
    folder, _ = small_run
    said = json.loads((folder / "latest.json").read_text())
    positive = [
        "coarse_cpu_ms",
        "full_cpu_ms",
        "scan_cpu_ms",
        "ratio_numpy_kdtree",
        "worker_peak_mb",
        "first_scan_s",
        "completeness_percent",
        "bias_px",
        "float32_max_px",
        "roofline_scan_ms",
        "roofline_full_ms",
        "opencv_decode_cpu_ms",
        "numpy_decode_cpu_ms",
        "numpy_kdtree_cpu_ms",
    ]
    assert {key: said[key] for key in positive if not said[key] > 0.0} == {}
    assert said["false_matches_ppm"] >= 0.0
    assert abs(said["raw_durable_ms"]) < 60_000.0
    for peer in PROGRAMS:
        assert said[f"{peer}_cpu_ms"] is None
        assert said["why"][f"{peer}_cpu_ms"] == "not asked"


def test_parts_of_a_scan_add_up(small_run: tuple[Path, dict[str, Measured]]) -> None:
    numbers = small_run[1]
    assert numbers["coarse_cpu_ms"].value < numbers["full_cpu_ms"].value < numbers["scan_cpu_ms"].value
    assert numbers["roofline_scan_ms"].value < numbers["scan_cpu_ms"].value, "faster than memory: a wrong time"
    assert numbers["roofline_full_ms"].value < numbers["full_step_cpu_ms"].value, "faster than memory: a wrong time"
    assert numbers["roofline_full_ms"].value * numbers["ratio_full_roofline"].value == pytest.approx(
        numbers["full_step_cpu_ms"].value
    )
    assert numbers["pair_max_cpu_ms"].value <= numbers["recording_cpu_ms"].value + numbers["last_frame_cpu_ms"].value
    assert numbers["worker_scan_cpu_ms"].value > 0.5 * numbers["full_step_cpu_ms"].value, "it does the same work"
    low, high = numbers["scan_cpu_ms"].spread or (0.0, 0.0)
    assert low <= numbers["scan_cpu_ms"].value <= high


def test_a_small_run_keeps_the_promises_that_do_not_depend_on_time(
    small_run: tuple[Path, dict[str, Measured]],
) -> None:
    for key in ("completeness_percent", "false_matches_ppm", "step_false_matches_ppm", "bias_px", "float32_max_px"):
        assert small_run[1][key].kept, key


def test_every_number_is_in_the_document_and_a_miss_is_named(
    small_run: tuple[Path, dict[str, Measured]], tmp_path: Path
) -> None:
    folder, numbers = small_run
    listed = {key for title, table in TABLES.items() if title != ENDURANCE for key, _, _ in table}
    assert set(numbers) == listed
    document = tmp_path / "performance.md"
    document.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    path = tmp_path / "latest.json"
    note_latest([dataclasses.replace(numbers["scan_target_machine_ms"], value=61.0, at_most=60.0)], path)
    write_figures(path, document)
    text = document.read_text()
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "old" not in text
    assert "| 61 |" in text
    assert "≤ 60 **missed**" in text
    write_figures(folder / "latest.json", document)
    assert "| — | | | not asked |" in document.read_text()
    assert document.read_text().count(BEGIN) == 1


def test_a_ratio_is_taken_within_each_round() -> None:
    rounds = Rounds(taken_ms={"other": [10.0, 40.0]})
    assert rounds.ratios("other", [1.0, 4.0, 7.0]) == [10.0, 10.0], "a machine half as fast slows both"


PEER = """
import json, sys
print(json.dumps({"version": "1.2"}), flush=True)
for k, _ in enumerate(sys.stdin):
    if k == 2: sys.exit("no more")
    print(json.dumps({"cpu_ms": 5.0 + k}), flush=True)
"""


def test_a_peer_decodes_once_per_turn_and_its_last_words_are_kept(tmp_path: Path) -> None:
    script = tmp_path / "peer.py"
    script.write_text(PEER)
    with Peer(Path(sys.executable), script, tmp_path / "frames.npz") as peer:
        assert peer.version == "1.2"
        assert (peer.decode(), peer.decode()) == (5.0, 6.0)
        with pytest.raises(PeerFailed, match="no more"):
            peer.decode()


def test_a_peer_that_cannot_be_had_says_why(tmp_path: Path) -> None:
    script = tmp_path / "peer.py"
    script.write_text("import a_package_nobody_has")
    with pytest.raises(PeerFailed, match="a_package_nobody_has"), Peer(Path(sys.executable), script, tmp_path):
        pass
    with pytest.raises(PeerFailed, match="could not be started"), Peer(tmp_path / "no-python", script, tmp_path):
        pass
    (tmp_path / "file").write_text("")
    with pytest.raises(PeerFailed, match="could not be"):
        prepare(tmp_path / "file" / "environment")


def test_reading_and_writing_memory_takes_time() -> None:
    read_gb_s, write_gb_s = roofline.Memory(64_000_000).bandwidth_gb_s()
    assert 0.2 < read_gb_s < 2000.0
    assert 0.2 < write_gb_s < 2000.0


def test_memory_sets_a_limit() -> None:
    assert roofline.scan_ms(1_920_000, 24, 1_300_000, 48.0, 20.0) == pytest.approx(
        (92.16 + 30.72) / 48.0 + (30.72 + 33.8) / 20.0
    )
    # 11 and 9 bytes of a lit pixel, 26 of a point.
    assert roofline.full_cloud_ms(1_400_000, 1_300_000, 1_200_000, 40.0, 20.0) == pytest.approx(
        (15.4 + 11.7) / 40.0 + 31.2 / 20.0
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


def test_a_longer_bar_is_longer_and_a_late_one_has_another_colour(tmp_path: Path) -> None:
    bars = [Bar("short", 1.5), Bar("long", 900.0), Bar("late", 30.0, (29.0, 33.0), target=20.0)]
    draw(tmp_path / "bars.png", [Panel("title", bars)])
    picture = cv2.imread(str(tmp_path / "bars.png"))
    assert picture is not None
    inked = (picture == BAR).all(-1).sum(1)
    assert inked.max() > 4 * np.min(inked[inked > 0])
    late = (picture == LATE).all(-1)
    assert late.any()
    assert not (late.any(1) & (inked > 0)).any()
