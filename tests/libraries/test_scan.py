"""A scan of the whole service on device nodes: ``kingfisher run``, its packaged rig file, two cameras of 1600 x 1200."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from appliance.storage.library import Library
from appliance.storage.scan import StoredScan
from hw_sim.timing.world_time import BLANK_NS
from hw_sim.wires.umockdev.testbed import Testbed
from hw_sim.world import World, WorldOptions
from tests.libraries.instrument import Instrument
from tests.libraries.rehearsal import rehearse
from tests.support.truth import left_to_rig

pytestmark = [pytest.mark.foreign, pytest.mark.timeout(1500)]

SIZE = (1600, 1200)
FRAMES = 24
PACES = ("realtime", "realtime", "realtime", "attended", "attended", "attended")
"""Of the attempts. In the first, blanks come 60 times a second whatever the service does: 2 x 115 MB/s through libusb. In the
last, the display waits for the service while it records, so that any machine can do it."""
PATIENCE_S, LOOK_S, STILL_S = 6.0, 0.02, 1.5
"""Until a diver presses again; how often the status is looked at; how long live images must not change."""
LATE = "LATE_FLIP"
"""The service itself was late for a blank, and said so."""
BUSY_S = 0.1
"""Threads that were ready to run but waited longer than this in all for a processor excuse a fault of real time."""


@dataclass(frozen=True, slots=True)
class Dive:
    world: World
    instrument: Instrument

    def waited_s(self) -> float:
        """How long all threads of the service and of the world were ready to run and had no processor, since they began."""
        files = [
            path for pid in (os.getpid(), self.instrument.pid) for path in Path(f"/proc/{pid}/task").glob("*/schedstat")
        ]
        waited_ns = 0
        for path in files:
            with contextlib.suppress(OSError):  # a thread that has just ended
                waited_ns += int(path.read_text().split()[1])
        return waited_ns / 1e9


@pytest.fixture(scope="module")
def dive(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Dive]:
    """The service, aiming at a plane; the images of its scan are made."""
    folder = tmp_path_factory.mktemp("dive")
    width, height = SIZE
    options = WorldOptions(
        world="bed", width_px=width, height_px=height, stills=True, truth="modelled", object="plane", seed=11
    )
    with World(options) as world:
        rehearse(world, folder / "rehearsal")
        world.set_pace("attended")
        with Testbed(world) as bed, Instrument(folder, bed, world.truth, SIZE) as instrument:
            status = instrument.wait_state("AIM", timeout_s=240)
            assert set(status["devices"].values()) == {"ok"}
            yield Dive(world, instrument)


def settle(dive: Dive) -> None:
    """Until every live image is one that was made before: one that takes a second to make leaves the camera as late."""
    sides, end = ("left", "right"), time.monotonic() + 120
    seen, since = [dive.world.seen(side) for side in sides], time.monotonic()
    while time.monotonic() < since + STILL_S:
        assert time.monotonic() < end, "the live images do not come to rest"
        time.sleep(LOOK_S)
        now = [dive.world.seen(side) for side in sides]
        if any(a is not b for a, b in zip(seen, now, strict=True)):
            seen, since = now, time.monotonic()


def press_until(dive: Dive, states: set[str], timeout_s: float) -> dict[str, Any]:
    """Press SCAN, and again when nothing happens, as a diver would; the first status in one of these states."""
    end = time.monotonic() + timeout_s
    while True:
        dive.world.press("scan")
        again = time.monotonic() + PATIENCE_S
        while (now := time.monotonic()) < again:
            status = dive.instrument.status
            if status.get("state") in states:
                return status
            time.sleep(LOOK_S)
        assert now < end, f"{status}\n{dive.instrument.log[-2000:]}"


def scan(dive: Dive) -> tuple[StoredScan, str]:
    """Press SCAN until a scan is shown, keep it, and take it from the disk; also its pace. Fails for every fault but those
    of a busy machine."""
    excused: list[str] = []
    for pace in PACES:
        dive.world.set_pace(pace)
        settle(dive)
        before_s = dive.waited_s()
        press_until(dive, {"ARMED", "CAPTURE", "CHECK", "RECONSTRUCT"}, 60)
        status = dive.instrument.wait_state("AIM", "REVIEW", timeout_s=240)
        if status["state"] == "REVIEW":
            return kept(dive), pace
        waited_s = dive.waited_s() - before_s
        alert = status["alerts"][0] if status["alerts"] else {"code": "NONE", "detail": "nothing is said"}
        what = f"{pace}: {alert['code']} ({alert['detail']}), {waited_s:.2f} s without a processor"
        assert alert["code"] == LATE or waited_s > BUSY_S, f"on an idle machine: {what}\n{dive.instrument.log[-2000:]}"
        excused.append(what)
        end = time.monotonic() + 60
        while dive.world.recording and time.monotonic() < end:
            time.sleep(0.1)
        time.sleep(1.0)
    pytest.skip("this machine is too busy: " + "; ".join(excused))


def kept(dive: Dive) -> StoredScan:
    """Keep what is shown, wait until the screen says so, and take it from the disk."""
    time.sleep(0.5)  # a diver looks at it
    press_until(dive, {"SAVING", "AIM"}, 120)
    dive.instrument.wait_state("AIM", timeout_s=120)
    library = Library(dive.instrument.root)
    last = library.last_id()
    assert last is not None
    assert library.verify(last).ok, "every checksum fits"
    return library.load(last)


def no_frame_is_missing(ledger: dict[str, Any]) -> None:
    """Four witnesses, each complete by itself."""
    assert len(ledger["flips"]) == len(ledger["pulses"]) == FRAMES
    assert (np.diff([flip["sequence"] for flip in ledger["flips"]]) == 1).all(), "no blank is missed"
    assert np.diff([flip["time_ns"] for flip in ledger["flips"]]) == pytest.approx(BLANK_NS, abs=2000)
    for side in ("left", "right"):
        frames = ledger["frames"][side]
        assert [frame["status"] for frame in frames] == ["complete"] * FRAMES
        assert (np.diff([frame["block_id"] for frame in frames]) == 1).all(), "no image is lost between two"


def test_a_scan_loses_nothing_and_lies_on_the_object(dive: Dive) -> None:
    stored, pace = scan(dive)
    ledger = dict(stored.manifest.record.ledger)
    no_frame_is_missing(ledger)
    if pace == "realtime":
        received_ns = [frame["received_ns"] for side in ("left", "right") for frame in ledger["frames"][side]]
        assert (max(received_ns) - min(received_ns)) / 1e9 < 1.0, "they came as they were taken, not afterwards"
    cloud = stored.cloud()
    assert cloud is not None
    distance_mm = dive.world.surface.distance_mm(left_to_rig(dive.world.truth, cloud.points_mm))
    assert len(distance_mm) > 600_000
    assert np.sqrt(np.mean(distance_mm**2)) < 0.06
