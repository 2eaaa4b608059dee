"""The images' proof that the lasers were off: where it comes to nothing, the scan and the service go on."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from appliance.ranging.beams import Pointers
from appliance.service.ranging import RangingController
from appliance.storage.beams import BeamsFile
from drivers.api import LaserState
from drivers.native import MonotonicClock
from hw_sim.truth import draw_truth
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


def _looked_at(ranging: RangingController, enough: Callable[[], bool]) -> bool:
    until = time.monotonic() + 20.0
    while not enough() and time.monotonic() < until:
        for side, image in BRIGHT.items():
            ranging.see(side, image)
        time.sleep(0.02)
        ranging.poll()
    return enough()
