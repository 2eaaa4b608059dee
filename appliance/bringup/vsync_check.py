"""Owns what the tap of the projector's vertical sync must be like: its rate, its jitter, its count, and that it ends with the picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from appliance.bringup.finding import Finding

MOST_OFF_HZ = 0.1
MOST_JITTER_US = 5.0
FLIPS = 600
"""Flips over which syncs are counted: ten seconds, in which one lost in a minute would still hide, but none of noise."""
FEWEST_STAMPS = 20


@dataclass(frozen=True, slots=True)
class VsyncSeen:
    """Everything that was measured of a vertical sync."""

    refresh_hz: float
    """Rate of the rig file."""
    stamps: tuple[tuple[int, int], ...]
    """Numbers and board times, µs, of syncs, in order."""
    blanks: int
    """Vertical blanks of the graphics card between two of its flips."""
    syncs: int
    """Syncs of the board between the same two."""
    phase_us: float
    """Time of a sync after its flip, as board and kernel date them."""
    stopped_after_ms: float | None
    """Time from darkening the output until the board saw no more syncs; ``None``: it goes on."""


def judge_vsync(seen: VsyncSeen) -> tuple[Finding, ...]:
    """Judge everything that was measured of a vertical sync."""
    return (*judge_stamps_of_syncs(seen.stamps, seen.refresh_hz), _count(seen), _stop(seen), _edge(seen))


def judge_stamps_of_syncs(stamps: Sequence[tuple[int, int]], refresh_hz: float) -> tuple[Finding, Finding]:
    """Judge rate and jitter by a straight line through numbers and times of syncs."""
    limits = f"{refresh_hz:g} ± {MOST_OFF_HZ:g} Hz"
    jitter_limits = f"up to {MOST_JITTER_US:g} µs (stamps are whole µs)"
    if len(stamps) < FEWEST_STAMPS:
        said = f"{len(stamps)} syncs were seen"
        remedy = "check the tap of the projector's video, and that a splitter's second output is lit"
        return (
            Finding("rate", False, said, limits, remedy),
            Finding("jitter", False, said, jitter_limits, remedy),
        )
    # From the first one on: numbers of 32 bits and times of days would lose digits in a fit.
    numbers = np.array([number - stamps[0][0] for number, _ in stamps], np.float64)
    times_us = np.array([time_us - stamps[0][1] for _, time_us in stamps], np.float64)
    period_us, begin_us = np.polyfit(numbers, times_us, 1)
    away_us = float(np.abs(times_us - period_us * numbers - begin_us).max())
    rate_hz = 1e6 / float(period_us)
    rate_ok, jitter_ok = abs(rate_hz - refresh_hz) <= MOST_OFF_HZ, away_us <= MOST_JITTER_US
    # A whole multiple or a half is the tap's fault, anything else the mode's.
    factor = rate_hz / refresh_hz
    remedy = f"set refresh_hz of [projector] to the rate of the mode, or choose a mode of {refresh_hz:g} Hz"
    if not rate_ok and abs(factor - round(factor)) < 0.02 and factor > 1.5:
        remedy = "the board counts edges of horizontal sync, or both edges: check the tap's pin and the firmware's edge"
    elif not rate_ok and 0.45 < factor < 0.55:
        remedy = "the board misses every second sync: check the divider behind the tap (5 V to 3.3 V), and its level"
    rate = Finding("rate", rate_ok, f"{rate_hz:.3f} Hz", limits, "" if rate_ok else remedy, {"rate_hz": rate_hz})
    noisy = "series resistor and ground beside the sync's wire; stamp syncs in hardware, not in an interrupt"
    return rate, Finding(
        "jitter",
        jitter_ok,
        f"syncs are at most {away_us:.1f} µs away from an even beat",
        jitter_limits,
        "" if jitter_ok else noisy,
        {"jitter_us": away_us},
    )


def _count(seen: VsyncSeen) -> Finding:
    # Not a share: one sync that is lost or too many puts every later picture into the wrong frame.
    ok = seen.syncs == seen.blanks and seen.blanks > 0
    said = f"{seen.syncs} syncs in {seen.blanks} blanks of the graphics card"
    remedy = ""
    if not ok:
        remedy = (
            "noise is counted as syncs: ground beside the wire, a Schmitt trigger, a filter of a µs"
            if seen.syncs > seen.blanks
            else "syncs are missed: check the level behind the tap, and that nothing else uses the pin"
        )
    numbers: dict[str, float | None] = {"syncs": float(seen.syncs), "blanks": float(seen.blanks)}
    return Finding("count", ok, said, "as many syncs as blanks", remedy, numbers)


def _stop(seen: VsyncSeen) -> Finding:
    limits = "no syncs while the output is off"
    if seen.stopped_after_ms is None:
        remedy = (
            "the board counts something else: check the tap's pin and its ground; a splitter that makes a picture of its own "
            "while its input is dark cannot be used"
        )
        return Finding("stop", False, "syncs go on while the projector's output is off", limits, remedy)
    said = f"the last sync was told {seen.stopped_after_ms:.0f} ms after the output was switched off"
    return Finding("stop", True, said, limits, "", {"stopped_after_ms": seen.stopped_after_ms})


def _edge(seen: VsyncSeen) -> Finding:
    said = (
        f"which edge is counted cannot be told by the board's protocol; syncs are dated {seen.phase_us:+.0f} µs after the kernel's flips. The "
        "wrong one shifts every exposure by the pulse's width (some 120 µs): compare sync of [projector] with an oscilloscope"
    )
    return Finding("edge", True, said, "the leading edge", "", {"phase_us": seen.phase_us})
