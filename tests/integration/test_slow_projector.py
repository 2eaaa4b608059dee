"""A projector of 2 Hz records the same scan as one of 60 Hz: what capture waits for is counted in its periods."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.capture.timeouts import Timeouts
from appliance.scan.fault import FaultCode
from tests.integration.test_every_frame_fault import N, bench_of


def test_a_scan_at_2_hz_comes_about_and_a_lost_frame_is_still_named() -> None:
    with bench_of("slow-projector", 2.0, 20.0) as bench:
        report = bench.record()
        assert report.fault is None
        assert report.recording_s > (N - 1) / 2.0, "of the world's time"
        flips = [flip.time_ns for flip in report.ledger.flips]
        assert np.diff(flips) == pytest.approx([0.5e9] * (N - 1), rel=1e-3)
        bright, dark = bench.store.frames("left")[:2]
        assert np.median(bright) > 100 > 20 > np.median(dark)
        bench.world.fault(f"camera.right intermittent frame={N // 2}")
        lost = bench.record().fault
        assert lost is not None
        assert (lost.code, lost.device) == (FaultCode.FRAME_MISSING, "camera.right")
        bench.world.clear_faults()
        assert bench.record().fault is None


def test_at_60_hz_seconds_count_and_at_2_hz_periods() -> None:
    def limits(refresh_hz: float) -> tuple[float, ...]:
        p = Timeouts(refresh_hz)
        return p.ready_s, p.first_frame_s, p.next_frame_s, p.silence_s, p.collect_s, p.pulse_s, p.margin_s

    assert limits(60.0) == (2.0, 2.0, 0.15, 0.035, 2.5, 0.25, 5.0)
    assert limits(120.0) == (2.0, 2.0, 0.15, 0.035, 2.5, 0.25, 5.0), "a host is not quicker for it"
    assert limits(2.0) == (6.0, 12.0, 4.5, 1.05, 6.0, 1.5, 20.0)
    for refresh_hz in (1.0, 2.0, 24.0, 60.0, 240.0):
        p = Timeouts(refresh_hz)
        assert p.silence_s > 2.0 / refresh_hz, "a frame too many is waited for"
        assert p.collect_s > p.next_frame_s + p.silence_s, "a camera that misses its last frame has said so by then"
