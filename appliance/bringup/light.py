"""Owns when a projector lights: from the profile of a flash over time to its latency, its windows and its equal sub-frames.

A profile is the light of one picture in slices of ``SLICE_US`` that follow each other without a gap, from a vertical blank on. Its
time 0 is the blank of the picture's flip.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.bringup.finding import BringupError

Profile = NDArray[np.float64]

SLICE_US = 250
"""Length of a slice, and step of the delay: slices touch, so that no short bit plane falls between two."""
MOST_LATENCY_BLANKS = 5
FLASH_SHARE = 0.03
"""Share of a flash's light from which a frame is one that it lights."""
FLASH_DN = 3.0
"""Light below which there is no flash at all."""
ON_SHARE = 0.25
"""Share of the brightest slice from which the lamp is on."""
EARLY_US = 500.0
"""Light that begins so much before a blank belongs to it: the tap of the vertical sync and the controller differ by that."""
OVERHANG_US = 100.0
"""Light that goes on so much beyond the next blank belongs to a picture that begins late: slices place an edge to some 60 µs."""
MOST_SUB_FRAMES = 8
EQUAL = 0.05
"""Largest difference of the light of equal sub-frames from their mean."""
ALIKE = 0.9
"""Least correlation of the light's course in one sub-frame with that in the next."""
FLAT = 0.15
"""Relative standard deviation of the light below which it has no course that could repeat."""


@dataclass(frozen=True, slots=True)
class LightWindow:
    """Time in which the lamp is on, in µs after the blank of the flip."""

    begins_us: float
    ends_us: float


def latency_of(levels: NDArray[np.float64]) -> int:
    """Return the first exposed frame that a single white picture lights, in vertical blanks after its flip.

    ``levels`` (n,) are the mean grey values of n exposures, each nearly a whole frame, the first at the picture's own blank.
    Raises BringupError where nothing, or everything, is lit, or the light comes later than a rig file can say.
    """
    dark = float(np.median(levels))
    light = levels - dark
    total = float(light[light > 0.0].sum())
    if light.max() < FLASH_DN:
        raise BringupError(
            f"one white picture among black ones changed the images by {light.max():.1f} grey values; {FLASH_DN:g} are needed: check "
            "that the projector lights what the cameras see, its focus and its cable, and darken the room"
        )
    # A part of the light, not of the brightest frame: light that begins in the middle of a frame is spread over two.
    lit = np.flatnonzero(light > max(FLASH_SHARE * total, 0.5 * FLASH_DN))
    first, last = int(lit[0]), int(lit[-1])
    if last - first > 2:
        raise BringupError(
            f"one white picture lit {last - first + 1} frames in a row; allowed are 2: switch frame interpolation and motion smoothing off"
        )
    if first > MOST_LATENCY_BLANKS:
        raise BringupError(
            f"a picture's light came {first} vertical blanks after its flip; allowed are 0..{MOST_LATENCY_BLANKS}: switch the projector's "
            "picture processing off (game mode, direct mode)"
        )
    return first


def windows_of(profile: Profile) -> tuple[LightWindow, ...]:
    """Return when the lamp is on, edges interpolated between slices; ``profile`` (n,) begins with the blank of the flip."""
    threshold = ON_SHARE * float(np.quantile(profile, 1.0 - 2.0 / len(profile)))
    on = np.concatenate([[False], profile > threshold, [False]])
    edges = np.flatnonzero(np.diff(on.astype(np.int8)))
    padded = np.concatenate([[0.0], profile, [0.0]])
    found = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        # A slice at the edge is lit for a part of its length, that of its light over its neighbour's.
        inner = padded[first + 1 : last + 1]
        full = float(np.median(inner))
        begins = first + 1.0 - min(1.0, padded[first + 1] / full) - min(1.0, max(0.0, padded[first]) / full)
        ends = last - 1.0 + min(1.0, padded[last] / full) + min(1.0, max(0.0, padded[last + 1]) / full)
        found.append(LightWindow(float(SLICE_US * begins), float(SLICE_US * ends)))
    return tuple(found)


@dataclass(frozen=True, slots=True)
class LightTiming:
    """Latency and windows of one picture's light."""

    latency_blanks: int
    begins_us: float
    """Beginning of its first window after the blank of that number; slightly negative where it comes earlier."""
    ends_us: float
    windows: tuple[LightWindow, ...]
    """Windows, likewise."""

    def overhangs(self, period_us: float) -> bool:
        """Return whether the light goes on beyond the next blank."""
        return self.ends_us > period_us + OVERHANG_US


def timing_of(profile: Profile, period_us: float) -> LightTiming:
    """Return the timing of the light whose ``profile`` over several frames begins with the blank of the flip. Raises BringupError for no light."""
    windows = windows_of(profile)
    if not windows:
        raise BringupError("no light was seen in any slice of the frame: check the lamp, and the cameras' gain")
    begins_us = windows[0].begins_us
    # Rounded down, with a little spare: light that leads its blank by a controller's line or two is that blank's.
    latency = max(0, int((begins_us + EARLY_US) // period_us))
    shift_us = latency * period_us
    moved = tuple(LightWindow(one.begins_us - shift_us, one.ends_us - shift_us) for one in windows)
    return LightTiming(latency, moved[0].begins_us, moved[-1].ends_us, moved)


def light_within(profile: Profile, begins_us: float, ends_us: float) -> float:
    """Return the light of a ``profile`` between two times after the blank of the flip."""
    edges_us = SLICE_US * np.arange(len(profile) + 1)
    sums = np.concatenate([[0.0], np.cumsum(profile)])
    return float(np.interp(ends_us, edges_us, sums) - np.interp(begins_us, edges_us, sums))


def sub_frames_of(profiles: Sequence[Profile], begins_us: float, period_us: float) -> int:
    """Return into how many equal sub-frames the light of a frame falls; 1 where it does not repeat, or has no course at all.

    ``profiles`` are those of several codes, each (n,) from the blank of the flip on; the frame begins at ``begins_us``. Each code's
    bits must come alike in each sub-frame, or a part of the frame would weigh greys otherwise than the whole.
    """
    edges_us = np.asarray(SLICE_US * np.arange(len(profiles[0]) + 1), np.float64)
    courses: list[tuple[Profile, Profile]] = []
    for profile in profiles:
        # Cumulated light can be read at any time: the light between two is a difference.
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
    """Return whether the light within a frame has a course: steady light would repeat with any number."""
    parts = _light(course, begins_us + np.linspace(0.0, period_us, 33))
    return bool(parts.std() > FLAT * parts.mean())


def _repeats(course: tuple[NDArray[np.float64], Profile], begins_us: float, period_us: float, count: int) -> bool:
    whole = _light(course, begins_us + np.linspace(0.0, period_us, count + 1))
    if np.abs(whole - whole.mean()).max() > EQUAL * whole.mean():
        return False
    # The course in parts of two slices at least: finer ones would compare where a slice was cut.
    parts = max(2, int(period_us / count / (2 * SLICE_US)))
    fine = _light(course, begins_us + np.linspace(0.0, period_us, count * parts + 1)).reshape(count, parts)
    mean = fine.mean(axis=0)
    if mean.std() < FLAT * mean.mean():
        return bool(np.abs(fine - mean).max() < 2 * FLAT * mean.mean())
    return all(float(np.corrcoef(one, mean)[0, 1]) > ALIKE for one in fine)
