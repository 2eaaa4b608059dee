"""The step ``light``: the lamp's light within a frame, the usable exposures, and their keys.

A profile is the light of one picture in slices of ``SLICE_US`` that follow each other without a gap, from a vertical
blank on. Its time 0 is the blank of the picture's flip.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.base import draw_curves
from appliance.measure import STEPS_MS
from appliance.store import Rig
from appliance.workshop.finding import BringupError, Finding, finding_of
from appliance.workshop.response import RAMP_CODES, STRAIGHT, ResponseShape, Shape, ramp_codes
from appliance.workshop.rig_edit import KeyValue, Value
from appliance.workshop.step import StepOutcome

Profile = NDArray[np.float64]

SLICE_US = 250
"""Length of a slice, and step of the delay: slices touch, so that none misses a short bit plane."""
ON_SHARE = 0.25
"""Share of the brightest slice from which the lamp is on."""
EARLY_US = 500.0
"""Largest time by which light may begin before its blank: tap of the vsync and controller may differ by that."""
OVERHANG_US = 100.0
"""Light that ends so much after the next blank is of a picture that begins late: slices locate an edge
to some 60 µs.
"""
MOST_SUB_FRAMES = 8
EQUAL = 0.05
"""Largest difference of the light of equal sub-frames from their mean."""
ALIKE = 0.9
"""Smallest correlation of the light's course in one sub-frame with the mean course."""
FLAT = 0.15
"""Relative standard deviation of the light below which it is constant."""
LEAST_US, MOST_US = 500, 16_000
"""Exposures that a scan may have; the longest is the widest pulse of the board."""
USUAL_DELAY_US = 500
MOST_DELAY_US = 15_000
MARGIN_US = 100
"""Time between the end of an exposure and the next picture's light."""
FEWEST = 6
"""Number of combinations that are measured in any case."""
UNPROMISING = 0.06
"""Largest predicted distance from a straight line at which a combination is tried: dim bits are uncertain by some
percent."""
NOT_ADDED = 0.1
"""Largest difference of all bits together from white, as a share."""
BRIGHTER = 1.1
"""Smallest ratio of light of one offered exposure to the next shorter one: while the lamp is dark, a longer one is
useless."""
PATTERN_MODE = "use a pattern mode of the controller (8 bits, equal sub-frames, one LED) or a mode in which one exposure holds the light of the whole frame"
MOST_CURVES = 5
KEYS = (
    "projector.latency_blanks",
    "projector.light_begins_us",
    "projector.channels",
    "projector.sub_frames",
    "board.trigger_delay_us",
    "scan.exposures_ms",
    "camera.left.exposure_ms",
    "camera.right.exposure_ms",
)
"""Keys of the rig file that the step writes."""


@dataclass(frozen=True, slots=True)
class LightWindow:
    """Time in which the lamp is on, in µs after the blank of the flip."""

    begins_us: float
    ends_us: float


@dataclass(frozen=True, slots=True)
class LightTiming:
    """Latency and windows of one picture's light."""

    latency_blanks: int
    begins_us: float
    """Beginning of its first window after the blank of that number; slightly negative where it comes earlier."""
    ends_us: float
    windows: tuple[LightWindow, ...]
    """Windows, in µs after the same blank."""

    def overhangs(self, period_us: float) -> bool:
        """Return True if the light goes on beyond the next blank."""
        return self.ends_us > period_us + OVERHANG_US


@dataclass(frozen=True, slots=True)
class Trial:
    """A delay and an exposure, µs."""

    delay_us: int
    exposure_us: int


@dataclass(frozen=True, slots=True)
class Offer:
    """A delay and the exposures that are good with it, for the rig file."""

    delay_us: int
    exposures_us: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Lamp:
    """All measurements of a projector's light."""

    timing: LightTiming
    channels: str
    """``green`` or ``all``."""
    sub_frames: int
    profiles: Mapping[int, Profile]
    """Light in slices, from the blank of the flip on, by code."""
    responses: Mapping[Trial, ResponseShape]
    ramps: Mapping[Trial, NDArray[np.float64]]
    """Share of white at each of ``ramp_codes``, (n,), by trial."""
    offer: Offer | None


def windows_of(profile: Profile) -> tuple[LightWindow, ...]:
    """Return the windows in which the lamp is on, with edges interpolated between slices.

    ``profile`` (n,) begins with the blank of the flip.
    """
    threshold = ON_SHARE * float(np.quantile(profile, 1.0 - 2.0 / len(profile)))
    on = np.concatenate([[False], profile > threshold, [False]])
    edges = np.flatnonzero(np.diff(on.astype(np.int8)))
    padded = np.concatenate([[0.0], profile, [0.0]])
    windows = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        # A slice at the edge is lit for a part of its length: its light over that of a full slice.
        inner = padded[first + 1 : last + 1]
        full = float(np.median(inner))
        begins = first + 1.0 - min(1.0, padded[first + 1] / full) - min(1.0, max(0.0, padded[first]) / full)
        ends = last - 1.0 + min(1.0, padded[last] / full) + min(1.0, max(0.0, padded[last + 1]) / full)
        windows.append(LightWindow(float(SLICE_US * begins), float(SLICE_US * ends)))
    return tuple(windows)


def timing_of(profile: Profile, period_us: float) -> LightTiming:
    """Return the timing of the light with a ``profile`` that begins with the blank of the flip.

    Raises BringupError if there is no light.
    """
    windows = windows_of(profile)
    if not windows:
        raise BringupError("no light in any time slice of the frame: check the lamp, and the cameras' gain")
    begins_us = windows[0].begins_us
    # Rounded down, with a margin: light that begins a line or two before a blank belongs to that blank.
    latency = max(0, int((begins_us + EARLY_US) // period_us))
    shift_us = latency * period_us
    moved = tuple(LightWindow(window.begins_us - shift_us, window.ends_us - shift_us) for window in windows)
    return LightTiming(latency, moved[0].begins_us, moved[-1].ends_us, moved)


def light_within(profile: Profile, begins_us: float, ends_us: float) -> float:
    """Return the light of a ``profile`` between two times after the blank of the flip."""
    edges_us = SLICE_US * np.arange(len(profile) + 1)
    sums = np.concatenate([[0.0], np.cumsum(profile)])
    return float(np.interp(ends_us, edges_us, sums) - np.interp(begins_us, edges_us, sums))


def sub_frames_of(profiles: Sequence[Profile], begins_us: float, period_us: float) -> int:
    """Return the number of equal sub-frames of a frame's light; 1 where it does not repeat or is constant.

    ``profiles`` are those of several codes, each (n,) from the blank of the flip on; the frame begins at ``begins_us``.
    Each code's bits must come alike in each sub-frame, or a part of the frame would weigh greys otherwise than the
    whole.
    """
    edges_us = np.asarray(SLICE_US * np.arange(len(profiles[0]) + 1), np.float64)
    courses: list[tuple[Profile, Profile]] = []
    for profile in profiles:
        # Cumulated light can be interpolated at any time: the light between two times is a difference.
        sums = np.concatenate([[0.0], np.cumsum(profile)])
        courses.append((edges_us, sums))
    strongest = max(float(profile.sum()) for profile in profiles)
    if strongest <= 0.0:
        return 1
    telling = [course for course in courses if course[1][-1] > 0.02 * strongest]
    if not any(_uneven(course, begins_us, period_us) for course in telling):
        return 1
    for count in range(MOST_SUB_FRAMES, 1, -1):
        if all(_repeats(course, begins_us, period_us, count) for course in telling):
            return count
    return 1


def _light(course: tuple[NDArray[np.float64], Profile], times_us: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.diff(np.interp(times_us, *course))


def _uneven(course: tuple[NDArray[np.float64], Profile], begins_us: float, period_us: float) -> bool:
    """Return True if the light varies within a frame: constant light would repeat with any number."""
    parts = _light(course, begins_us + np.linspace(0.0, period_us, 33))
    return bool(parts.std() > FLAT * parts.mean())


def _repeats(course: tuple[NDArray[np.float64], Profile], begins_us: float, period_us: float, count: int) -> bool:
    light_per_sub_frame = _light(course, begins_us + np.linspace(0.0, period_us, count + 1))
    if np.abs(light_per_sub_frame - light_per_sub_frame.mean()).max() > EQUAL * light_per_sub_frame.mean():
        return False
    # The course in parts of at least two slices: finer ones would depend on how slices are cut.
    parts = max(2, int(period_us / count / (2 * SLICE_US)))
    fine = _light(course, begins_us + np.linspace(0.0, period_us, count * parts + 1)).reshape(count, parts)
    mean = fine.mean(axis=0)
    if mean.std() < FLAT * mean.mean():
        return bool(np.abs(fine - mean).max() < 2 * FLAT * mean.mean())
    return all(float(np.corrcoef(sub_frame, mean)[0, 1]) > ALIKE for sub_frame in fine)


def trials(timing: LightTiming, sub_frames: int, period_us: float) -> tuple[Trial, ...]:
    """Return the combinations of delay and exposure to measure."""
    begins = timing.begins_us if timing.overhangs(period_us) else 0.0
    end_us = period_us + max(0.0, begins)
    if sub_frames > 1:
        # At a boundary: otherwise the exposure would cut sub-frames at both ends.
        delays = [max(0, round(timing.begins_us))]
        times = [round(k * period_us / sub_frames) for k in range(1, sub_frames + 1)]
    else:
        delay_before_light_us = max(0, SLICE_US // 5 * math.floor((timing.begins_us - SLICE_US) / (SLICE_US // 5)))
        delays = (
            [delay_before_light_us]
            if delay_before_light_us <= USUAL_DELAY_US
            else [delay_before_light_us, USUAL_DELAY_US]
        )
        if begins > 0.0:
            delays = [50 * math.ceil(begins / 50.0)]
        times = [round(1000.0 * step) for step in STEPS_MS]
    combinations = set()
    for delay_us in delays:
        # An exposure of all light, from before its first window until after the last.
        times_of_all_light = [] if sub_frames > 1 else [100 * math.ceil((timing.ends_us + SLICE_US - delay_us) / 100.0)]
        for exposure_us in (*times, *times_of_all_light):
            fits = LEAST_US <= exposure_us <= MOST_US and delay_us + exposure_us <= end_us - MARGIN_US
            if fits and delay_us <= MOST_DELAY_US:
                combinations.add(Trial(delay_us, exposure_us))
    return tuple(sorted(combinations, key=lambda trial: (trial.delay_us, trial.exposure_us)))


def promising_trials(
    candidates: Sequence[Trial], profiles: Mapping[int, Profile], first_us: float
) -> tuple[Trial, ...]:
    """Return those of ``candidates`` whose response may be straight by the light of each bit.

    At least a few are returned. ``profiles`` are those of codes, from the blank of the flip on; delays count from
    ``first_us``. All are returned where a bit was not measured, or bits do not add up to white, since the response
    cannot be predicted then.
    """
    bits = [2**k for k in range(8)]
    if any(bit not in profiles for bit in bits) or len(candidates) <= FEWEST:
        return tuple(candidates)
    together = sum(float(profiles[bit].sum()) for bit in bits)
    if abs(together - float(profiles[255].sum())) > NOT_ADDED * together:
        return tuple(candidates)
    # The light of a code is the sum of its bits' light within the exposure.
    codes = np.arange(256)
    off = {}
    for trial in candidates:
        begins_us = first_us + trial.delay_us
        weights = [light_within(profiles[bit], begins_us, begins_us + trial.exposure_us) for bit in bits]
        light = sum(weight * ((codes >> k) & 1) for k, weight in enumerate(weights))
        line = np.polyval(np.polyfit(codes, light, 1), codes)
        off[trial] = float(np.abs(light - line).max()) / max(sum(weights), 1e-9)
    # At least a few: a remedy names the measured distance from a straight line.
    ranked = sorted(off, key=lambda trial: off[trial])
    promising_ones = {trial for k, trial in enumerate(ranked) if k < FEWEST or off[trial] < UNPROMISING}
    return tuple(trial for trial in candidates if trial in promising_ones)


def best_offer(shapes: Mapping[Trial, ResponseShape], light_of: Callable[[Trial], float]) -> Offer | None:
    """Return the delay with the most good exposures, and these exposures; ``None`` if none is good.

    Exposures of nearly the same light are left out. ``light_of`` returns how much of a white picture's light a trial
    sees, in any unit: images that are partly saturated do not show it.
    """
    offers = []
    for delay_us in sorted({trial.delay_us for trial in shapes}):
        good = [(t.exposure_us, light_of(t)) for t, shape in shapes.items() if t.delay_us == delay_us and shape.usable]
        different = _distinct(sorted(good))
        if different:
            # The number of exposures counts first, then light: a single long one leaves no choice.
            offers.append((len(different), different[-1][1], Offer(delay_us, tuple(time for time, _ in different))))
    return max(offers, key=lambda candidate: candidate[:2])[2] if offers else None


def _distinct(good: Sequence[tuple[int, float]]) -> list[tuple[int, float]]:
    different: list[tuple[int, float]] = []
    for time_us, light in good:
        if not different or light > BRIGHTER * different[-1][1]:
            different.append((time_us, light))
    return different


def judge(lamp: Lamp, rig: Rig) -> StepOutcome:
    """Judge the lamp's windows and the response of the exposures that were tried."""
    period_us = 1e6 / rig.projector.refresh_hz
    tables = {"All measured exposures": _trials(lamp)} if lamp.responses else {}
    keys = keys_of(lamp, period_us, rig.camera.left.exposure_ms) if lamp.offer is not None else {}
    return StepOutcome((_windows(lamp, period_us), _grey(lamp)), tables, _figures(lamp, period_us), keys)


def _windows(lamp: Lamp, period_us: float) -> Finding:
    windows = lamp.timing.windows
    shown = ", ".join(f"{window.begins_us / 1000.0:.2f} to {window.ends_us / 1000.0:.2f} ms" for window in windows)
    lit_percent = 100.0 * sum(window.ends_us - window.begins_us for window in windows) / period_us
    kind = f"{'no' if lamp.sub_frames == 1 else lamp.sub_frames} equal sub-frames"
    statement = (
        f"the lamp lights {shown} after the blank, {lit_percent:.0f} % of the frame; {kind}, patterns in "
        f"{lamp.channels} channels"
    )
    return finding_of("light", True, statement, "", "", windows=len(windows), lit_percent=lit_percent)


def _grey(lamp: Lamp) -> Finding:
    limits, offer = (
        f"within {100.0 * STRAIGHT:g} % (RMS) of a straight line or smoothly curved, rising, repeatable",
        lamp.offer,
    )
    if offer is not None:
        shape = lamp.responses[Trial(offer.delay_us, offer.exposures_us[-1])]
        percent, times = 100.0 * shape.line_rms, ", ".join(f"{time / 1000.0:g}" for time in offer.exposures_us)
        statement = (
            f"exposures of {times} ms from {offer.delay_us} µs after the blank show grey values as in the pattern"
        )
        if shape.shape is not Shape.STRAIGHT:
            statement += f"; the response is curved by {percent:.1f} %, which scans correct"
        return finding_of("grey", True, statement, limits, "", line_percent=percent, exposures=len(offer.exposures_us))
    shapes = list(lamp.responses.values())
    # The most frequent shape counts; single others come from exposures with next to no light.
    kinds = Counter(shape.shape for shape in shapes)
    best = min(shapes, key=lambda candidate: candidate.line_rms, default=None)
    kinds_in_words = ", ".join(f"{count} {kind.value}" for kind, count in kinds.most_common())
    statement = f"no exposure of {len(shapes)} shows grey values as in the pattern ({kinds_in_words})"
    if best is None:
        return Finding("grey", False, statement, limits, PATTERN_MODE)
    statement += f"; the best is {100.0 * best.line_rms:.1f} % off a straight line, like a power of {best.power:.1f}"
    remedy = PATTERN_MODE
    if kinds[Shape.GAMMA]:
        remedy = "switch gamma off in the projector (linear, 1:1, table off) and in the graphics driver"
    elif kinds[Shape.DARK] == len(shapes):
        remedy = "use a white object at half a metre, neither too dark nor saturated"
    elif kinds[Shape.RESTLESS] == len(shapes):
        remedy = "switch off dynamic contrast, dither and lamp dimming in the projector, and other light in the room"
    return finding_of("grey", False, statement, limits, remedy, line_percent=100.0 * best.line_rms, power=best.power)


def keys_of(lamp: Lamp, period_us: float, exposure_ms: float) -> dict[KeyValue, Value]:
    """Return the keys of the rig file with the offered exposure nearest to ``exposure_ms``.

    Raises ValueError for a projector without a good exposure: it has no keys to write.
    """
    offer = lamp.offer
    if offer is None:
        raise ValueError("no exposure is good: there is nothing to write")
    times_ms = tuple(time_us / 1000.0 for time_us in offer.exposures_us)
    nearest = min(times_ms, key=lambda time_ms: abs(time_ms - exposure_ms))
    timing = lamp.timing
    # Where light goes on beyond the next blank, exposures begin with the light.
    late = lamp.sub_frames > 1 or timing.overhangs(period_us)
    begins_us = offer.delay_us if late else 0
    values: tuple[Value, ...] = (
        *(timing.latency_blanks, begins_us, lamp.channels, lamp.sub_frames),
        *(offer.delay_us, times_ms, nearest, nearest),
    )
    return {KeyValue(*key.rsplit(".", 1)): value for key, value in zip(KEYS, values, strict=True)}


def _trials(lamp: Lamp) -> tuple[Mapping[str, Any], ...]:
    """Return every delay and exposure that was tried, not only the good ones, which a helper needs first."""
    return tuple(
        {
            "delay, µs": trial.delay_us,
            "exposure, ms": trial.exposure_us / 1000.0,
            "grey is": shape.shape.value,
            "off a line, %": 100.0 * shape.line_rms,
            "largest fall, %": 100.0 * shape.falls,
            "two passes differ, %": 100.0 * shape.repeat_rms,
            "power": shape.power,
        }
        for trial, shape in lamp.responses.items()
    )


def _figures(lamp: Lamp, period_us: float) -> dict[str, tuple[str, bytes]]:
    """Return light over time and grey over code, caption and PNG, by the name of their file."""
    times_ms = {
        code: np.asarray(SLICE_US * (np.arange(len(p)) + 0.5) / 1000.0, np.float64) for code, p in lamp.profiles.items()
    }
    shown = list(lamp.profiles)[:MOST_CURVES]
    first_us = lamp.timing.latency_blanks * period_us
    edges_us = [first_us + edge for window in lamp.timing.windows for edge in (window.begins_us, window.ends_us)]
    flash = draw_curves(
        {f"code {code}": (times_ms[code], lamp.profiles[code]) for code in shown},
        "ms after the blank of the flip",
        "grey values per slice",
        [edge_us / 1000.0 for edge_us in edges_us],
    )
    drawn = {"light.png": ("Light of a flash over time; red: when the lamp is on", flash)}
    # Usable exposures first, then the straightest.
    best = sorted(lamp.ramps, key=lambda t: (not lamp.responses[t].usable, lamp.responses[t].line_rms))
    if best:
        codes = ramp_codes(RAMP_CODES).astype(np.float64)
        curves = {
            f"{trial.exposure_us / 1000.0:g} ms from {trial.delay_us} us": (codes, lamp.ramps[trial])
            for trial in best[:MOST_CURVES]
        }
        drawn["grey.png"] = "Light by code, as exposures see it", draw_curves(curves, "code", "share of white")
    return drawn
