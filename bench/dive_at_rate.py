"""A dive in real time: ``python -m bench.dive_at_rate --scans 100 --root DIR`` records scan after scan; prints JSON.

The whole service on the simulated instrument, whose clock is the wall's and whose images of a resting scene are made once
(``stills``). Scans before the first good one make those images and are not counted. What is judged afterwards comes from
the scans' manifests: flips, pulses, frames, times.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from dataclasses import replace as changed
from pathlib import Path
from typing import Any

from appliance.cli.simrig import SimOptions, apply_options, default_sim_rig
from appliance.instrument.service.app import run
from appliance.instrument.worker.child import own_memory_mb
from appliance.measure.calibration.file import encode_calibration
from appliance.store.config import Rig, load_rig
from appliance.store.instrument import Instrument
from appliance.store.library import Library
from hw_sim import registry
from hw_sim.options import options_from
from hw_sim.truth import draw_truth
from hw_sim.world import World
from tests.support.truth import true_calibration

MOST_WARM_UPS = 12
KEPT_FOLDERS = 3
"""Older ones are deleted by this program, not by the instrument: a hundred scans are nine gigabytes."""
STEP_TIMEOUT_S = 40.0
PRESS_TIMEOUT_S, MOST_PRESSES = 3.0, 8
"""Timeout of a press, after which the diver presses again, and the largest number of presses."""


@dataclass
class Log:
    """Log of the dive."""

    warm_ups: int = 0
    scans: int = 0
    refused: list[str] = field(default_factory=list)
    late_us: list[float] = field(default_factory=list)
    """Lateness of each flip of a saved scan, against its intended blank."""
    answers_us: list[float] = field(default_factory=list)
    """Time from each blank of all sequences, refused ones too, to the next flip."""
    blanks_late_us: list[float] = field(default_factory=list)
    """Lateness of those blanks in the simulated world itself."""
    missed: int = 0
    """Number of those blanks without a flip; each ended its sequence, or repeated it."""
    screen_hz: float = 0.0
    """New pictures on the display between sequences."""
    lost_frames: int = 0
    times_s: list[dict[str, float]] = field(default_factory=list)
    service_mb: list[float] = field(default_factory=list)
    worker_mb: list[float] = field(default_factory=list)
    error: str | None = None


class Diver(threading.Thread):
    """Presses the keys, looks at the status file, and reads the manifests."""

    def __init__(self, rig: Rig, scans: int) -> None:
        super().__init__(name="diver", daemon=True)
        self.log = Log()
        self._rig, self._wanted = rig, scans
        self._library = Library(rig.storage.root)

    def run(self) -> None:
        try:
            self._dive()
        except Exception as error:
            self.log.error = f"{type(error).__name__}: {error}"
        finally:
            self._look_at_the_clock()
            os.kill(os.getpid(), signal.SIGTERM)

    def _dive(self) -> None:
        self._until(lambda: self._world() is not None)
        self._until(lambda: self._state() == "AIM")
        while self.log.scans < self._wanted:
            counting = self.log.scans > 0 or self.log.warm_ups > 0
            reason = self._scan()
            if reason is None and counting:
                self._look_at_the_last()
            elif not self.log.scans:
                self.log.warm_ups += 1
                if self.log.warm_ups > MOST_WARM_UPS:
                    raise RuntimeError(f"no scan was good after {MOST_WARM_UPS} attempts: {reason}")
                self._let_images_be_made()
                self._begin_to_count()
            else:
                self.log.refused.append(reason or "?")
                if len(self.log.refused) > self._wanted:
                    raise RuntimeError(f"more scans refused than wanted, the last for {reason}")

    def _scan(self) -> str | None:
        """Record and keep one scan; return the code of the alert that rejected it, else ``None``."""
        self._until(lambda: self._state() == "AIM")
        since_ns = self._status().get("since_ns")
        # A capture may be over before anybody has seen it: what counts is that the state was entered anew.
        self._press_until(lambda: self._status().get("since_ns") not in (since_ns, None))
        self._until(lambda: self._status().get("since_ns") != since_ns and self._state() in ("AIM", "REVIEW"))
        if self._state() == "AIM":
            alerts = self._status().get("alerts", [])
            return str(alerts[0]["code"]) if alerts else "no alert"
        before = self._status().get("last_scan")
        time.sleep(0.6)  # a diver looks before keeping
        self._press_until(lambda: self._state() in ("SAVING", "AIM"))
        self._until(lambda: self._state() == "AIM" and self._status().get("last_scan") != before)
        return None

    def _let_images_be_made(self) -> None:
        """Wait until the images of the displayed sequence are rendered, so that the next sequence finds them ready."""
        world = self._world()
        assert world is not None
        self._until(lambda: not world.developing)

    def _begin_to_count(self) -> None:
        """Start counting, because the world's images exist from now on."""
        world = self._world()
        assert world is not None
        punctuality = world.punctuality
        punctuality.answers_us.clear()
        punctuality.blanks_late_us.clear()
        punctuality.missed = punctuality.other_blanks = punctuality.screen_updates = 0

    def _look_at_the_clock(self) -> None:
        world = self._world()
        if world is None:
            return
        punctuality = world.punctuality
        self.log.answers_us, self.log.blanks_late_us = list(punctuality.answers_us), list(punctuality.blanks_late_us)
        self.log.missed = punctuality.missed
        self.log.screen_hz = 60.0 * punctuality.screen_updates / max(punctuality.other_blanks, 1)

    def _look_at_the_last(self) -> None:
        last = self._library.last_id()
        assert last is not None
        record = self._library.load(last).manifest.record
        self.log.scans += 1
        ledger: Any = record.ledger
        first = ledger["flips"][0]
        for k, flip in enumerate(ledger["flips"]):
            self.log.late_us.append((flip["time_ns"] - first["time_ns"] - k * ledger["period_ns"]) / 1e3)
        for frames in ledger["frames"].values():
            good = [frame for frame in frames if frame["status"] == "complete"]
            self.log.lost_frames += int(ledger["expected"]) - len(good)
        times_s = {k: float(v) for k, v in record.stage_times_s.items()}
        arrived_ns = max(frames[-1]["received_ns"] for frames in ledger["frames"].values())
        times_s["last_frame"] = (arrived_ns - (record.recorded_ns or 0)) / 1e9
        self.log.times_s.append(times_s)
        self.log.service_mb.append(own_memory_mb(os.getpid()) or 0.0)
        self.log.worker_mb.append(sum(own_memory_mb(pid) or 0.0 for pid in children()))
        folders = sorted((self._rig.storage.root / "scans").glob("[0-9]*"))
        for old in folders[:-KEPT_FOLDERS]:
            shutil.rmtree(old)

    def _world(self) -> World | None:
        return registry.find(str(self._rig.rig.wires_options.get("world", "main")))

    def _press(self, key: str) -> None:
        world = self._world()
        if world is None:
            raise RuntimeError("the world has ended")
        world.press(key)

    def _status(self) -> dict[str, Any]:
        try:
            status = json.loads((self._rig.storage.root / "run" / "status.json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}
        return status if isinstance(status, dict) else {}

    def _state(self) -> str | None:
        return self._status().get("state")

    def _press_until(self, predicate: Callable[[], bool]) -> None:
        """Press SCAN, and again without an effect; ``_until`` reports the failure."""
        for _ in range(MOST_PRESSES):
            self._press("scan")
            end_s = time.monotonic() + PRESS_TIMEOUT_S
            while time.monotonic() < end_s:
                if predicate():
                    return
                time.sleep(0.02)

    def _until(self, predicate: Callable[[], bool]) -> None:
        end_s = time.monotonic() + STEP_TIMEOUT_S
        while not predicate():
            if time.monotonic() > end_s:
                raise RuntimeError(f"nothing happened for {STEP_TIMEOUT_S:g} s: {json.dumps(self._status())[:400]}")
            time.sleep(0.02)


def children() -> list[int]:
    """Return the process ids of this process's children."""
    listed = Path(f"/proc/{os.getpid()}/task").glob("*/children")
    return [int(pid) for path in listed for pid in path.read_text(encoding="ascii").split()]


def rig_of(root: Path, size: str) -> Rig:
    """Return the calibrated simulated instrument in real time."""
    rig = apply_options(
        load_rig(default_sim_rig()),
        SimOptions(root=root, object_name="pipe", truth="modelled", seed=7, size=size, pace="realtime"),
    )
    rig = changed(rig, rig=changed(rig.rig, wires_options={**rig.rig.wires_options, "stills": True}))
    world = options_from(rig.rig.wires_options)
    truth = draw_truth(world.truth, world.seed, world.width_px, world.height_px, world.scene().water.index)
    calibration = Instrument(rig).calibration_file
    calibration.parent.mkdir(parents=True, exist_ok=True)
    calibration.write_bytes(encode_calibration(true_calibration(truth, rig.rig.serial)))
    return rig


def main() -> int:
    """Run the dive, and print the log."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--scans", type=int, default=100)
    parser.add_argument("--size", default="1600x1200")
    parser.add_argument("--root", type=Path, required=True)
    options = parser.parse_args()
    logging.basicConfig(level=logging.WARNING, stream=sys.stderr)
    rig = rig_of(options.root.absolute(), options.size)
    diver = Diver(rig, options.scans)
    diver.start()
    code = run(rig)
    diver.join(STEP_TIMEOUT_S)
    print(json.dumps(diver.log.__dict__))
    return code or (1 if diver.log.error else 0)


if __name__ == "__main__":
    sys.exit(main())
