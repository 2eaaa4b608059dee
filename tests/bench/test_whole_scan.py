"""A whole scan is timed on the product's own worker, and what is told of it is what it took."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from appliance.patterns.sequence import build_sequence
from bench.bench_whole_scan import Effort, measured_with
from bench.document import BEGIN, BY_SCENE, END, WHOLE_BEGIN, WHOLE_END, WHOLE_SCAN, write_figures
from bench.result import Measured
from bench.runner import note_latest
from bench.whole_scan.paced import PacedScan, cpu_ms
from bench.whole_scan.scenes import DISC
from bench.whole_scan.timeline import ALONG_X, ALONG_Y, BOTH, BUSY, draw, spans_of, typical

OF_A_MOVING_SCAN = {
    "compensation_target_machine_ms",
    "moving_complete_own_peak_mb",
    "part_compensation_cpu_ms",
}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Measured]]:
    folder = tmp_path_factory.mktemp("out")
    effort = Effort(400, scans=2, rounds=1, folder=folder / "scenes", scenes=(DISC,))
    numbers = list(measured_with(effort, folder))
    note_latest(numbers, folder / "latest.json")
    return folder, {number.key: number for number in numbers if number.key is not None}


def test_the_headline_figures_have_the_names_that_were_promised(run: tuple[Path, dict[str, Measured]]) -> None:
    folder, _ = run
    said = json.loads((folder / "latest.json").read_text())
    for key in ("verdict_cpu_ms", "complete_cpu_ms", "complete_wall_ms", "complete_scan_cpu_ms"):
        assert said[key] > 0.0, key
    listed = {key for rows in WHOLE_SCAN.values() for key, _, _ in rows}
    listed |= {key for rows in BY_SCENE.values() for key, _ in rows}
    assert {key for key in listed if said.get(key) is None} == OF_A_MOVING_SCAN
    assert said["bounds"]["verdict_target_machine_ms"] == {"at_most": 30.0}


def test_each_answer_costs_more_than_the_one_before_it(run: tuple[Path, dict[str, Measured]]) -> None:
    numbers = {key: number.value for key, number in run[1].items()}
    path = [numbers[f"{name}_cpu_ms"] for name in ("coarse_path", "verdict", "complete", "complete_scan")]
    assert path == sorted(path)
    clock = [numbers[f"{name}_wall_ms"] for name in ("coarse", "verdict", "complete")]
    assert clock == sorted(clock)
    assert numbers["durable_wall_ms"] > 0.0
    # The worker does the same work as the parts one by one, with colder caches and messages besides.
    judges = sum(numbers[f"part_{name}_cpu_ms"] for name in ("light", "fringes", "water", "sight", "motion", "windows"))
    assert numbers["verdict_cpu_ms"] - numbers["coarse_path_cpu_ms"] > 0.5 * judges
    assert numbers["part_backscatter_cpu_ms"] < 1.5 * numbers["part_coarse_cloud_cpu_ms"]


def test_the_tables_of_a_scan_are_written_without_touching_the_others(
    run: tuple[Path, dict[str, Measured]], tmp_path: Path
) -> None:
    latest, document = tmp_path / "out" / "latest.json", tmp_path / "performance.md"
    latest.parent.mkdir()
    for name in ("latest.json", "timeline.png"):
        (latest.parent / name).write_bytes((run[0] / name).read_bytes())
    document.write_text(f"{WHOLE_BEGIN}\nold\n{WHOLE_END}\nbetween\n{BEGIN}\nkept\n{END}")
    write_figures(latest, document)
    text = document.read_text()
    assert f"between\n{BEGIN}\nkept\n{END}" in text, "nothing was measured of these"
    assert "\nold\n" not in text
    assert "| last frame to verdict | " in text
    assert (tmp_path / "pictures" / "timeline.png").stat().st_size > 1000


def test_the_cpu_time_of_another_process_is_that_of_all_of_its_threads() -> None:
    burn = (
        "import sys, threading, time\n"
        "def burn():\n"
        "    while time.thread_time() < 0.15: pass\n"
        "threads = [threading.Thread(target=burn) for _ in range(2)]\n"
        "[t.start() for t in threads]; [t.join() for t in threads]\n"
        "print(time.process_time(), flush=True)\n"
        "sys.stdin.read()\n"
    )
    with subprocess.Popen([sys.executable, "-c", burn], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        own_ms = 1e3 * float(process.stdout.readline())
        seen_ms = cpu_ms(process.pid)
        process.kill()
    assert own_ms > 300.0
    assert own_ms <= seen_ms < own_ms + 50.0, "threads that have ended count, too"
    with pytest.raises(RuntimeError, match="gone"):
        cpu_ms(None)


def test_the_scan_that_is_drawn_is_no_outlier() -> None:
    def scan(coarse_ms: float, verdict_ms: float, full_ms: float, durable_ms: float) -> PacedScan:
        return PacedScan(coarse_ms, verdict_ms, full_ms, durable_ms, 1.0, 90.0, 30.0, 0.0, 30.0, 1, ())

    usual, stalled, slow_disk = scan(28, 70, 100, 300), scan(33, 225, 258, 293), scan(28, 69, 101, 900)
    others = [scan(25, 62, 95, 290), scan(31, 75, 110, 320)]
    assert typical([stalled, others[0], usual, slow_disk, others[1]]) is usual
    with pytest.raises(ValueError, match="at least one"):
        typical([])


def test_the_picture_shows_frames_before_the_last_one_ends_and_answers_after_it(tmp_path: Path) -> None:
    sequence = build_sequence(16)
    trace = tuple((float(t), 0.0 if t < 0 else float(t)) for t in range(-420, 90))
    scan = PacedScan(20.0, 50.0, 80.0, 60.0, 1.0, 90.0, 30.0, 0.0, 30.0, 1, (), trace)
    spans = spans_of(sequence, scan)
    frames = [span for span in spans if span.row == "recording"]
    assert frames[0].begin_ms == pytest.approx(-len(sequence) * 1000 / 60)
    assert frames[-1].end_ms == 0.0
    colours = [span.colour for span in frames]
    assert colours.count(ALONG_X) + colours.count(ALONG_Y) + colours.count(BOTH) == len(sequence)
    assert 0 < colours.count(BOTH) <= 2
    assert [(span.row, span.end_ms) for span in spans[len(sequence) :]] == [
        ("coarse cloud", 20.0), ("verdict", 50.0), ("full cloud", 80.0), ("raw durable", 60.0),
    ]  # fmt: skip
    draw(tmp_path / "timeline.png", "title", sequence, scan)
    picture = cv2.imread(str(tmp_path / "timeline.png"))
    assert picture is not None
    busy = (picture == BUSY).all(-1)
    upper, lower = np.split(busy, 2)
    # Squares beside the title say what the colours of the recording are.
    legend = picture[:44, 700:].reshape(-1, 3)
    assert all((legend == colour).all(-1).sum() > 100 for colour in (BOTH, ALONG_X, ALONG_Y))
    assert 0 < upper.sum() < lower.sum(), "what came after the last frame is drawn larger below"
