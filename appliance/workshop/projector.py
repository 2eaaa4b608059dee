"""Measuring a projector by the instrument's cameras: latency, light, response, raster and orientation.

The order matters: light can only be sampled once the latency is known, and responses only once the timing of the light
is. No judgement rests on a single image or on one camera.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from appliance.base import Progress
from appliance.workshop.bench import Bench, Image, Shot, bench_on, flat_pictures, lit_part, mean_levels
from appliance.workshop.finding import BringupError, Finding
from appliance.workshop.latency import measure_latency
from appliance.workshop.light import (
    MOST_US,
    SLICE_US,
    Lamp,
    LightTiming,
    Profile,
    Trial,
    best_offer,
    light_within,
    promising_trials,
    sub_frames_of,
    timing_of,
    trials,
)
from appliance.workshop.raster import LineLight, PictureView, measure_lines, measure_orientation
from appliance.workshop.response import RAMP_CODES, ResponseShape, Shape, judge_response, ramp_codes, shuffled_indices
from appliance.workshop.step import MOST_ASKED, StepOutcome, Workplace, numbered_request, wall

BIT_CODES = (255, 128, 64, 32, 16, 8, 4, 2, 1)
WHITE_FRAMES, CODE_FRAMES = 4, 2
"""Frames of the sweep: for white the one before, its own, and two that its light may still reach; for other codes,
whose frame is known by then, their own and the next, into which light may overhang.
"""
LAST_DELAY_US = 15_000
"""Largest delay of the board; the light behind it is the difference of longer exposures."""
MORE_LIGHT = 1.5
"""Smallest ratio of light with all channels to that of green alone at which they may be sub-frames of one lamp."""
ALL_OF_IT = 0.98
"""Share of a frame's light from which an exposure counts as having all of it."""
CURVES_ALIKE, FEWEST_ALIKE = 0.01, 4
"""Largest distance of two equal curves, share of white; and the number of exposures that must have a curve where none
has all light.
"""
HOPELESS = 0.06
"""RMS distance of a first pass from a straight line above which there is no second pass."""
LEAST_HZ, MOST_HZ = 35.0, 240.0
"""Refresh rates at which slices, with the differences behind them, reach the end of a frame."""
WALL_FRAMES = 12
"""Number of white frames, and of black ones before them, to detect a wall: more than the largest latency."""
LEAST_LIGHT_DN = 4.0
"""Smallest difference of an image's mean between black and white pictures that proves a lit surface."""
PROJECTOR_PAGE = "projector.html"
_ORDER = ("latency", "light", "skew", "grey", "orientation", "sides", "raster")


@dataclass(frozen=True, slots=True)
class ProjectorMeasurement:
    """All measurements of a projector."""

    lamp: Lamp
    skew_us: float
    """Time by which the light begins later in the right camera's images than in the left one's, because the right
    camera exposes earlier by that.
    """
    lines: Mapping[str, LineLight]
    """Comparison of single lines, by ``columns`` and ``rows``."""
    views: Mapping[str, PictureView]
    """Orientation by camera."""
    photographs: Mapping[str, Image]
    """Pictures as the cameras see them, (h, w), by motif and side, ``checker_left``."""


def outcomes_in_order(outcomes: Iterable[StepOutcome]) -> tuple[list[StepOutcome], list[Finding]]:
    """Return the outcomes of the projector's steps and their findings, in the order of measurement."""

    def place(finding: Finding) -> int:
        return _ORDER.index(finding.name)

    ordered = sorted(outcomes, key=lambda outcome: place(outcome.findings[0]))
    return ordered, sorted((finding for outcome in ordered for finding in outcome.findings), key=place)


def measure_on_wall(workplace: Workplace) -> ProjectorMeasurement:
    """Ask for a white wall, and measure the projector on it. Raises DeviceError, BringupError, GivenUp."""
    with bench_on(workplace.rig, workplace.wires) as bench:
        _before_white(workplace, bench)
        return measure_projector(bench, workplace.rig.scan.most_gain_db, workplace.say)


def _before_white(workplace: Workplace, bench: Bench) -> None:
    """Ask for a white wall until both cameras see the projector's light on it.

    After a number of attempts the measurement is tried all the same.
    """
    for attempt in range(MOST_ASKED):
        workplace.person.ask(numbered_request(f"{wall(workplace)}, and darken the room", attempt))
        workplace.say("looking for the projector's light")
        if _lit(workplace, bench):
            return


def _lit(workplace: Workplace, bench: Bench) -> bool:
    """Return True if both cameras see the projector's light."""
    bench.load(flat_pictures(bench.size_px, (0, 255)), all_channels=False)
    # The latency is not known yet: so many frames of each that it does not matter.
    shot = Shot(workplace.rig.board.trigger_delay_us, round(1000.0 * workplace.rig.camera.left.exposure_ms))
    frames = bench.take([0] * WALL_FRAMES + [1] * WALL_FRAMES, shot)
    levels = [mean_levels(images, np.ones(images.shape[1:], np.bool_)) for images in frames.values()]
    return all(float(level.max() - level.min()) > LEAST_LIGHT_DN for level in levels)


def measure_projector(bench: Bench, gain_db: float, say: Progress) -> ProjectorMeasurement:
    """Measure the projector; ``gain_db`` is that of the short exposures. Raises BringupError, DeviceError."""
    if not LEAST_HZ <= bench.refresh_hz <= MOST_HZ:
        raise BringupError(
            f"projector.refresh_hz {bench.refresh_hz:g}: allowed here are {LEAST_HZ:g}..{MOST_HZ:g}; measure in a mode "
            "of 60 Hz"
        )
    period_us = 1e6 / bench.refresh_hz
    say("latency", 0.0)
    latency, parts = measure_latency(bench)
    profiles, skew_us = _sweep(
        bench, latency, parts, gain_db, BIT_CODES, False, lambda part: say("light over time", 0.02 + 0.3 * part)
    )
    timing = timing_of(profiles[255], period_us)
    sub_frames = _sub_frames(profiles, timing, period_us)
    channels = "green"
    # A sweep takes a quarter of all the time: first check with one white picture whether there is more light.
    if sub_frames == 1 and _gain_of_channels(bench, timing, parts, period_us) > MORE_LIGHT:
        few_codes = BIT_CODES[::3]
        all_channel_profiles, _ = _sweep(
            bench, latency, parts, gain_db, few_codes, True, lambda part: say("all channels", 0.32 + 0.1 * part)
        )
        all_timing = timing_of(all_channel_profiles[255], period_us)
        all_frames = _sub_frames(all_channel_profiles, all_timing, period_us)
        # Equal sub-frames of all channels are one lamp's, unequal ones are colours.
        if all_frames > 1 and float(all_channel_profiles[255].sum()) > MORE_LIGHT * float(profiles[255].sum()):
            channels, sub_frames, timing, profiles = "all", all_frames, all_timing, all_channel_profiles
    candidates = promising_trials(trials(timing, sub_frames, period_us), profiles, timing.latency_blanks * period_us)
    responses, ramps = _responses(
        bench, timing, candidates, channels, lambda part: say("grey of each exposure", 0.42 + 0.45 * part)
    )
    # A gamma does not disprove sub-frames: exposures that cut them would only hide it behind cut bits.
    if sub_frames > 1 and not any(shape.usable or shape.shape is Shape.GAMMA for shape in responses.values()):
        sub_frames = 1
        responses, ramps = _responses(
            bench,
            timing,
            trials(timing, 1, period_us),
            channels,
            lambda part: say("grey of each exposure", 0.6 + 0.27 * part),
        )
    first_us = timing.latency_blanks * period_us

    def light_of(trial: Trial) -> float:
        begins_us = first_us + trial.delay_us
        return light_within(profiles[255], begins_us, begins_us + trial.exposure_us)

    responses = _confirm_responses(responses, ramps, light_of, float(profiles[255].sum()))
    offer = best_offer(responses, light_of)
    brightest = Trial(offer.delay_us, offer.exposures_us[-1]) if offer is not None else _brightest(responses)
    say("orientation", 0.88)
    shot = Shot(brightest.delay_us, brightest.exposure_us, blanks=timing.latency_blanks)
    views, letters = measure_orientation(bench, shot, all_channels=channels == "all")
    say("raster", 0.92)
    lines, checkers = measure_lines(bench, shot, all_channels=channels == "all")
    lamp = Lamp(timing, channels, sub_frames, profiles, responses, ramps, offer)
    return ProjectorMeasurement(lamp, skew_us, lines, views, {**letters, **checkers})


def _gain_of_channels(
    bench: Bench, timing: LightTiming, parts: Mapping[str, NDArray[np.bool_]], period_us: float
) -> float:
    """Return the ratio of a white picture's light with all channels to that with green alone."""
    light = []
    for all_channels in (False, True):
        bench.load(flat_pictures(bench.size_px, (255, 0)), all_channels=all_channels)
        # Short adjoining exposures, since a whole frame's light may saturate the images.
        part_us = int(min(MOST_US, period_us) / 8)
        takes = [
            bench.take([1, 0, 0, 1], Shot(delay, part_us, blanks=timing.latency_blanks))
            for delay in range(0, min(LAST_DELAY_US, int(period_us) - part_us) + 1, part_us)
        ]
        levels = [mean_levels(frames[side], parts[side]) for frames in takes for side in parts]
        light.append(sum(float(level.max() - level.min()) for level in levels))
    return light[1] / max(light[0], 1e-9)


def _sweep(
    bench: Bench,
    latency: int,
    parts: Mapping[str, NDArray[np.bool_]],
    gain_db: float,
    codes: Sequence[int],
    all_channels: bool,
    say: Callable[[float], None],
) -> tuple[dict[int, Profile], float]:
    """Return each code's light in slices from the blank of its flip on, and the cameras' skew in µs.

    The light is the mean of both cameras.
    """
    bench.load(flat_pictures(bench.size_px, (*codes, 0)), all_channels=all_channels)
    period_us = 1e6 / bench.refresh_hz
    dark = len(codes)
    ahead = 1 if latency > 0 else 0
    # Dark between any two codes, so that light after a blank belongs to the code before it.
    order = [0, *[dark] * (WHITE_FRAMES - 1), *(k for code in range(1, len(codes)) for k in (code, dark)), dark, dark]
    delays_us = [slice_us for slice_us in range(0, LAST_DELAY_US + 1, SLICE_US) if slice_us < period_us]
    behind = max(0, int(np.ceil((period_us - delays_us[-1]) / SLICE_US)) - 1)
    shots = [Shot(delay, SLICE_US, gain_db, latency - ahead) for delay in delays_us]
    shots += [Shot(delays_us[-1], SLICE_US * (k + 2), gain_db, latency - ahead) for k in range(behind)]
    levels_by_side: dict[str, list[NDArray[np.float64]]] = {side: [] for side in parts}
    for number, shot in enumerate(shots):
        say(number / len(shots))
        for side, images in bench.take(order, shot).items():
            levels = mean_levels(images, parts[side])
            levels_by_side[side].append(levels[:-1] - levels[-1])
    by_side = {}
    for side, columns in levels_by_side.items():
        slices = np.stack(columns, axis=1)
        # Longer exposures from the last delay on: each has one slice more than the previous one.
        first = len(delays_us) - 1
        slices[:, first + 1 :] = np.diff(slices[:, first:], axis=1)
        by_side[side] = slices
    profiles = {}
    mean = np.mean(list(by_side.values()), axis=0)
    for k, code in enumerate(codes):
        # White shows in which frame the light is; other codes are evaluated from there on.
        first = 0 if k == 0 else WHITE_FRAMES + CODE_FRAMES * (k - 1) + ahead
        count, blanks = (WHITE_FRAMES, latency - ahead) if k == 0 else (CODE_FRAMES, latency)
        profiles[code] = _join_frames(mean[first : first + count], period_us, blanks)
    longest = max(len(profile) for profile in profiles.values())
    profiles = {code: np.pad(profile, (0, longest - len(profile))) for code, profile in profiles.items()}
    begins = [
        timing_of(_join_frames(side_slices[:WHITE_FRAMES], period_us, latency - ahead), period_us).begins_us
        for side_slices in by_side.values()
    ]
    return profiles, float(begins[-1] - begins[0])


def _join_frames(frames: NDArray[np.float64], period_us: float, blanks: int) -> Profile:
    """Return the slices of consecutive frames (k, n), resampled to one time axis from the flip's blank on."""
    n = frames.shape[1]
    times, light = [np.array([0.0])], [np.array([0.0])]
    total = 0.0
    for k, frame in enumerate(frames):
        edges = np.minimum(SLICE_US * np.arange(1, n + 1), period_us)
        # The last slice reaches beyond the frame: only its part within the frame counts here.
        lengths = np.diff(np.concatenate([[0.0], edges])) / SLICE_US
        sums = total + np.cumsum(frame * lengths)
        times.append((blanks + k) * period_us + edges)
        light.append(sums)
        total = float(sums[-1])
    axis = SLICE_US * np.arange(int((blanks + len(frames)) * period_us / SLICE_US) + 1)
    profile: Profile = np.diff(np.interp(axis, np.concatenate(times), np.concatenate(light)))
    return profile


def _sub_frames(profiles: Mapping[int, Profile], timing: LightTiming, period_us: float) -> int:
    begins_us = timing.latency_blanks * period_us + timing.begins_us
    return sub_frames_of(list(profiles.values()), begins_us, period_us)


def _responses(
    bench: Bench, timing: LightTiming, candidates: Sequence[Trial], channels: str, say: Callable[[float], None]
) -> tuple[dict[Trial, ResponseShape], dict[Trial, NDArray[np.float64]]]:
    """Measure the response of each trial twice, with the codes in two random orders."""
    codes = ramp_codes(RAMP_CODES)
    bench.load(flat_pictures(bench.size_px, [int(code) for code in codes]), all_channels=channels == "all")
    white, black = len(codes) - 1, 0
    shapes, ramps = {}, {}
    for number, trial in enumerate(candidates):
        passes = []
        for attempt in range(2):
            say((number + 0.5 * attempt) / len(candidates))
            disorder = shuffled_indices(len(codes), attempt)
            order = [white, black, *(int(k) for k in disorder)]
            frames = bench.take(order, Shot(trial.delay_us, trial.exposure_us, blanks=timing.latency_blanks))
            levels = np.mean([_ramp(images) for images in frames.values()], axis=0)
            grey = np.empty(len(codes))
            grey[disorder] = levels
            passes.append(grey)
            # A first pass that is far from straight needs no second one.
            if judge_response(codes.astype(np.float64), grey, grey).line_rms > HOPELESS:
                passes.append(grey)
                break
        shapes[trial] = judge_response(codes.astype(np.float64), *passes)
        mean = (passes[0] + passes[1]) / 2.0
        ramps[trial] = (mean - mean[0]) / max(float(mean[-1] - mean[0]), 1e-9)
    return shapes, ramps


def _confirm_responses(
    responses: Mapping[Trial, ResponseShape],
    ramps: Mapping[Trial, NDArray[np.float64]],
    light_of: Callable[[Trial], float],
    all_light: float,
) -> dict[Trial, ResponseShape]:
    """Return the responses; a curved one counts as cut bit planes unless the lamp itself has its curve.

    The lamp's curve is that of an exposure with all of its light.
    """
    full = [trial for trial, shape in responses.items() if shape.usable and light_of(trial) > ALL_OF_IT * all_light]
    # Cut bit planes may look smooth by chance, but then each exposure has another curve; a steady lamp has one.
    reference = max(full, key=light_of, default=None) or _alike(responses, ramps)
    confirmed = {}
    for trial, shape in responses.items():
        is_unique = shape.shape is Shape.CURVED and (
            reference is None
            or float(np.abs(ramps[trial] - ramps[reference]).max()) > CURVES_ALIKE + 1.5 * shape.repeat_rms
        )
        confirmed[trial] = replace(shape, shape=Shape.BIT_PLANES) if is_unique else shape
    return confirmed


def _alike(responses: Mapping[Trial, ResponseShape], ramps: Mapping[Trial, NDArray[np.float64]]) -> Trial | None:
    """Return a trial with the same curve as most others, where none has all of the light, or ``None``."""
    curved = [trial for trial, shape in responses.items() if shape.usable]
    for trial in curved:
        like = sum(float(np.abs(ramps[trial] - ramps[candidate]).max()) < CURVES_ALIKE for candidate in curved)
        if like >= max(FEWEST_ALIKE, 0.5 * len(responses)):
            return trial
    return None


def _ramp(images: Image) -> NDArray[np.float64]:
    """Return the grey values of a ramp (n − 2,) where its own white frame is bright and not saturated."""
    part = lit_part(images[0], images[1], 0.3)
    # Without such pixels (all are saturated) return zeros, which are judged as too dark.
    return mean_levels(images[2:], part) if part.any() else np.zeros(len(images) - 2)


def _brightest(responses: Mapping[Trial, ResponseShape]) -> Trial:
    if not responses:
        raise BringupError(
            "no exposure fits between a picture's light and the next one's: set board.trigger_delay_us to 0, and a "
            "mode of 60 Hz or less"
        )
    return max(responses, key=lambda trial: responses[trial].light_dn)
