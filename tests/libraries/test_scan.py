"""A scan of the whole service on device nodes: ``kingfisher run``, its packaged rig file, two cameras of 800 x 600."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from appliance.store.library import Library
from appliance.store.scan import StoredScan
from hw_sim.timing.world_time import BLANK_NS
from hw_sim.wires.umockdev.testbed import Testbed
from hw_sim.world import World, WorldOptions
from tests.libraries.instrument import Instrument
from tests.libraries.rehearsal import rehearse
from tests.support.truth import left_to_rig

pytestmark = [pytest.mark.foreign, pytest.mark.timeout(1500)]

SIZE = (800, 600)
FRAMES = 24
PATIENCE_S, LOOK_S = 6.0, 0.02
"""Until a diver presses again; how often the status is looked at."""
TRIES = 6
LATE = {"LATE_FLIP", "SYNC_LOST"}
"""A busy machine made the service late."""


@pytest.fixture
def dive(tmp_path: Path) -> Iterator[tuple[World, Instrument]]:
    """The service, aiming at a plane; the display waits for it while it records, so that any machine can do it."""
    width, height = SIZE
    options = WorldOptions(
        world="bed", width_px=width, height_px=height, stills=True, truth="modelled", object="plane", seed=11
    )
    with World(options) as world:
        rehearse(world, tmp_path / "rehearsal")
        world.set_pace("attended")
        with Testbed(world) as bed, Instrument(tmp_path, bed, world.truth, SIZE) as instrument:
            status = instrument.wait_state("AIM", timeout_s=240)
            assert set(status["devices"].values()) == {"ok"}
            yield world, instrument


def press_until(world: World, instrument: Instrument, *states: str) -> None:
    """Press SCAN, and again when nothing happens, as a diver would."""
    end = time.monotonic() + 120.0
    while True:
        world.press("scan")
        again = time.monotonic() + PATIENCE_S
        while (now := time.monotonic()) < again:
            if instrument.status.get("state") in states:
                return
            time.sleep(LOOK_S)
        assert now < end, f"{instrument.status}\n{instrument.log[-2000:]}"


def kept(world: World, instrument: Instrument) -> StoredScan:
    """Record a scan, keep it, and take it from the disk."""
    for _ in range(TRIES):
        time.sleep(3.0)  # the live images come to rest
        press_until(world, instrument, "ARMED", "CAPTURE", "CHECK", "RECONSTRUCT")
        status = instrument.wait_state("AIM", "REVIEW", timeout_s=240)
        if status["state"] == "REVIEW":
            break
        assert {alert["code"] for alert in status["alerts"]} & LATE, f"{status['alerts']}\n{instrument.log[-2000:]}"
    assert status["state"] == "REVIEW"
    time.sleep(0.5)  # a diver looks at it
    press_until(world, instrument, "SAVING", "AIM")
    instrument.wait_state("AIM", timeout_s=120)
    library = Library(instrument.root)
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


def test_a_scan_loses_nothing_and_lies_on_the_object(dive: tuple[World, Instrument]) -> None:
    world, instrument = dive
    stored = kept(world, instrument)
    no_frame_is_missing(dict(stored.manifest.record.ledger))
    cloud = stored.cloud()
    assert cloud is not None
    distance_mm = world.surface.distance_mm(left_to_rig(world.truth, cloud.points_mm))
    assert len(distance_mm) > 150_000
    assert np.sqrt(np.mean(distance_mm**2)) < 0.06
