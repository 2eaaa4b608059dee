"""How long capture waits for devices: seconds at an ordinary rate, and periods where the projector is slow."""

from __future__ import annotations

import pytest

from appliance.capture.timeouts import Timeouts


def test_at_60_hz_the_seconds_count() -> None:
    p = Timeouts(60.0)
    found = (p.ready_s, p.first_frame_s, p.next_frame_s, p.silence_s, p.collect_s, p.pulse_s, p.margin_s)
    assert found == pytest.approx((2.0, 2.0, 0.15, 0.035, 2.5, 0.25, 5.0))


def test_at_one_picture_a_second_the_periods_count() -> None:
    p = Timeouts(1.0)
    found = (p.ready_s, p.first_frame_s, p.next_frame_s, p.silence_s, p.collect_s, p.pulse_s, p.margin_s)
    assert found == pytest.approx((12.0, 24.0, 9.0, 2.1, 12.0, 3.0, 40.0))
