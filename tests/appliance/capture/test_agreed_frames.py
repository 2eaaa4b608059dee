"""How many of the first frames of a broken sequence all four witnesses agree on."""

from __future__ import annotations

from dataclasses import replace

import pytest

from appliance.capture.ledger import agreed_frames, audit
from drivers.api import FrameStatus
from tests.appliance.capture.test_ledger import N, clean, with_frames


def test_a_whole_sequence_is_agreed_on_to_the_last_frame() -> None:
    assert agreed_frames(clean()) == N


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("k", [1, 14, 23])
def test_a_camera_that_ended_is_agreed_on_as_far_as_it_came(side: str, k: int) -> None:
    ledger = with_frames(clean(), side, list(clean().frames[side][:k]))
    assert audit(ledger) is not None
    assert agreed_frames(ledger) == k


@pytest.mark.parametrize("k", [1, 14, 22])
def test_frames_behind_a_lost_one_are_not_counted(k: int) -> None:
    frames = [frame for n, frame in enumerate(clean().frames["left"]) if n != k]
    assert agreed_frames(with_frames(clean(), "left", frames)) == k


def test_a_damaged_frame_and_all_behind_it_are_not_counted() -> None:
    frames = list(clean().frames["right"])
    frames[17] = replace(frames[17], status=FrameStatus.TRUNCATED)
    assert agreed_frames(with_frames(clean(), "right", frames)) == 17


def test_patterns_that_came_late_end_what_is_agreed_on() -> None:
    ledger = clean()
    assert agreed_frames(replace(ledger, flips=ledger.flips[:16])) == 16
    late = tuple(replace(flip, sequence=(flip.sequence or 0) + (k >= 19)) for k, flip in enumerate(ledger.flips))
    assert agreed_frames(replace(ledger, flips=late)) == 19
    assert agreed_frames(replace(ledger, pulses=ledger.pulses[:15])) == 15


def test_frames_that_nobody_else_saw_are_none() -> None:
    ledger = clean()
    assert agreed_frames(replace(ledger, flips=())) == 0
    assert agreed_frames(replace(ledger, sync=None)) == 0
    # One camera exposes all of its frames late: none of them shows what the other's do.
    late = [replace(f, camera_time_ns=(f.camera_time_ns or 0) + 2_000_000) for f in ledger.frames["right"]]
    assert agreed_frames(with_frames(ledger, "right", late)) == 0
