"""Owns the step ``trigger``: 64 pulses as the rig file says, what board and cameras make of them, and how their times
compare."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from appliance.instrument import CaptureReport, Ledger
from appliance.store import Rig
from appliance.workshop.bench import LightBench, Shot, bench_on, light_bench
from appliance.workshop.finding import Finding, judged
from appliance.workshop.step import StepOutcome, Workplace
from drivers.api import FrameStatus

PULSES = 64
"""Pulses of the sequence: as many as the board fires."""
NEAR = 0.1
"""Largest distance of frames from a whole number of periods, in periods."""
ALL_BUT = 2
"""Frames that may be missing from every second one: where the first or the last falls is chance."""
MOST_JITTER_US = 20.0
"""Largest distance of a stamp from the straight line: an opto-coupler rises within some µs, and light is skewed by this
much at most."""
MOST_DRIFT_PPM = 200.0
"""Largest difference of rate of two clocks of 100 ppm each."""
FEWEST_STAMPS = 8


@dataclass(frozen=True, slots=True)
class FiredFrames:
    """Frames of one camera in an armed sequence."""

    times_ns: tuple[int | None, ...]
    """Begin of exposure of each whole frame by the camera's clock, ``None`` where it has none."""
    bad: tuple[str, ...] = ()
    """Words of the driver about frames that were not whole."""


def do(at: Workplace) -> StepOutcome:
    """Do the step. Raises DeviceError, BringupError."""
    at.say("firing")
    with bench_on(at.rig, at.wires) as bench:
        return StepOutcome(trigger_findings(fired(bench, at.rig).ledger))


def measure_trigger(rig: Rig) -> tuple[Finding, ...]:
    """Fire ``PULSES`` triggers on the bench of ``rig`` and judge them.

    Raises DeviceError, BringupError, StorageError.
    """
    with light_bench(rig) as bench:
        return trigger_findings(fired(bench, rig).ledger)


def fired(bench: LightBench, rig: Rig, exposure_us: int | None = None) -> CaptureReport:
    """Fire ``PULSES`` triggers with delay, exposure (unless another one is given) and gain of the rig file, the
    projector black.

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


def judge_triggers(pulses: int, cameras: Mapping[str, FiredFrames], period_ns: float) -> tuple[Finding, ...]:
    """Judge a sequence of ``PULSES`` triggers, of which the board reported ``pulses``: the board first, then each
    camera."""
    said, limits = f"the board fired {pulses} of {PULSES} pulses", f"{PULSES} of {PULSES}"
    remedy = "check the tap of the projector's vertical sync, and that the projector's output is lit"
    board = judged("pulses", pulses == PULSES, said, limits, remedy, pulses=pulses)
    return (board, *(_camera(side, frames, period_ns) for side, frames in cameras.items()))


def _camera(side: str, frames: FiredFrames, period_ns: float) -> Finding:
    count, steps = len(frames.times_ns), _steps(frames.times_ns, period_ns)
    between = float(np.median(steps)) if steps else None
    worst = max(steps, key=lambda step: abs(step - 1.0), default=1.0)
    said, limits, remedy = f"{count} frames of {PULSES} pulses", f"{PULSES} frames, one a period", ""
    if frames.bad:
        said += f"; one arrived {frames.bad[0]}"
        remedy = "check the USB cable and that each camera has a port of its own"
    # From the most to the least telling: none at all and every second one have one cause each, other numbers have many.
    elif count == 0:
        said = f"no frame of {PULSES} pulses: the camera does not see its line"
        remedy = (
            f"check the line's wire and level, and trigger_source of [camera.{side}]: the input that the wire leads to"
        )
    elif abs(count - PULSES // 2) <= ALL_BUT and (between is None or abs(between - 2.0) < NEAR):
        said += ": every second trigger is ignored"
        remedy = (
            "let exposure and readout overlap (TriggerOverlap ReadOut, OverlapMode On), switch "
            "DeviceLinkThroughputLimitMode off, "
            "or shorten the exposure"
        )
    elif count > PULSES:
        said += ": it exposes without being asked"
        remedy = "switch TriggerMode on for FrameStart and off for all other triggers; two edges of one pulse are noise on the line"
    elif count < PULSES:
        said += ": some triggers are lost"
        remedy = "look for a loose line, pulses too short for its opto-coupler (200 µs and more), or a frame rate limit (AcquisitionFrameRate)"
    # As many frames as pulses may still be others: one that was missed and one too many make up for each other.
    elif abs(worst - 1.0) > NEAR:
        said += f", but two are {worst:.2f} periods apart"
        remedy = "look for noise on the line: some pulses are missed and others seen twice"
    else:
        said += ", one a period"
    return judged(f"camera.{side}", not remedy, said, limits, remedy, frames=count, periods_between=between)


def _steps(times_ns: Sequence[int | None], period_ns: float) -> list[float]:
    """Return the times between frames in periods; empty where the camera has no clock."""
    known = [time for time in times_ns if time is not None]
    # Half of a list would put two frames next to each other that are not.
    if len(known) != len(times_ns):
        return []
    return [(b - a) / period_ns for a, b in pairwise(known)]


def judge_stamps(pulses_us: Sequence[int], cameras: Mapping[str, Sequence[int | None]]) -> tuple[Finding, ...]:
    """Compare the board's times of pulses with the cameras' of the frames that they made, ns by each camera's clock; by
    side.

    Where there are not as many of both nothing can be compared: counting says so.
    """
    return tuple(_stamps(f"stamps.{side}", pulses_us, times_ns) for side, times_ns in cameras.items())


def _stamps(name: str, pulses_us: Sequence[int], times_ns: Sequence[int | None]) -> Finding:
    limits = f"jitter up to {MOST_JITTER_US:g} µs, drift up to {MOST_DRIFT_PPM:g} ppm"
    known = [time_ns for time_ns in times_ns if time_ns is not None]
    if len(known) < len(times_ns):
        return Finding(name, True, "the camera has no clock: its frames are told by their count alone", limits)
    if len(known) != len(pulses_us) or len(known) < FEWEST_STAMPS:
        said = f"{len(known)} stamps of frames and {len(pulses_us)} of pulses cannot be compared"
        return Finding(name, False, said, limits, "first see that each pulse makes a frame: the findings above say how")
    # From the first one on: a clock begins anywhere, and digits would be lost.
    pulses = np.array([time_us - pulses_us[0] for time_us in pulses_us], np.float64)
    frames = np.array([(time_ns - known[0]) / 1000.0 for time_ns in known], np.float64)
    rate, _ = line = np.polyfit(pulses, frames, 1)
    away_us = np.abs(frames - np.polyval(line, pulses))
    jitter_us, drift_ppm = float(away_us.max()), (float(rate) - 1.0) * 1e6
    jitter_rms_us = float(np.sqrt((away_us**2).mean()))
    said, remedy = f"exposures follow pulses to {jitter_us:.1f} µs; the clocks run {drift_ppm:+.0f} ppm apart", ""
    # Jitter first: a stamp that jumps bends the line that the drift is read from.
    if jitter_us > MOST_JITTER_US:
        remedy = (
            "drive the opto-coupler with 3.5 to 7 mA and pulses of 200 µs; no LineDebouncer; a ground wire beside the "
            "trigger's; "
            f"frame {int(away_us.argmax())} is the worst"
        )
    elif abs(drift_ppm) > MOST_DRIFT_PPM:
        remedy = "one of the clocks is none: check the unit of the camera's time stamps (GevTimestampTickFrequency), and the board's crystal"
    numbers = {"jitter_us": jitter_us, "jitter_rms_us": jitter_rms_us, "drift_ppm": drift_ppm}
    return judged(name, not remedy, said, limits, remedy, **numbers)
