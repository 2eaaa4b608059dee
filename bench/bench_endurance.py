"""A hundred scans in real time: frames lost, lateness of the flips, latency of the cloud, and whether memory stays flat."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from bench.curves import draw_run
from bench.result import Measurement

SCANS, SIZE = 100, "1600x1200"
OUT = Path("bench/out")
SECONDS_PER_SCAN = 12.0
EARLY = 10
"""Memory may still grow until this scan."""


def measure() -> Iterator[Measurement]:
    OUT.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=OUT) as folder:
        log = dive(Path(folder), SCANS, SIZE)
    (OUT / "endurance-log.json").write_text(json.dumps(log) + "\n", encoding="utf-8")
    memory = {"service and simulated world": log["service_mb"], "worker": log["worker_mb"]}
    draw_run(OUT / "endurance.png", log["answers_us"], memory)
    yield from log_figures(log)


def dive(root: Path, scans: int, size: str) -> dict[str, Any]:
    """Run the dive in another process. Raises RuntimeError if it does not finish."""
    command = [sys.executable, "-m", "bench.dive_at_rate", "--scans", str(scans), "--size", size, "--root", str(root)]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=180.0 + SECONDS_PER_SCAN * scans, check=False)
    lines = ran.stdout.strip().splitlines()
    if not lines:
        raise RuntimeError(f"the dive ended with code {ran.returncode}: {ran.stderr[-600:]}")
    log: dict[str, Any] = json.loads(lines[-1])
    if log["error"] is not None:
        raise RuntimeError(f"the dive ended early: {log['error']}; {ran.stderr[-600:]}")
    return log


def log_figures(log: dict[str, Any]) -> Iterator[Measurement]:
    """Yield the figures of the log of a dive."""
    yield Measurement("scans recorded in real time", log["scans"], "scans", key="endurance_scans")
    lost = log["lost_frames"]
    yield Measurement("frames lost in them", lost, "frames", at_most=0.0, key="endurance_lost_frames")
    codes = ", ".join(f"{name} {count}" for name, count in Counter(log["refused"]).items()) or "none"
    yield Measurement(f"scans refused ({codes})", len(log["refused"]), "scans", key="endurance_refused")
    answers_ms = np.array(log["answers_us"]) / 1e3
    usual_ms = (float(np.quantile(answers_ms, 0.1)), float(np.quantile(answers_ms, 0.9)))
    median_ms = float(np.median(answers_ms))
    yield Measurement("blank to the next flip, median", median_ms, "ms", key="endurance_answer_ms", spread=usual_ms)
    yield Measurement(
        "blank to the next flip, 99 %", float(np.quantile(answers_ms, 0.99)), "ms", key="endurance_answer_p99_ms"
    )
    yield Measurement(
        f"blanks that found no flip, of {len(log['blanks_late_us'])}",
        log["missed"],
        "blanks",
        key="endurance_late_flips",
    )
    own_ms = float(np.quantile(np.array(log["blanks_late_us"]) / 1e3, 0.99))
    yield Measurement("lateness of the simulated blanks, 99 %", own_ms, "ms", key="endurance_world_late_p99_ms")
    yield Measurement("new pictures between sequences", log["screen_hz"], "Hz", key="endurance_screen_hz")
    late = np.abs(log["late_us"])
    yield Measurement("latest flip", float(late.max()), "us", key="endurance_latest_flip_us")
    for name, key in (("coarse", "coarse_latency"), ("full", "full_latency"), ("saved", "saved_latency")):
        # Only of scans that reached the stage.
        latency_ms = [1e3 * (scan[name] - scan["last_frame"]) for scan in log["times_s"] if name in scan]
        if not latency_ms:
            continue
        yield Measurement(f"last frame to {name}, median", float(np.median(latency_ms)), "ms", key=f"{key}_ms")
        if name == "full":
            late_ms = float(np.quantile(latency_ms, 0.95))
            yield Measurement(f"last frame to {name}, 95 %", late_ms, "ms", key=f"{key}_p95_ms")
    for name, key in (("service_mb", "service"), ("worker_mb", "worker")):
        line = log[name]
        early = line[min(EARLY, len(line)) - 1]
        yield Measurement(f"memory of the {key} at the last scan", line[-1], "MB", key=f"{key}_memory_mb")
        growth = line[-1] - early
        yield Measurement(f"its growth since scan {EARLY}", growth, "MB", at_most=20.0, key=f"{key}_growth_mb")
