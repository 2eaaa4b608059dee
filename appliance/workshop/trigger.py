"""The step ``trigger``: 64 pulses, the frames of both cameras, and their times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from appliance.instrument import CaptureReport, Ledger
from appliance.store import Rig
from appliance.workshop.bench import LightBench, Shot, bench_on, light_bench
from appliance.workshop.finding import Finding, finding_of
from appliance.workshop.step import StepOutcome, Workplace
from drivers.api import FrameStatus

PULSES = 64
"""Number of pulses of the sequence: as many as the board fires."""
NEAR = 0.1
"""Largest distance of frames from a whole number of periods, in periods."""
ALL_BUT = 2
"""Tolerance of the number of frames if every second one is missing: the first and the last are chance."""
MOST_JITTER_US = 20.0
"""Largest distance of a stamp from the straight line: an opto-coupler rises within some µs, and ``skew`` has the same
limit."""
MOST_DRIFT_PPM = 200.0
"""Largest difference of rate of two clocks of 100 ppm each."""
FEWEST_STAMPS = 8


@dataclass(frozen=True, slots=True)
class TriggeredFrames:
    """Frames of one camera in an armed sequence."""

    times_ns: tuple[int | None, ...]
    """Begin of exposure of each complete frame by the camera's clock, ``None`` where it has none."""
    bad: tuple[str, ...] = ()
    """Status of each other frame, in the driver's words."""


def do(workplace: Workplace) -> StepOutcome:
    """Do the step. Raises DeviceError, BringupError."""
    workplace.say("firing")
    with bench_on(workplace.rig, workplace.wires) as bench:
        return StepOutcome(trigger_findings(fire_triggers(bench, workplace.rig).ledger))


def measure_trigger(rig: Rig) -> tuple[Finding, ...]:
    """Fire ``PULSES`` triggers on the bench of ``rig`` and judge them.

    Raises DeviceError, BringupError, StorageError.
    """
    with light_bench(rig) as bench:
        return trigger_findings(fire_triggers(bench, rig).ledger)


def fire_triggers(bench: LightBench, rig: Rig, exposure_us: int | None = None) -> CaptureReport:
    """Fire ``PULSES`` triggers with delay and gain of the rig file, while the projector is black.

    ``exposure_us``: by default the rig file's. Raises DeviceError, BringupError.
    """
    black = np.zeros((rig.projector.height_px, rig.projector.width_px), np.uint8)
    time_us = round(1000.0 * rig.camera.left.exposure_ms) if exposure_us is None else exposure_us
    shot = Shot(rig.board.trigger_delay_us, time_us, rig.camera.left.gain_db)
    # Black: the content of the frames does not matter here, and light would only warm the lamp.
    bench.load([black], all_channels=False)
    return bench.record([0] * PULSES, shot)


def trigger_findings(ledger: Ledger) -> tuple[Finding, ...]:
    """Judge the recording of ``PULSES`` triggers: counts first, then times."""
    cameras = {
        side: TriggeredFrames(
            tuple(frame.camera_time_ns for frame in frames if frame.status is FrameStatus.COMPLETE),
            # A frame that timed out is missing, not bad: the count shows it.
            tuple(
                frame.status.value
                for frame in frames
                if frame.status not in (FrameStatus.COMPLETE, FrameStatus.TIMEOUT)
            ),
        )
        for side, frames in ledger.frames.items()
    }
    # Counts first: only with as many frames as pulses is it known which pulse made which frame.
    counted = judge_triggers(len(ledger.pulses), cameras, ledger.period_ns)
    # Times are compared only with as many frames as pulses.
    complete = {
        side: frame.times_ns for side, frame in cameras.items() if len(frame.times_ns) == len(ledger.pulses) == PULSES
    }
    return (*counted, *judge_stamps([pulse.board_time_us for pulse in ledger.pulses], complete))


def judge_triggers(pulses: int, cameras: Mapping[str, TriggeredFrames], period_ns: float) -> tuple[Finding, ...]:
    """Judge a sequence of ``PULSES`` triggers: the board, which reported ``pulses``, then each camera."""
    statement, limits = f"the board fired {pulses} of {PULSES} pulses", f"{PULSES} of {PULSES}"
    remedy = "check the tap of the projector's vertical sync, and that the projector's output is lit"
    board = finding_of("pulses", pulses == PULSES, statement, limits, remedy, pulses=pulses)
    return (board, *(_camera(side, frames, period_ns) for side, frames in cameras.items()))


def _camera(side: str, frames: TriggeredFrames, period_ns: float) -> Finding:
    count, steps = len(frames.times_ns), _steps(frames.times_ns, period_ns)
    between = float(np.median(steps)) if steps else None
    worst = max(steps, key=lambda step: abs(step - 1.0), default=1.0)
    statement, limits, remedy = f"{count} frames of {PULSES} pulses", f"{PULSES} frames, one a period", ""
    if frames.bad:
        statement += f"; one arrived {frames.bad[0]}"
        remedy = "check the USB cable and that each camera has a port of its own"
    # Numbers with a single cause first: no frame at all, every second frame. Other numbers have many causes.
    elif count == 0:
        statement = f"no frame of {PULSES} pulses: the camera does not get its trigger"
        remedy = (
            f"check the line's wire and level, and trigger_source of [camera.{side}]: the input that the wire leads to"
        )
    elif abs(count - PULSES // 2) <= ALL_BUT and (between is None or abs(between - 2.0) < NEAR):
        statement += ": every second trigger is ignored"
        remedy = (
            "let exposure and readout overlap (TriggerOverlap ReadOut, OverlapMode On), switch "
            "DeviceLinkThroughputLimitMode off, "
            "or shorten the exposure"
        )
    elif count > PULSES:
        statement += ": it exposes without a trigger"
        remedy = "switch TriggerMode on for FrameStart and off for all other triggers; two edges of one pulse are noise on the line"
    elif count < PULSES:
        statement += ": some triggers are lost"
        remedy = "look for a loose line, pulses too short for its opto-coupler (200 µs and more), or a frame rate limit (AcquisitionFrameRate)"
    # As many frames as pulses may still be wrong: one missed and one extra frame cancel out.
    elif abs(worst - 1.0) > NEAR:
        statement += f", but two are {worst:.2f} periods apart"
        remedy = "look for noise on the line: some pulses are missed and others seen twice"
    else:
        statement += ", one a period"
    return finding_of(f"camera.{side}", not remedy, statement, limits, remedy, frames=count, periods_between=between)


def _steps(times_ns: Sequence[int | None], period_ns: float) -> list[float]:
    """Return the times between frames in periods; empty where the camera has no clock."""
    known_ns = [time for time in times_ns if time is not None]
    # With missing times, two frames would seem neighbours that are not.
    if len(known_ns) != len(times_ns):
        return []
    return [(b - a) / period_ns for a, b in pairwise(known_ns)]


def judge_stamps(pulses_us: Sequence[int], cameras: Mapping[str, Sequence[int | None]]) -> tuple[Finding, ...]:
    """Compare the board's times of pulses with the cameras' times of their frames, by side.

    Frames' times are in ns by each camera's clock. With another number of frames than of pulses the finding says that
    they cannot be compared.
    """
    return tuple(_stamps(f"stamps.{side}", pulses_us, times_ns) for side, times_ns in cameras.items())


def _stamps(name: str, pulses_us: Sequence[int], times_ns: Sequence[int | None]) -> Finding:
    limits = f"jitter up to {MOST_JITTER_US:g} µs, drift up to {MOST_DRIFT_PPM:g} ppm"
    known_ns = [time_ns for time_ns in times_ns if time_ns is not None]
    if len(known_ns) < len(times_ns):
        return Finding(name, True, "the camera has no clock: its frames are assigned by their count alone", limits)
    if len(known_ns) != len(pulses_us) or len(known_ns) < FEWEST_STAMPS:
        statement = f"{len(known_ns)} stamps of frames and {len(pulses_us)} of pulses cannot be compared"
        return Finding(
            name, False, statement, limits, "first make sure that each pulse makes a frame: see the findings above"
        )
    # Relative to the first one: absolute times of a clock would lose digits.
    pulses = np.array([time_us - pulses_us[0] for time_us in pulses_us], np.float64)
    frames = np.array([(time_ns - known_ns[0]) / 1000.0 for time_ns in known_ns], np.float64)
    rate, _ = line = np.polyfit(pulses, frames, 1)
    deviations_us = np.abs(frames - np.polyval(line, pulses))
    jitter_us, drift_ppm = float(deviations_us.max()), (float(rate) - 1.0) * 1e6
    jitter_rms_us = float(np.sqrt((deviations_us**2).mean()))
    statement, remedy = f"exposures follow pulses to {jitter_us:.1f} µs; the clocks run {drift_ppm:+.0f} ppm apart", ""
    # Jitter first: an outlier among the stamps changes the line from which the drift is read.
    if jitter_us > MOST_JITTER_US:
        remedy = (
            "drive the opto-coupler with 3.5 to 7 mA and pulses of 200 µs; no LineDebouncer; a ground wire beside the "
            "trigger's; "
            f"frame {int(deviations_us.argmax())} is the worst"
        )
    elif abs(drift_ppm) > MOST_DRIFT_PPM:
        remedy = (
            "one of the clocks is wrong: check the unit of the camera's time stamps "
            "(GevTimestampTickFrequency), and the board's crystal"
        )
    numbers = {"jitter_us": jitter_us, "jitter_rms_us": jitter_rms_us, "drift_ppm": drift_ppm}
    return finding_of(name, not remedy, statement, limits, remedy, **numbers)
