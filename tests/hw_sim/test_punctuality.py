"""The world tells a host that answers a blank late from a blank that came late itself."""

from __future__ import annotations

import time

import pytest

from hw_sim.devices.head import Dumb, Flip, Framebuffer
from hw_sim.punctuality import Punctuality

PICTURE = Framebuffer(1, 1, 1, 4, 24, Dumb(4, bytearray(4)))


def flip() -> Flip:
    return Flip(PICTURE, 0, None)


def test_a_late_answer_is_as_long_as_it_took_and_a_blank_without_a_flip_is_missed() -> None:
    seen = Punctuality()
    seen.blank(0, True, flip(), None)
    begun_ns = time.monotonic_ns()
    seen.blank(0, True, None, None)
    time.sleep(0.02)
    asked = flip()
    took_us = (asked.asked_ns - begun_ns) / 1e3
    time.sleep(0.02)  # until the blank comes: not the host's
    seen.blank(3_000_000, True, asked, None)
    assert list(seen.answers_us) == [pytest.approx(took_us, abs=1000.0)]
    assert seen.answers_us[0] > 20_000.0
    assert seen.missed == 1
    assert list(seen.blanks_late_us) == [0.0, 0.0, 3000.0]


def test_pictures_on_the_display_count_between_sequences_only() -> None:
    seen = Punctuality()
    for recording in (True, False, False):
        seen.blank(0, recording, flip(), flip())
    seen.blank(0, False, flip(), None)
    assert (seen.other_blanks, seen.screen_updates) == (3, 2)
    assert len(seen.blanks_late_us) == 1
