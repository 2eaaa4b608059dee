"""Owns what the frames of an armed sequence say about the cameras' triggers: all of them, half of them, none, or others."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from appliance.bringup.finding import Finding

PULSES = 64
"""Pulses of the sequence: as many as the board fires."""
NEAR = 0.1
"""Largest distance of frames from a whole number of periods, in periods."""
ALL_BUT = 2
"""Frames that may be missing from every second one: where the first or the last falls is chance."""


@dataclass(frozen=True, slots=True)
class FiredFrames:
    """Frames of one camera in an armed sequence."""

    times_ns: tuple[int | None, ...]
    """Begin of exposure of each whole frame by the camera's clock, ``None`` where it has none."""
    bad: tuple[str, ...] = ()
    """Words of the driver about frames that were not whole."""


def judge_triggers(pulses: int, cameras: Mapping[str, FiredFrames], period_ns: float) -> tuple[Finding, ...]:
    """Judge a sequence of ``PULSES`` triggers, of which the board reported ``pulses``: the board first, then each camera."""
    limits = f"{PULSES} of {PULSES}"
    said = f"the board fired {pulses} of {PULSES} pulses"
    remedy = (
        ""
        if pulses == PULSES
        else "check the tap of the projector's vertical sync, and that the projector's output is lit"
    )
    found = [Finding("pulses", pulses == PULSES, said, limits, remedy, {"pulses": float(pulses)})]
    return (*found, *(_camera(side, frames, period_ns) for side, frames in cameras.items()))


def _camera(side: str, frames: FiredFrames, period_ns: float) -> Finding:
    name, count = f"camera.{side}", len(frames.times_ns)
    steps = _steps(frames.times_ns, period_ns)
    numbers: dict[str, float | None] = {
        "frames": float(count),
        "periods_between": None if not steps else float(np.median(steps)),
    }
    limits = f"{PULSES} frames, one a period"
    said = f"{count} frames of {PULSES} pulses"
    if frames.bad:
        remedy = "check the USB cable and that each camera has a port of its own"
        return Finding(name, False, f"{said}; one arrived {frames.bad[0]}", limits, remedy, numbers)
    # From the most to the least telling: none at all and every second one have one cause each, other numbers have many.
    if count == 0:
        remedy = (
            f"check the line's wire and level, and trigger_source of [camera.{side}]: the input that the wire leads to"
        )
        return Finding(
            name, False, f"no frame of {PULSES} pulses: the camera does not see its line", limits, remedy, numbers
        )
    every_second = abs(count - PULSES // 2) <= ALL_BUT and (not steps or abs(float(np.median(steps)) - 2.0) < NEAR)
    if every_second:
        remedy = (
            "let exposure and readout overlap (TriggerOverlap ReadOut, OverlapMode On), switch DeviceLinkThroughputLimitMode off, "
            "or shorten the exposure"
        )
        return Finding(name, False, f"{said}: every second trigger is ignored", limits, remedy, numbers)
    if count > PULSES:
        remedy = "switch TriggerMode on for FrameStart and off for all other triggers; two edges of one pulse are noise on the line"
        return Finding(name, False, f"{said}: it exposes without being asked", limits, remedy, numbers)
    if count < PULSES:
        remedy = "look for a loose line, pulses too short for its opto-coupler (200 µs and more), or a frame rate limit (AcquisitionFrameRate)"
        return Finding(name, False, f"{said}: some triggers are lost", limits, remedy, numbers)
    # As many frames as pulses may still be others: one that was missed and one too many make up for each other.
    if any(abs(step - 1.0) > NEAR for step in steps):
        worst = max(steps, key=lambda step: abs(step - 1.0))
        remedy = "look for noise on the line: some pulses are missed and others seen twice"
        return Finding(name, False, f"{said}, but two are {worst:.2f} periods apart", limits, remedy, numbers)
    return Finding(name, True, f"{said}, one a period", limits, "", numbers)


def _steps(times_ns: Sequence[int | None], period_ns: float) -> list[float]:
    """Return the times between frames in periods; empty where the camera has no clock."""
    known = [time for time in times_ns if time is not None]
    # Half of a list would put two frames next to each other that are not.
    if len(known) != len(times_ns):
        return []
    return [(b - a) / period_ns for a, b in itertools.pairwise(known)]
