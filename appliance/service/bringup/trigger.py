"""Owns the step ``trigger``: 64 pulses as the rig file says, and what board and cameras make of them."""

from __future__ import annotations

import numpy as np

from appliance.bringup.bench import Shot
from appliance.bringup.finding import Finding
from appliance.bringup.guide import StepOutcome
from appliance.bringup.stamps_check import judge_stamps
from appliance.bringup.triggers import PULSES, FiredFrames, judge_triggers
from appliance.capture.ledger import Ledger
from appliance.capture.scan import CaptureReport
from appliance.config import Rig
from appliance.service.bringup.workplace import Workplace
from appliance.service.light_bench import LightBench, bench_on
from drivers.api import FrameStatus


def trigger_step(at: Workplace) -> StepOutcome:
    """Do the step. Raises DeviceError, BringupError."""
    at.say("firing", None)
    with bench_on(at.rig, at.wires) as bench:
        return StepOutcome(trigger_findings(fired(bench, at.rig).ledger))


def fired(bench: LightBench, rig: Rig, exposure_us: int | None = None) -> CaptureReport:
    """Fire ``PULSES`` triggers with delay, exposure (unless another one is given) and gain of the rig file, the projector black.

    Raises DeviceError, BringupError.
    """
    black = np.zeros((rig.projector.height_px, rig.projector.width_px), np.uint8)
    time_us = round(1000.0 * rig.camera.left.exposure_ms) if exposure_us is None else exposure_us
    shot = Shot(rig.board.trigger_delay_us, time_us, rig.camera.left.gain_db)
    # Black: what the frames show is of no interest here, and a lit wall would only warm the lamp.
    bench.load([black], all_channels=False)
    return bench.record([0] * PULSES, shot)


def trigger_findings(ledger: Ledger) -> tuple[Finding, ...]:
    """Judge what was recorded of ``PULSES`` triggers: counts first, then times."""
    cameras = {
        side: FiredFrames(
            tuple(one.camera_time_ns for one in frames if one.status is FrameStatus.COMPLETE),
            # A frame that never came is no bad one: counting tells about those.
            tuple(one.status.value for one in frames if one.status not in (FrameStatus.COMPLETE, FrameStatus.TIMEOUT)),
        )
        for side, frames in ledger.frames.items()
    }
    # In this order: which pulse made which frame is known only where both are as many.
    counted = judge_triggers(len(ledger.pulses), cameras, ledger.period_ns)
    # Only of as many frames as pulses is it known which belongs to which.
    whole = {side: one.times_ns for side, one in cameras.items() if len(one.times_ns) == len(ledger.pulses) == PULSES}
    return (*counted, *judge_stamps([pulse.board_time_us for pulse in ledger.pulses], whole))
