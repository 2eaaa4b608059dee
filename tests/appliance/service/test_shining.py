"""The images' proof that the lasers were off: where it comes to nothing, the scan and the service go on."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.machine import events
from appliance.ranging.beams import Pointers
from appliance.ranging.rig_frame import RigFrame
from appliance.service.ranging import RangingController
from appliance.storage.beams import BeamsFile
from drivers.api import LaserState
from drivers.native import MonotonicClock
from hw_sim.truth import draw_truth
from tests.drivers.clock import SteppedClock
from tests.support.truth import true_calibration

POINTERS = Pointers((150.0, 0.0, 0.0), (0.0, 0.0, 520.0), 0.5)
CALIBRATION = true_calibration(draw_truth("modelled", 1, 400, 300, 1.333))
DARK = {side: np.full((300, 400), 4, np.uint8) for side in ("left", "right")}
BRIGHT = {side: np.full((300, 400), 90, np.uint8) for side in ("left", "right")}


@pytest.fixture
def memory(tmp_path: Path) -> BeamsFile:
    kept = BeamsFile(tmp_path, POINTERS)
    kept.path.parent.mkdir(parents=True)
    return kept


@pytest.fixture
def ranging(memory: BeamsFile) -> Iterator[RangingController]:
    with RangingController(POINTERS, CALIBRATION, 1.333, MonotonicClock(), 0.1, memory) as made:
        yield made


def test_a_dark_frame_without_a_dot_is_no_fault(ranging: RangingController, caplog: pytest.LogCaptureFixture) -> None:
    assert ranging.shining(BRIGHT, DARK) is None
    assert caplog.text == ""


def test_a_disk_that_does_not_answer_ends_neither_scan_nor_service(
    memory: BeamsFile, ranging: RangingController, caplog: pytest.LogCaptureFixture
) -> None:
    os.mkfifo(memory.path)  # whoever reads it waits
    assert ranging.shining(BRIGHT, DARK) is None
    assert "lasers in the dark frame: no answer within 3 s" in caplog.text
    with memory.path.open("wb"):  # it answers after all
        pass


def test_images_that_cannot_be_judged_end_neither_scan_nor_service(
    ranging: RangingController, caplog: pytest.LogCaptureFixture
) -> None:
    assert ranging.shining(BRIGHT, {"left": DARK["left"]}) is None
    assert "lasers in the dark frame: not judged: 'right'" in caplog.text


def test_the_marks_of_the_dots_are_known_once_the_lasers_are_on_and_only_then(ranging: RangingController) -> None:
    ranging.live(True, CALIBRATION, 1.333)
    assert ranging.marks is None
    shown = _looked_at(ranging, lambda: ranging.wants_lasers)
    assert shown
    assert ranging.marks is None, "the lasers are off"
    ranging.switched_on(LaserState(True, True))
    assert _looked_at(ranging, lambda: ranging.marks is not None)
    ranging.stop()
    assert ranging.marks is None


def test_a_distance_of_more_than_a_second_ago_is_shown_no_longer() -> None:
    clock = SteppedClock()
    with RangingController(POINTERS, CALIBRATION, 1.333, clock, 0.05) as ranging:
        ranging.live(True, CALIBRATION, 1.333)
        clock.advance_s(1.0)
        assert _looked_at(ranging, lambda: ranging.wants_lasers)
        ranging.switched_on(LaserState(True, True))
        clock.advance_s(1.0)
        for side, image in _with_a_dot().items():
            ranging.see(side, image)
        until = time.monotonic() + 20.0
        while not (told := ranging.poll()) and time.monotonic() < until:
            time.sleep(0.02)
        (shown,) = told
        assert isinstance(shown, events.Ranged)
        assert shown.range is not None
        clock.advance_s(1.0)
        assert ranging.poll() == []
        clock.advance_s(1e-9)
        assert ranging.poll() == [events.Ranged(None)]


def _with_a_dot() -> dict[str, NDArray[np.uint8]]:
    """Images of both cameras with the left pointer's dot on something 430 mm away."""
    v, u = np.mgrid[:300, :400]
    rig, found = CALIBRATION.rig, {}
    place = RigFrame.of(rig).to_left(POINTERS.beams()[0].at(np.array(430.0)))
    for side, camera in (("left", rig.left), ("right", rig.right)):
        at_u, at_v = camera.project(place, 1.333).tolist()
        dot = 120.0 * np.exp(-((u - at_u) ** 2 + (v - at_v) ** 2) / (2.0 * 1.5**2))
        found[side] = (BRIGHT[side] + dot).astype(np.uint8)
    return found


def _looked_at(ranging: RangingController, enough: Callable[[], bool]) -> bool:
    until = time.monotonic() + 20.0
    while not enough() and time.monotonic() < until:
        for side, image in BRIGHT.items():
            ranging.see(side, image)
        time.sleep(0.02)
        ranging.poll()
    return enough()
