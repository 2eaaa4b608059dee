"""The images' proof that the lasers were off: where it comes to nothing, the scan and the service go on."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from appliance.capture.ranging_beams import Pointers
from appliance.service.ranging import RangingDesk
from appliance.storage.beams import BeamsFile
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
def desk(memory: BeamsFile) -> Iterator[RangingDesk]:
    with RangingDesk(POINTERS, CALIBRATION, 1.333, MonotonicClock(), 0.1, memory) as made:
        yield made


def test_a_dark_frame_without_a_dot_is_no_fault(desk: RangingDesk, caplog: pytest.LogCaptureFixture) -> None:
    assert desk.shining(BRIGHT, DARK) is None
    assert caplog.text == ""


def test_a_disk_that_does_not_answer_ends_neither_scan_nor_service(
    memory: BeamsFile, desk: RangingDesk, caplog: pytest.LogCaptureFixture
) -> None:
    os.mkfifo(memory.path)  # whoever reads it waits
    assert desk.shining(BRIGHT, DARK) is None
    assert "lasers in the dark frame: no answer within 3 s" in caplog.text
    with memory.path.open("wb"):  # it answers after all
        pass


def test_images_that_cannot_be_judged_end_neither_scan_nor_service(
    desk: RangingDesk, caplog: pytest.LogCaptureFixture
) -> None:
    assert desk.shining(BRIGHT, {"left": DARK["left"]}) is None
    assert "lasers in the dark frame: not judged: 'right'" in caplog.text
