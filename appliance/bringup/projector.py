"""Owns the measurement of a projector by the instrument's own cameras: its latency, its light, its response, its raster, its orientation.

Order matters: the light can only be sampled once it is known which frame shows it, and responses only once it is known when
light comes. Nothing is judged by a single image or by one camera.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from appliance.bringup.bench import MOST_FRAMES, Bench, Image, Shot, lit_part, mean_levels
from appliance.bringup.exposures import MOST_US, Offer, Trial, offered, promising, trials
from appliance.bringup.finding import BringupError
from appliance.bringup.light import SLICE_US, LightTiming, Profile, latency_of, light_within, sub_frames_of, timing_of
from appliance.bringup.orientation import SeenPicture, marker_pictures, see_orientation
from appliance.bringup.raster import LINES, LineLight, checker, compare_lines, line_pictures
from appliance.bringup.response_check import ResponseShape, Shape, judge_response, ramp_codes, shuffled

Say = Callable[[str, float], None]
BIT_CODES = (255, 128, 64, 32, 16, 8, 4, 2, 1)
WHITE_FRAMES, CODE_FRAMES = 4, 2
"""Frames of white in the sweep: one before, its own, and two that its light may still reach; and of other codes, whose frame is known
by then: their own, and the one that light may overhang into."""
FLASH_FRAMES = 24
FLASH_DELAY_US = 500
LAST_DELAY_US = 15_000
"""Largest delay of the board; what lies behind is the difference of longer exposures."""
RAMP_CODES = 62
"""Number of codes in a take: with white and black of its own, as many frames as it may have."""
MORE_LIGHT = 1.5
"""Least ratio of light with all channels to that of green alone from which they may be sub-frames of one lamp."""
ALL_OF_IT = 0.98
"""Share of a frame's light from which an exposure is taken to hold all of it."""
CURVES_ALIKE, FEWEST_ALIKE = 0.01, 4
"""Largest distance of two curves that are one, share of white; and how many exposures must have it where none holds all light."""
HOPELESS = 0.06
"""RMS distance from a straight line of a first pass from which no second one is taken."""
LEAST_HZ, MOST_HZ = 35.0, 240.0
"""Rates at which slices and the differences behind them reach the end of a frame."""


@dataclass(frozen=True, slots=True)
class ProjectorMeasured:
    """Everything that was measured of a projector."""

    timing: LightTiming
    channels: str
    """``green`` or ``all``."""
    sub_frames: int
    skew_us: float
    """Time by which the light begins later in the right camera's images than in the left one's: that much earlier it exposes."""
    profiles: Mapping[int, Profile]
    """Light in slices, from the blank of the flip on, by code."""
    responses: Mapping[Trial, ResponseShape]
    ramps: Mapping[Trial, NDArray[np.float64]]
    """Share of white at each of ``ramp_codes``, (n,), by trial."""
    offer: Offer | None
    lines: Mapping[str, LineLight]
    """Single lines, compared, by ``columns`` and ``rows``."""
    seen: Mapping[str, SeenPicture]
    """Orientation by camera."""
    pictures: Mapping[str, Image]
    """Photographs for the page, (h, w), keyed by name."""


def measure_projector(bench: Bench, gain_db: float, say: Say) -> ProjectorMeasured:
    """Measure everything; ``gain_db`` is that of the short exposures. Raises BringupError, DeviceError."""
    if not LEAST_HZ <= bench.refresh_hz <= MOST_HZ:
        raise BringupError(
            f"projector.refresh_hz {bench.refresh_hz:g}: allowed here are {LEAST_HZ:g}..{MOST_HZ:g}; measure in a mode of 60 Hz"
        )
    period_us = 1e6 / bench.refresh_hz
    say("latency", 0.0)
    latency, parts = _latency(bench, period_us)
    profiles, skew_us = _swept(
        bench, latency, parts, gain_db, BIT_CODES, False, lambda part: say("light over time", 0.02 + 0.3 * part)
    )
    timing = timing_of(profiles[255], period_us)
    sub_frames = _sub_frames(profiles, timing, period_us)
    channels = "green"
    # A sweep costs a quarter of the whole: first one white picture tells whether there is more light at all.
    if sub_frames == 1 and _gain_of_channels(bench, timing, parts, period_us) > MORE_LIGHT:
        few = BIT_CODES[::3]
        both, _ = _swept(bench, latency, parts, gain_db, few, True, lambda part: say("all channels", 0.32 + 0.1 * part))
        all_timing = timing_of(both[255], period_us)
        all_frames = _sub_frames(both, all_timing, period_us)
        # Equal sub-frames are one lamp thrice; another number of equal ones would be chance, and unequal ones are colours.
        if all_frames > 1 and float(both[255].sum()) > MORE_LIGHT * float(profiles[255].sum()):
            channels, sub_frames, timing, profiles = "all", all_frames, all_timing, both
    wanted = promising(trials(timing, sub_frames, period_us), profiles, timing.latency_blanks * period_us)
    responses, ramps = _responses(
        bench, timing, wanted, channels, lambda part: say("grey of each exposure", 0.42 + 0.45 * part)
    )
    # Whole sub-frames that show a gamma are no wrong guess: exposures that cut them would only hide it behind cut bits.
    if sub_frames > 1 and not any(one.usable or one.shape is Shape.GAMMA for one in responses.values()):
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

    responses = _confirmed(responses, ramps, light_of, float(profiles[255].sum()))
    offer = offered(responses, light_of)
    best = Trial(offer.delay_us, offer.exposures_us[-1]) if offer is not None else _brightest(responses)
    say("orientation", 0.88)
    seen, pictures = measure_orientation(bench, timing.latency_blanks, best, channels)
    say("raster", 0.92)
    lines, grey = measure_lines(bench, timing.latency_blanks, best, channels)
    return ProjectorMeasured(
        timing, channels, sub_frames, skew_us, profiles, responses, ramps, offer, lines, seen, {**pictures, **grey}
    )


def _latency(bench: Bench, period_us: float) -> tuple[int, dict[str, NDArray[np.bool_]]]:
    """Return the coarse latency, which both cameras must see alike, and what the projector lights in each image."""
    bench.load(_flat(bench.size_px, (255, 0)), all_channels=False)
    exposure_us = int(min(MOST_US, 0.92 * period_us) - FLASH_DELAY_US)
    frames = bench.take([0] + [1] * (FLASH_FRAMES - 1), Shot(FLASH_DELAY_US, exposure_us))
    found, parts = {}, {}
    for side, images in frames.items():
        part = lit_part(images.max(axis=0), images.min(axis=0), most_dn=256.0)
        if not part.any():
            part = np.ones(images.shape[1:], np.bool_)
        found[side], parts[side] = latency_of(mean_levels(images, part)), part
    # One projector, one latency: where cameras disagree, one of them counts its frames from another trigger.
    if len(set(found.values())) > 1:
        raise BringupError(
            f"the cameras see the light {' and '.join(f'{blanks} blanks ({side})' for side, blanks in found.items())} after the flip: one of "
            "them misses the first trigger; check its line and its trigger's overlap"
        )
    return next(iter(found.values())), parts


def _gain_of_channels(
    bench: Bench, timing: LightTiming, parts: Mapping[str, NDArray[np.bool_]], period_us: float
) -> float:
    """Return how much brighter a white picture is with all channels than with green alone, over the whole frame."""
    light = []
    for all_channels in (False, True):
        bench.load(_flat(bench.size_px, (255, 0)), all_channels=all_channels)
        # Short exposures that touch each other: of a whole frame's light the images may be saturated.
        part_us = int(min(MOST_US, period_us) / 8)
        takes = [
            bench.take([1, 0, 0, 1], Shot(delay, part_us, blanks=timing.latency_blanks))
            for delay in range(0, min(LAST_DELAY_US, int(period_us) - part_us) + 1, part_us)
        ]
        levels = [mean_levels(frames[side], parts[side]) for frames in takes for side in parts]
        light.append(sum(float(one.max() - one.min()) for one in levels))
    return light[1] / max(light[0], 1e-9)


def _swept(
    bench: Bench,
    latency: int,
    parts: Mapping[str, NDArray[np.bool_]],
    gain_db: float,
    codes: Sequence[int],
    all_channels: bool,
    say: Callable[[float], None],
) -> tuple[dict[int, Profile], float]:
    """Return the light of each code in slices from the blank of its flip on, mean of both cameras, and their skew in µs."""
    bench.load(_flat(bench.size_px, (*codes, 0)), all_channels=all_channels)
    period_us = 1e6 / bench.refresh_hz
    dark = len(codes)
    ahead = 1 if latency > 0 else 0
    # Dark between any two codes: light that goes on beyond a blank is then its own code's.
    order = [0, *[dark] * (WHITE_FRAMES - 1), *(k for code in range(1, len(codes)) for k in (code, dark)), dark, dark]
    whole = [slice_us for slice_us in range(0, LAST_DELAY_US + 1, SLICE_US) if slice_us < period_us]
    behind = max(0, int(np.ceil((period_us - whole[-1]) / SLICE_US)) - 1)
    shots = [Shot(delay, SLICE_US, gain_db, latency - ahead) for delay in whole]
    shots += [Shot(whole[-1], SLICE_US * (k + 2), gain_db, latency - ahead) for k in range(behind)]
    seen: dict[str, list[NDArray[np.float64]]] = {side: [] for side in parts}
    for number, shot in enumerate(shots):
        say(number / len(shots))
        for side, images in bench.take(order, shot).items():
            levels = mean_levels(images, parts[side])
            seen[side].append(levels[:-1] - levels[-1])
    by_side = {}
    for side, columns in seen.items():
        slices = np.stack(columns, axis=1)
        # Longer exposures from the last delay on: each has one slice more than the one before.
        first = len(whole) - 1
        slices[:, first + 1 :] = np.diff(slices[:, first:], axis=1)
        by_side[side] = slices
    profiles = {}
    mean = np.mean(list(by_side.values()), axis=0)
    for k, code in enumerate(codes):
        # White tells in which frame its light is; that of other codes is looked at from there on.
        first = 0 if k == 0 else WHITE_FRAMES + CODE_FRAMES * (k - 1) + ahead
        count, blanks = (WHITE_FRAMES, latency - ahead) if k == 0 else (CODE_FRAMES, latency)
        profiles[code] = _joined(mean[first : first + count], period_us, blanks)
    longest = max(len(profile) for profile in profiles.values())
    profiles = {code: np.pad(profile, (0, longest - len(profile))) for code, profile in profiles.items()}
    begins = [
        timing_of(_joined(one[:WHITE_FRAMES], period_us, latency - ahead), period_us).begins_us
        for one in by_side.values()
    ]
    return profiles, float(begins[-1] - begins[0])


def _joined(frames: NDArray[np.float64], period_us: float, blanks: int) -> Profile:
    """Return the slices of frames that follow each other (k, n), resampled to slices on one time axis from the flip's blank on."""
    n = frames.shape[1]
    times, light = [np.array([0.0])], [np.array([0.0])]
    total = 0.0
    for k, frame in enumerate(frames):
        edges = np.minimum(SLICE_US * np.arange(1, n + 1), period_us)
        # The last slice reaches beyond the frame: only its part within counts here, the rest is the next frame's.
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
    bench: Bench, timing: LightTiming, wanted: Sequence[Trial], channels: str, say: Callable[[float], None]
) -> tuple[dict[Trial, ResponseShape], dict[Trial, NDArray[np.float64]]]:
    """Measure the response of each trial twice, in two disorders."""
    codes = ramp_codes(RAMP_CODES)
    bench.load(_flat(bench.size_px, [int(code) for code in codes]), all_channels=channels == "all")
    white, black = len(codes) - 1, 0
    shapes, ramps = {}, {}
    for number, trial in enumerate(wanted):
        passes = []
        for turn in range(2):
            say((number + 0.5 * turn) / len(wanted))
            disorder = shuffled(len(codes), turn)
            order = [white, black, *(int(k) for k in disorder)]
            frames = bench.take(order, Shot(trial.delay_us, trial.exposure_us, blanks=timing.latency_blanks))
            levels = np.mean([_ramp(images) for images in frames.values()], axis=0)
            grey = np.empty(len(codes))
            grey[disorder] = levels
            passes.append(grey)
            # What is far from straight at first need not be shown to be so again.
            if judge_response(codes.astype(np.float64), grey, grey).line_rms > HOPELESS:
                passes.append(grey)
                break
        shapes[trial] = judge_response(codes.astype(np.float64), *passes)
        mean = (passes[0] + passes[1]) / 2.0
        ramps[trial] = (mean - mean[0]) / max(float(mean[-1] - mean[0]), 1e-9)
    return shapes, ramps


def _confirmed(
    responses: Mapping[Trial, ResponseShape],
    ramps: Mapping[Trial, NDArray[np.float64]],
    light_of: Callable[[Trial], float],
    whole: float,
) -> dict[Trial, ResponseShape]:
    """Return the responses, curved ones only where the lamp itself is curved so: like an exposure that holds all of its light."""
    full = [trial for trial, shape in responses.items() if shape.usable and light_of(trial) > ALL_OF_IT * whole]
    # Cut bit planes may look smooth by chance; but then each exposure has a curve of its own, and steady lamps have one.
    reference = max(full, key=light_of, default=None) or _alike(responses, ramps)
    confirmed = {}
    for trial, shape in responses.items():
        own = shape.shape is Shape.CURVED and (
            reference is None
            or float(np.abs(ramps[trial] - ramps[reference]).max()) > CURVES_ALIKE + 1.5 * shape.repeat_rms
        )
        confirmed[trial] = replace(shape, shape=Shape.BIT_PLANES) if own else shape
    return confirmed


def _alike(responses: Mapping[Trial, ResponseShape], ramps: Mapping[Trial, NDArray[np.float64]]) -> Trial | None:
    """Return a trial whose curve is that of most others, where none holds all of the light; ``None``: there is no such curve."""
    curved = [trial for trial, shape in responses.items() if shape.usable]
    for trial in curved:
        like = sum(float(np.abs(ramps[trial] - ramps[other]).max()) < CURVES_ALIKE for other in curved)
        if like >= max(FEWEST_ALIKE, 0.5 * len(responses)):
            return trial
    return None


def _ramp(images: Image) -> NDArray[np.float64]:
    """Return the grey values of a ramp (n − 2,) where its own white frame is bright and not saturated."""
    part = lit_part(images[0], images[1], 0.3)
    # Saturated everywhere: a straight line would be cut off, and what is judged then is not bright enough.
    return mean_levels(images[2:], part) if part.any() else np.zeros(len(images) - 2)


def measure_lines(
    bench: Bench, blanks: int, best: Trial, channels: str
) -> tuple[dict[str, LineLight], dict[str, Image]]:
    """Compare single columns and single rows, by name; and photograph a checker, by name. Raises BringupError, DeviceError."""
    found: dict[str, LineLight] = {}
    grey: dict[str, Image] = {}
    for name, rows in (("columns", False), ("rows", True)):
        pictures = [*_flat(bench.size_px, (255, 0)), checker(bench.size_px), *line_pictures(bench.size_px, rows)]
        bench.load(pictures, all_channels=channels == "all")
        order = [0, 1, 2, *range(3, 3 + LINES)]
        # As often as a take holds them: a single line is little light.
        turns = (MOST_FRAMES - 3) // LINES
        order += [k for _ in range(turns - 1) for k in range(3, 3 + LINES)]
        passes = []
        for _ in range(2):
            frames = bench.take(order, Shot(best.delay_us, best.exposure_us, blanks=blanks))
            light = np.mean([_line_light(images, turns) for images in frames.values()], axis=0)
            passes.append(light)
        found[name] = compare_lines(*passes)
        grey = {f"checker_{side}": images[2].copy() for side, images in frames.items()}
    return found, grey


def _line_light(images: Image, turns: int) -> NDArray[np.float64]:
    """Return the light of each line (LINES,), as a share of the mean line's."""
    part = lit_part(images[0], images[1], 0.2, 256.0)
    levels = mean_levels(images[3:], part) - float(images[1][part].mean())
    lines = levels.reshape(turns, LINES).mean(axis=0)
    return np.asarray(lines / max(float(lines.mean()), 1e-9))


def measure_orientation(
    bench: Bench, blanks: int, best: Trial, channels: str
) -> tuple[dict[str, SeenPicture], dict[str, Image]]:
    """Tell which way round each camera sees the picture, and photograph an L, by name. Raises BringupError, DeviceError."""
    # In one take: nothing must move between the halves that are compared.
    pictures = marker_pictures(bench.size_px)
    bench.load(pictures, all_channels=channels == "all")
    frames = bench.take(range(len(pictures)), Shot(best.delay_us, best.exposure_us, blanks=blanks))
    seen = {side: see_orientation(images, bench.size_px[0]) for side, images in frames.items()}
    return seen, {f"marker_{side}": images[-1].copy() for side, images in frames.items()}


def _brightest(responses: Mapping[Trial, ResponseShape]) -> Trial:
    if not responses:
        raise BringupError(
            "no exposure fits between a picture's light and the next one's: set board.trigger_delay_us to 0, and a mode of 60 Hz or less"
        )
    return max(responses, key=lambda trial: responses[trial].light_dn)


def _flat(size_px: tuple[int, int], codes: Sequence[int]) -> list[Image]:
    width, height = size_px
    return [np.full((height, width), code, np.uint8) for code in codes]
