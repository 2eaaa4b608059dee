"""A hundred scans in real time: frames lost, lateness of the flips, latency of the cloud, and whether memory stays flat."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from bench.curves import draw_run
from bench.result import Measured

SCANS, SIZE = 100, "1600x1200"
OUT = Path("bench/out")
SECONDS_PER_SCAN = 12.0
EARLY = 10
"""Memory may still grow until this scan."""


def measure() -> Iterator[Measured]:
    OUT.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=OUT) as folder:
        log = dive(Path(folder), SCANS, SIZE)
    (OUT / "endurance-log.json").write_text(json.dumps(log) + "\n", encoding="utf-8")
    memory = {"service and simulated world": log["service_mb"], "worker": log["worker_mb"]}
    draw_run(OUT / "endurance.png", log["late_us"], memory)
    yield from judged(log)


def dive(root: Path, scans: int, size: str) -> dict[str, Any]:
    """Run the dive in a process of its own. Raises RuntimeError when it does not come to its end."""
    command = [sys.executable, "-m", "bench.dive_at_rate", "--scans", str(scans), "--size", size, "--root", str(root)]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=180.0 + SECONDS_PER_SCAN * scans, check=False)
    said = ran.stdout.strip().splitlines()
    if not said:
        raise RuntimeError(f"the dive ended with code {ran.returncode}: {ran.stderr[-600:]}")
    log: dict[str, Any] = json.loads(said[-1])
    if log["error"] is not None:
        raise RuntimeError(f"the dive ended early: {log['error']}; {ran.stderr[-600:]}")
    return log


def judged(log: dict[str, Any]) -> Iterator[Measured]:
    """What the log of a dive says."""
    yield Measured("scans recorded in real time", log["scans"], "scans", key="endurance_scans")
    lost = log["lost_frames"]
    yield Measured("frames lost in them", lost, "frames", at_most=0.0, key="endurance_lost_frames")
    yield Measured("scans refused (late flips of the host, ...)", len(log["refused"]), "scans", key="endurance_refused")
    late = np.abs(log["late_us"])
    yield Measured("latest flip", float(late.max()), "us", key="endurance_latest_flip_us")
    times = {name: np.array([scan[name] for scan in log["times_s"] if name in scan]) for name in log["times_s"][0]}
    for name, key in (("coarse", "coarse_latency_ms"), ("full", "full_latency_ms"), ("saved", "saved_latency_ms")):
        latency_ms = 1e3 * float(np.median(times[name] - times["last_frame"][: len(times[name])]))
        yield Measured(f"last frame to {name}, median", latency_ms, "ms", key=key)
    for name, key in (("service_mb", "service"), ("worker_mb", "worker")):
        line = log[name]
        early = line[min(EARLY, len(line)) - 1]
        yield Measured(f"memory of the {key} at the last scan", line[-1], "MB", key=f"{key}_memory_mb")
        growth = line[-1] - early
        yield Measured(f"its growth since scan {EARLY}", growth, "MB", at_most=20.0, key=f"{key}_growth_mb")
