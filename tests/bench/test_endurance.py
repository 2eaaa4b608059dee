"""Scan after scan in real time: whatever is saved is whole, and the run says what it was like."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from bench.bench_endurance import MOST_FULL_MS, dive, judged
from bench.curves import draw_run
from bench.document import ENDURANCE, TABLES, row


@pytest.mark.parametrize(
    ("scans", "size"),
    [pytest.param(2, "400x300", marks=pytest.mark.dive), pytest.param(20, "1600x1200", marks=pytest.mark.long)],
)
def test_a_dive_in_real_time_loses_no_frame(tmp_path: Path, scans: int, size: str) -> None:
    log = dive(tmp_path, scans, size)
    said = {number.key: number for number in judged(log)}
    assert said["endurance_scans"].value == scans
    assert said["endurance_lost_frames"].value == 0
    assert len(log["late_us"]) == 24 * scans
    assert len(log["answers_us"]) >= 24 * scans
    assert said["endurance_late_flips"].value >= log["refused"].count("LATE_FLIP")
    assert 0.0 < log["screen_hz"] <= 60.0
    assert said["endurance_latest_flip_us"].value < 1000.0, "a later flip would have been refused"
    assert 0.0 < said["coarse_latency_ms"].value < said["full_latency_ms"].value
    assert said["worker_growth_mb"].kept
    assert {key for key, _, _ in TABLES[ENDURANCE]} <= set(said), "the document names nothing that is not measured"


def test_more_flips_make_a_taller_bar(tmp_path: Path) -> None:
    draw_run(tmp_path / "run.png", [800.0] * 90 + [12_000.0] * 2, {"service": [100.0, 110.0], "worker": [50.0, 50.0]})
    picture = cv2.imread(str(tmp_path / "run.png"))
    assert picture is not None
    inked = (picture[:350] == (170, 120, 40)).all(-1).sum(0)
    columns = np.flatnonzero(inked)
    assert inked.max() > 3 * inked[columns[-3]], "the bar of the two late ones is short"


def test_a_stage_that_one_scan_has_not_reached_is_not_counted_as_anothers() -> None:
    """Ten scans; every third has no full cloud, one of the others is late."""
    times_s = [{"last_frame": float(k), "coarse": k + 0.02, "full": k + (0.5 if k == 9 else 0.1)} for k in range(10)]
    for k in (0, 3, 6):
        del times_s[k]["full"]
    log = {
        "scans": 10, "lost_frames": 0, "refused": [], "answers_us": [1.0], "blanks_late_us": [1.0], "missed": 0,
        "screen_hz": 60.0, "late_us": [1.0], "times_s": times_s, "service_mb": [1.0], "worker_mb": [1.0],
    }  # fmt: skip
    said = {one.key: one for one in judged(log)}
    assert said["coarse_latency_ms"].value == pytest.approx(20.0)
    assert said["full_latency_ms"].value == pytest.approx(100.0)
    # Between the sixth and the seventh of seven, 0.7 of the way.
    assert said["full_latency_p95_ms"].value == pytest.approx(100.0 + 0.7 * 400.0)
    assert not said["full_latency_p95_ms"].kept
    assert "saved_latency_ms" not in said


def test_the_table_of_a_hundred_scans_says_what_the_slowest_take_and_that_it_is_too_long() -> None:
    key = "full_latency_p95_ms"
    (words, unit) = next((words, unit) for name, words, unit in TABLES[ENDURANCE] if name == key)
    said = {key: 304.0, "bounds": {key: {"at_most": MOST_FULL_MS}}}
    assert row(said, key, words, unit) == "| the same, 95 % | 304 | | ms | ≤ 120 **missed** |"
