"""Owns the measurement of a projector by the instrument's own cameras: its latency, its light, its response, its
raster, its orientation.

Order matters: the light can only be sampled once it is known which frame shows it, and responses only once it is known
when light comes. Nothing is judged by a single image or by one camera.
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
    light_within,
    offered,
    promising,
    sub_frames_of,
    timing_of,
    trials,
)
from appliance.workshop.raster import LineLight, SeenPicture, measure_lines, measure_orientation
from appliance.workshop.response import RAMP_CODES, ResponseShape, Shape, judge_response, ramp_codes, shuffled
from appliance.workshop.step import MOST_ASKED, StepOutcome, Workplace, numbered, wall

BIT_CODES = (255, 128, 64, 32, 16, 8, 4, 2, 1)
WHITE_FRAMES, CODE_FRAMES = 4, 2
"""Frames of white in the sweep: one before, its own, and two that its light may still reach; and of other codes, whose
frame is known by then: their own, and the one that light may overhang into."""
LAST_DELAY_US = 15_000
"""Largest delay of the board; what lies behind is the difference of longer exposures."""
MORE_LIGHT = 1.5
"""Least ratio of light with all channels to that of green alone from which they may be sub-frames of one lamp."""
ALL_OF_IT = 0.98
"""Share of a frame's light from which an exposure is taken to hold all of it."""
CURVES_ALIKE, FEWEST_ALIKE = 0.01, 4
"""Largest distance of two curves that are one, share of white; and how many exposures must have it where none holds all
light."""
HOPELESS = 0.06
"""RMS distance from a straight line of a first pass from which no second one is taken."""
LEAST_HZ, MOST_HZ = 35.0, 240.0
"""Rates at which slices and the differences behind them reach the end of a frame."""
WALL_FRAMES = 12
"""Frames of white, as of black before them, by which a wall is looked for: more than the most blanks that a picture's
light comes late."""
LEAST_LIGHT_DN = 4.0
"""Difference of an image's mean between black and white pictures from which something that is lit is seen."""
PROJECTOR_PAGE = "projector.html"
_MEASURED = ("latency", "light", "skew", "grey", "orientation", "sides", "raster")


@dataclass(frozen=True, slots=True)
class ProjectorMeasured:
    """Everything that was measured of a projector."""

    lamp: Lamp
    skew_us: float
    """Time by which the light begins later in the right camera's images than in the left one's: that much earlier it
    exposes."""
    lines: Mapping[str, LineLight]
    """Single lines, compared, by ``columns`` and ``rows``."""
    seen: Mapping[str, SeenPicture]
    """Orientation by camera."""
    photographs: Mapping[str, Image]
    """Pictures as the cameras see them, (h, w), by what and side, ``checker_left``."""


def outcomes_in_order(outcomes: Iterable[StepOutcome]) -> tuple[list[StepOutcome], list[Finding]]:
    """Return the outcomes of the projector's steps and all their findings, each in the order in which they are
    measured."""

    def place(finding: Finding) -> int:
        return _MEASURED.index(finding.name)

    ordered = sorted(outcomes, key=lambda one: place(one.findings[0]))
    return ordered, sorted((finding for one in ordered for finding in one.findings), key=place)


def measure_on_wall(at: Workplace) -> ProjectorMeasured:
    """Ask for a white wall, and measure the projector on it. Raises DeviceError, BringupError, GivenUp."""
    with bench_on(at.rig, at.wires) as bench:
        _before_white(at, bench)
        return measure_projector(bench, at.rig.scan.most_gain_db, at.say)


def _before_white(at: Workplace, bench: Bench) -> None:
    """Ask for a white wall until the projector's light is seen on it by both cameras; at most so often, then it is
    tried as it is."""
    for turn in range(MOST_ASKED):
        at.person.ask(numbered(f"{wall(at)}, and darken the room", turn))
        at.say("looking for the projector's light")
        if _lit(at, bench):
            return


def _lit(at: Workplace, bench: Bench) -> bool:
    """Tell whether both cameras see the projector's light at all."""
    bench.load(flat_pictures(bench.size_px, (0, 255)), all_channels=False)
    # The latency is not known yet: enough frames of each that it does not matter.
    shot = Shot(at.rig.board.trigger_delay_us, round(1000.0 * at.rig.camera.left.exposure_ms))
    seen = bench.take([0] * WALL_FRAMES + [1] * WALL_FRAMES, shot)
    levels = [mean_levels(images, np.ones(images.shape[1:], np.bool_)) for images in seen.values()]
    return all(float(one.max() - one.min()) > LEAST_LIGHT_DN for one in levels)


def measure_projector(bench: Bench, gain_db: float, say: Progress) -> ProjectorMeasured:
    """Measure everything; ``gain_db`` is that of the short exposures. Raises BringupError, DeviceError."""
    if not LEAST_HZ <= bench.refresh_hz <= MOST_HZ:
        raise BringupError(
            f"projector.refresh_hz {bench.refresh_hz:g}: allowed here are {LEAST_HZ:g}..{MOST_HZ:g}; measure in a mode "
            "of 60 Hz"
        )
    period_us = 1e6 / bench.refresh_hz
    say("latency", 0.0)
    latency, parts = measure_latency(bench)
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
        # Equal sub-frames are one lamp thrice; another number of equal ones would be chance, and unequal ones are
        # colours.
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
    shot = Shot(best.delay_us, best.exposure_us, blanks=timing.latency_blanks)
    seen, letters = measure_orientation(bench, shot, all_channels=channels == "all")
    say("raster", 0.92)
    lines, checkers = measure_lines(bench, shot, all_channels=channels == "all")
    lamp = Lamp(timing, channels, sub_frames, profiles, responses, ramps, offer)
    return ProjectorMeasured(lamp, skew_us, lines, seen, {**letters, **checkers})


def _gain_of_channels(
    bench: Bench, timing: LightTiming, parts: Mapping[str, NDArray[np.bool_]], period_us: float
) -> float:
    """Return how much brighter a white picture is with all channels than with green alone, over the whole frame."""
    light = []
    for all_channels in (False, True):
        bench.load(flat_pictures(bench.size_px, (255, 0)), all_channels=all_channels)
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
    """Return the light of each code in slices from the blank of its flip on, mean of both cameras, and their skew in
    µs."""
    bench.load(flat_pictures(bench.size_px, (*codes, 0)), all_channels=all_channels)
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
    """Return the slices of frames that follow each other (k, n), resampled to slices on one time axis from the flip's
    blank on."""
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
    bench.load(flat_pictures(bench.size_px, [int(code) for code in codes]), all_channels=channels == "all")
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
    """Return the responses, curved ones only where the lamp itself is curved so: like an exposure that holds all of its
    light."""
    full = [trial for trial, shape in responses.items() if shape.usable and light_of(trial) > ALL_OF_IT * whole]
    # Cut bit planes may look smooth by chance; but then each exposure has a curve of its own, and steady lamps have
    # one.
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
    """Return a trial whose curve is that of most others, where none holds all of the light; ``None``: there is no such
    curve."""
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


def _brightest(responses: Mapping[Trial, ResponseShape]) -> Trial:
    if not responses:
        raise BringupError(
            "no exposure fits between a picture's light and the next one's: set board.trigger_delay_us to 0, and a "
            "mode of 60 Hz or less"
        )
    return max(responses, key=lambda trial: responses[trial].light_dn)
