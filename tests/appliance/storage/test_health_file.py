"""The memory of a calibration's health: whole after any loss of power, bounded, and never overwritten when unreadable."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from appliance.calibration.health import MOST_POINTS, HealthTrend, Reference, TrendPoint
from appliance.checksummed_file import with_checksum
from appliance.storage.atomic import StorageError
from appliance.storage.health import MAX_BYTES, HealthFile
from tests.appliance.storage.volatile import PowerCut, VolatileDisk

HASH = "0123456789abcdef" * 4


def trend(judged: int) -> HealthTrend:
    points = tuple(
        TrendPoint(f"{k:06d}", (1.234567, -2.0, 3.0, 0.1 * k), (0.5,) * 4, 1.25, 2.125, 0.0625, False)
        for k in range(min(judged, MOST_POINTS))
    )
    return HealthTrend(judged=judged, points=points, total=(0.1, 0.2, 0.3, 0.4), alarm="turned" if judged > 2 else None)


def test_what_is_written_is_read(tmp_path: Path) -> None:
    file = HealthFile(tmp_path, HASH)
    assert file.read() == HealthTrend()
    for judged in (1, 3):
        file.write(trend(judged))
        assert HealthFile(tmp_path, HASH).read() == trend(judged)
    other = HealthFile(tmp_path, "f" * 64)
    assert other.read() == HealthTrend(), "each calibration has its own"


def test_the_longest_history_stays_small(tmp_path: Path) -> None:
    file = HealthFile(tmp_path, HASH)
    full = trend(100_000)
    file.write(full)
    assert file.path.stat().st_size < MAX_BYTES / 5
    assert file.read() == full


def test_power_cut_before_every_single_call_leaves_the_old_or_the_new_trend(tmp_path: Path) -> None:
    total = None
    cut_at = 0
    seen = set()
    while total is None:
        root = tmp_path / f"before-{cut_at}"
        root.mkdir()
        disk = VolatileDisk(root, cut_at)
        done = 0
        try:
            for done in range(3):
                HealthFile(root, HASH, disk).write(trend(done + 1))
            done = 3
            total = cut_at
        except PowerCut:
            pass
        for fate in disk.fates():
            left = disk.survivors(tmp_path / "after", fate)
            judged = HealthFile(left, HASH).read().judged
            assert judged in (done, done + 1), "what was written stays"
            seen.add(judged)
        cut_at += 1
    assert seen == {0, 1, 2, 3}


@pytest.mark.parametrize("damage", ["{}", "no JSON", "[1]", '{"schema": 1}', ""])
def test_what_cannot_be_read_is_put_aside(tmp_path: Path, damage: str) -> None:
    file = HealthFile(tmp_path, HASH)
    file.write(trend(1))
    file.path.write_text(damage)
    assert file.read() == HealthTrend()
    file.write(trend(2))
    assert file.read() == trend(2)
    assert file.path.with_suffix(".damaged").read_text() == damage


def test_a_changed_number_is_noticed(tmp_path: Path) -> None:
    file = HealthFile(tmp_path, HASH)
    file.write(trend(3))
    file.path.write_text(file.path.read_text().replace('"judged": 3', '"judged": 4'))
    assert file.read() == HealthTrend()


def test_a_reference_of_another_version_is_not_used(tmp_path: Path) -> None:
    file = HealthFile(tmp_path, HASH)
    file.write(HealthTrend(reference=Reference(gap_um=(1.0,) * 12)))
    assert file.read() == HealthTrend()


def test_a_file_from_before_backscatter_counted_is_read(tmp_path: Path) -> None:
    """Its reference says nothing of doubts: it has none."""
    file = HealthFile(tmp_path, HASH)
    file.write(trend(3))
    content = json.loads(file.path.read_bytes())
    del content["trend"]["reference"]["doubts_um"], content["sha256"]
    file.path.write_bytes(with_checksum(content, indent=None))
    assert file.read() == trend(3)


def test_doubts_of_another_number_of_causes_are_not_used(tmp_path: Path) -> None:
    file = HealthFile(tmp_path, HASH)
    file.write(replace(trend(3), reference=Reference(doubts_um=(0.0,) * 7)))
    assert file.read() == HealthTrend()


def test_a_refusing_disk_is_named(tmp_path: Path) -> None:
    (tmp_path / "calibration").write_text("a file where a folder should be")
    with pytest.raises(StorageError, match="health"):
        HealthFile(tmp_path, HASH).write(replace(trend(1)))
