"""Owns the guess at images that nobody has described: hypotheses are tried on reduced images until one of them stands
out.

Hypotheses are data: the sequences of known programs (``sequences``), and what each image looks like by itself. Looks
choose a few of them; each of these is decoded, what its tests find instead is taken over, and it counts how much of the
images it explains (``expectation``). Of a rig whose numbers are known, rays decide which camera is which and where the
pattern lies.

It also owns how well a description explains its images: each is predicted from the coordinates that all of them make,
and compared.

Coordinates are smoothed first: those of a wrong order are noise, and predict nothing. The share of an image's variation
that its prediction explains is near 1 where the description is right, near 0 where an image shows something else, and
near 0, too, for stripes that the camera does not resolve: these vary little, and weigh so much less.

It also owns which periods several sets of fringes have, by their phases alone: how fast each runs, and on which whole
numbers all agree.

From a pixel to the next, phase k runs r_k times as fast as that of the finest fringes: r_k is the ratio of their
numbers. Of all whole numbers in such ratios those are right with which the phases agree on one fringe; that they do so
by chance is the less likely the fewer fringes there are.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.base import Progress
from appliance.desk.foreign.appearance import Looks, agreement, look_at, share_of_range, words_by_looks
from appliance.desk.foreign.assumptions import (
    MOST_MISFIT,
    ExaminedAssumption,
    Outcome,
    measured_steps,
    misfit,
)
from appliance.desk.foreign.camera import DecodedCamera, decode_camera
from appliance.desk.foreign.camera_files import camera_numbers, cameras_in
from appliance.desk.foreign.cameras import read_rig
from appliance.desk.foreign.cross_checks import WHICH_IS_LEFT, examine
from appliance.desk.foreign.decode import by_periods, chance_misfit
from appliance.desk.foreign.description import EACH, LEAST_STEPS, AxisConvention, Description, ImageFiles, equal_steps
from appliance.desk.foreign.files import camera_files, in_halves, other_way_round, taken_in_turns
from appliance.desk.foreign.frames import Frame, FrameReader
from appliance.desk.foreign.images import CHANNEL_NUMBER, FULL_SCALES, ImageSet, Pictures, of_channel
from appliance.desk.foreign.order import FRINGES, ProjectedSequence, ShownImage, Shows, hypotheses, joined, numbered
from appliance.desk.foreign.phase import Floats, fit_sine
from appliance.desk.foreign.problem import ForeignError, Table

SMOOTHED_PX = 5
LEAST_PIXELS = 500
NOWHERE = -1e6


def explained_shares(
    description: Description, camera: DecodedCamera
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return for each image the share of its variation that is explained, 1 at most, and the weight it has (n,)."""
    shares, lit = share_of_range(np.stack(list(camera.images.images)))
    smooth = {axis.name: _smoothed(camera.placed[axis.name].coordinate_px, lit) for axis in description.axes}
    explained, weights = np.zeros(len(shares)), np.zeros(len(shares))
    for k, one in enumerate(camera.images.shown):
        axis = description.axis(one.axis)
        if axis is None:
            seen = shares[k][lit] - 0.5
            expected = np.full_like(seen, 0.5 if one.shows is Shows.BRIGHT else -0.5)
            weights[k] = 0.25
        else:
            coordinate_px, usable = smooth[axis.name]
            modulated = one.shows is Shows.MODULATED
            # Of one that a carrier multiplies, the mean over the carrier's steps.
            steps = axis.carriers[one.period] if modulated else 1
            first = k - one.index % steps
            seen = shares[first : first + steps, usable].mean(axis=0)
            seen = seen - (seen.mean() if modulated else np.float32(0.5))
            if len(seen) < LEAST_PIXELS:
                continue
            expected = expected_values(axis, one, coordinate_px[usable] + 0.5)
            # Blur takes contrast from stripes and sines, and explains nothing away.
            contrast = max(0.0, float(expected @ seen) / max(float(expected @ expected), 1e-9))
            expected = contrast * expected
            weights[k] = float(np.mean(np.square(seen)))
        explained[k] = 1.0 - float(np.mean(np.square(seen - expected))) / max(float(np.mean(np.square(seen))), 1e-9)
    return explained, weights


def expected_values(axis: AxisConvention, one: ShownImage, edge_px: NDArray[Any]) -> NDArray[Any]:
    """Return what an image of ``axis`` shows at places ``edge_px`` from the edge of the pattern, −½ … ½."""
    if one.shows in (Shows.GRAY, Shows.INVERSE):
        number = np.floor((edge_px - axis.code_offset_px) / axis.stripe_px).astype(np.int64)
        digit = one.index if axis.fine_first else axis.bits - 1 - one.index
        bit = ((number if axis.plain_binary else number ^ (number >> 1)) >> digit) & 1
        return (bit - 0.5) * (-1.0 if axis.inverted != (one.shows is Shows.INVERSE) else 1.0)
    period, step = one.period, one.index
    if one.shows is Shows.MICRO:
        period, step = [(k, n) for k, steps in enumerate(axis.steps_deg) for n in range(len(steps))][one.index]
    elif one.shows is Shows.MODULATED:
        step = one.index // axis.carriers[period]
    turns = edge_px / axis.periods_px[period] + (axis.begins_deg[period] + axis.signed_deg[period][step]) / 360.0
    return np.asarray(0.5 * np.cos(2.0 * np.pi * turns))


def _smoothed(coordinate_px: Floats, lit: NDArray[np.bool_]) -> tuple[Floats, NDArray[np.bool_]]:
    known = np.isfinite(coordinate_px)
    # A median needs all of its neighbours, or the border of the thing itself would count as an error.
    whole = cv2.erode(known.astype(np.uint8), np.ones((SMOOTHED_PX, SMOOTHED_PX), np.uint8)) > 0
    filled = np.where(known, coordinate_px, NOWHERE).astype(np.float32)
    return np.asarray(cv2.medianBlur(filled, SMOOTHED_PX)), whole & lit


MOST_FRINGES = 200
RATIO_SLACK = 0.03
"""Allowed relative error of a ratio of speeds."""
LEAST_RUN_TURNS = 0.004
"""Slowest phase of the finest fringes, from a pixel to the next, that a ratio is taken of."""
LAGS_PX = (1, 4, 16)
"""Distances over which phases are compared; the longest over which the finest fringes run less than half a turn counts.
"""
PIXELS = 1000
STRONG = 0.5


def periods_by_phases(
    images: Sequence[NDArray[Any]], steps_deg: Sequence[tuple[float, ...]], name: str, size_px: float
) -> tuple[float, ...]:
    """Return the periods in px of the direction ``name``, along which the pattern is ``size_px`` long.

    ``images`` (n, h, w) are those of each period in the order of its steps.
    """
    if len(images) < 2:
        return (size_px,) * len(images)
    fits = [fit_sine(list(one), steps, np.inf) for one, steps in zip(images, steps_deg, strict=True)]
    strong = np.logical_and.reduce([fit.modulation > STRONG * np.quantile(fit.modulation, 0.9) for fit in fits])
    finest = int(np.argmax([_speed(fit.turns, strong, name) for fit in fits]))
    # A lag of several pixels tells slow phases better, and wraps fast ones.
    ratios = np.array([_ratio(fit.turns, fits[finest].turns, strong, name) for fit in fits])
    ratios[finest] = 1.0
    places = np.flatnonzero(strong)
    places = places[:: max(1, len(places) // PIXELS)]
    few = [fit.turns.ravel()[places] for fit in fits]
    best, best_share = tuple(float(size_px * (k + 1) / len(fits)) for k in range(len(fits)))[::-1], np.inf
    for count in range(len(fits), MOST_FRINGES + 1):
        wanted = count * ratios
        fringes = np.rint(wanted)
        if fringes.min() < 1.0 or len(set(fringes)) < len(fits) or np.abs(fringes / wanted - 1.0).max() >= RATIO_SLACK:
            continue  # no whole numbers, all different, are near
        axis = AxisConvention(name, size_px, tuple(float(size_px / one) for one in fringes), tuple(steps_deg))
        share = float(np.median(by_periods(few, axis)[1])) / chance_misfit(axis)
        if share < 0.9 * best_share:
            best, best_share = axis.periods_px, share
    return best


def _differences(turns: NDArray[Any], strong: NDArray[np.bool_], name: str, lag: int) -> NDArray[np.float64]:
    """Return by how much phases differ over ``lag`` px along the direction, wrapped, NaN where they are weak."""
    values, known = (turns, strong) if name == "x" else (turns.T, strong.T)
    step = (values[:, lag:] - values[:, :-lag]).astype(np.float64)
    step -= np.rint(step)
    return np.where(known[:, lag:] & known[:, :-lag], step, np.nan)


def _speed(turns: NDArray[Any], strong: NDArray[np.bool_], name: str) -> float:
    step = np.abs(_differences(turns, strong, name, LAGS_PX[0]))
    known = step[np.isfinite(step)]
    return float(np.median(known)) if known.size else 0.0


def _ratio(slow: NDArray[Any], fast: NDArray[Any], strong: NDArray[np.bool_], name: str) -> float:
    """Return how fast one phase runs over how fast another does: the longest lag whose whole turns the shorter one
    tells."""
    ratio, near = 1.0, None
    for lag in LAGS_PX:
        of_slow, of_fast = (_differences(one, strong, name, lag) for one in (slow, fast))
        if near is not None:
            # What a quarter of the lag told says how many whole turns were wrapped away.
            length = LAGS_PX[1] // LAGS_PX[0]
            for step, before in ((of_slow, near[0]), (of_fast, near[1])):
                expected = length * before[:, : step.shape[1]]
                step += np.rint(expected - step)
        near = of_slow, of_fast
        usable = np.isfinite(of_slow) & np.isfinite(of_fast) & (np.abs(of_fast) > LEAST_RUN_TURNS * lag)
        if np.count_nonzero(usable) > 100:
            ratio = float(np.median(of_slow[usable] / of_fast[usable]))
    return max(ratio, 1e-4)


MOST_PIXELS = 400_000
"""Pixels of an image on which hypotheses are tried; larger ones are reduced."""
BY_LOOKS = "what each image looks like"
MOST_TRIED = 10
SURE, NEARLY = 0.9, 0.3
"""Share explained from which on no hypotheses are tried whose looks agree less by the second number than the best
one's."""
ROUNDS = 3
EVERY = 4
GUESSED_PX = (1024.0, 768.0)
GOOD, FAIR = 0.75, 0.5
"""Share of the images' variation that is explained by what is surely right; below the second one nothing is known."""
APART = 1.5
"""Ratio of what is left unexplained from which on one hypothesis stands out before another one."""
LEAST_LEFT = 0.01
"""Noise and blur leave so much unexplained at least."""
MOST_RIVALS = 4
PER_WRONG = 0.2
COLOURED = 1.06
LEAST_ALIKE, LEAST_SPREAD = 0.5, 4.0
"""Least correlation of the channels of a picture that shows one pattern, and least deviation of their grey values that
tells."""
PROJECTORS_PX = (
    (608, 684), (640, 480), (640, 360), (800, 600), (854, 480), (848, 480), (912, 1140), (1024, 768), (1280, 800), (1280, 720), (1280, 1024),
    (1366, 768), (1400, 1050), (1440, 900), (1600, 1200), (1824, 1140), (1920, 1080), (1920, 1200), (2560, 1600), (3840, 2160),
)  # fmt: skip
"""Sizes that projectors have; of equal widths the commonest one first."""


@dataclass(frozen=True, slots=True, eq=False)
class TriedSequence:
    """A hypothesis that was tried on the images of a folder."""

    program: str
    images: NDArray[Any]
    """(n, h, w): those on which it was tried, reduced."""
    description: Description
    tested: tuple[ExaminedAssumption, ...] = ()
    explained: float = 0.0
    """Share of the images' variation that it explains."""
    by_image: tuple[float, ...] = ()
    """The same for each image."""
    notes: tuple[str, ...] = ()
    """Remarks to be read before the description."""

    @property
    def words(self) -> list[str]:
        """Words of a description for each image."""
        return [one.word for one in self.description.order or ()]

    @property
    def rank(self) -> float:
        """The share, less what is taken off for each contradiction."""
        return self.explained - PER_WRONG * self.contradictions

    @property
    def standing(self) -> tuple[int, int, bool]:
        """Order of sequences that explain as much: by contradictions, by what could have been one, and by whether it is
        known."""
        # Words that could have been contradicted and were not, less those that nothing tells.
        evidence = self._count(Outcome.FITS) - self._count(Outcome.UNCHECKED)
        return -self.contradictions - bool(self.notes), evidence, self.program != BY_LOOKS

    @property
    def contradictions(self) -> int:
        """Number of words that the images contradict."""
        return self._count(Outcome.WRONG)

    def _count(self, outcome: Outcome) -> int:
        return sum(one.outcome is outcome for one in self.tested)


@dataclass(frozen=True, slots=True, eq=False)
class _ReducedPictures:
    """Pictures of a folder, each read once and reduced by whole numbers to ``MOST_PIXELS``: each pixel is a mean."""

    progress: Progress
    _read: dict[tuple[Frame, str], NDArray[Any]] = field(default_factory=dict)

    def of(self, frames: Sequence[Frame], channel: str) -> tuple[NDArray[Any], tuple[int, int]]:
        """Return the images (n, h, w) of one camera, and the width and height that they had. Raises ForeignError."""
        pictures = Pictures.of(frames, channel)
        height_px, width_px = pictures.shape[1:]
        factor = math.ceil(math.sqrt(height_px * width_px / MOST_PIXELS))
        small_px = width_px // factor, height_px // factor
        for k, frame in enumerate(frames):
            if (frame, channel) not in self._read:
                self.progress(f"reading {frame.name}")
                whole = pictures[k][: small_px[1] * factor, : small_px[0] * factor]
                self._read[frame, channel] = cv2.resize(whole, small_px, interpolation=cv2.INTER_AREA)
        return np.stack([self._read[frame, channel] for frame in frames]), (width_px, height_px)


def guess_sequence(folder: Path, progress: Progress) -> tuple[TriedSequence, ...]:
    """Return what the images below ``folder`` show: one sequence, or the best two where none stands out.

    Raises ForeignError where nothing is known that they could show.
    """
    named, table, pictures = camera_files(folder), cameras_in(folder), _ReducedPictures(progress)
    found: list[TriedSequence] = []
    refused: ForeignError | None = None
    for cameras in [named] if len(named) == 2 else _ways(folder, table, named["left"]):
        if found and max(one.rank for one in found) >= GOOD:
            break  # another way to share the images only where this one makes no sense
        try:
            found += _candidates(folder, cameras, pictures)
        except ForeignError as error:
            refused = refused or error
    found.sort(key=lambda one: -one.rank)
    if not found or found[0].rank < FAIR:
        told = (
            f"; the nearest, {joined(found[0].words)}, explains {100 * found[0].explained:.0f} % of them"
            if found
            else ""
        )
        raise refused or ForeignError(
            f"{folder}: its images are no sequence that is known{told}; name what each shows in a description "
            "(docs/foreign.md)"
        )
    left = max(1.0 - found[0].rank, LEAST_LEFT)
    # Several readings may explain as much: a sine of few steps and a code of fine stripes look alike.
    rivals = [one for one in found if 1.0 - one.rank < APART * left][:MOST_RIVALS]
    # Rays know what no image tells: which camera is left, and which way fringes run.
    if table:
        progress("trying the cameras")
        rivals = [_on_rig(one, table, pictures) for one in rivals]
    # Of what explains as much, that which more tests could have contradicted.
    best = max(one.standing for one in rivals)
    return tuple([one for one in rivals if one.standing == best][:2])


def _ways(folder: Path, table: Mapping[str, Any], camera: ImageFiles) -> list[dict[str, ImageFiles]]:
    """Return the ways in which files of one name may be those of one camera, or of two, the likeliest first."""
    two = "calibration" in table
    if "files" in table:
        with suppress(ForeignError):
            two = not camera_numbers(folder, Table("cameras.", table), of_projector=True).has_projector
    alone = {"left": camera}
    return [*in_halves(camera), *taken_in_turns(camera), alone] if two else [alone, *taken_in_turns(camera)]


def _candidates(folder: Path, cameras: Mapping[str, ImageFiles], pictures: _ReducedPictures) -> list[TriedSequence]:
    """Return what the left camera's images may show, each order once."""
    channel = _channel(cameras["left"].frames)
    files = {side: replace(one, frames=tuple(of_channel(one.frames, channel))) for side, one in cameras.items()}
    images, _ = pictures.of(files["left"].frames, channel)
    places = _different(images) if channel == EACH else list(range(len(images)))
    looks = look_at(images[places])
    agreed = sorted(((agreement(looks, one.shown), one) for one in _all_hypotheses(looks)), key=lambda two: -two[0])
    best: dict[tuple[ShownImage, ...], TriedSequence] = {}
    # Looks alone are often wrong about the finest stripes: what looks nearly as well is tried, too.
    for agrees, sequence in agreed[:MOST_TRIED]:
        if agrees < agreed[0][0] - NEARLY and max((one.rank for one in best.values()), default=0.0) > SURE:
            break
        pictures.progress(f"trying {sequence.program}")
        with suppress(ForeignError):  # steps that tell no phase, stripes that number nothing: no candidate
            axes = _conventions(sequence, images[places])
            order = [ShownImage(Shows.OTHER)] * len(images)
            for place, one in zip(places, sequence.shown, strict=True):
                order[place] = one
            size_px = [int(one) for one in GUESSED_PX]
            for axis in axes:
                size_px["xy".index(axis.name)] = round(axis.size_px)
            description = Description(
                folder.name, folder, files, tuple(order), channel, None, (size_px[0], size_px[1]), axes, Table("cameras.", {})
            )  # fmt: skip
            tried = _explained(TriedSequence(sequence.program, images, description), places, pictures)
            if sequence.shown not in best or tried.rank > best[sequence.shown].rank:
                best[sequence.shown] = tried
    return list(best.values())


def _all_hypotheses(looks: Looks) -> Iterator[ProjectedSequence]:
    seen = set()
    for one in hypotheses(len(looks.mean)):
        if one.shown not in seen:
            seen.add(one.shown)
            yield one
    with suppress(ForeignError):
        yield ProjectedSequence(BY_LOOKS, shown=numbered(words_by_looks(looks), "images.order"))


def _channel(files: Sequence[Frame]) -> str:
    """Return the channel that tells most, or that each is an image of its own: of the first picture, or of one in the
    middle."""
    for frame in (files[0], files[len(files) // 2]):
        image = FrameReader().raw(frame)
        if image.ndim < 3 or image.shape[2] < len(CHANNEL_NUMBER):
            return "grey"
        few = image[::4, ::4, :3]
        if not _alike(np.moveaxis(few, 2, 0)):
            return EACH
    spread = few.std(axis=(0, 1))
    return list(CHANNEL_NUMBER)[int(np.argmax(spread))] if spread.max() > COLOURED * spread.min() else "grey"


def _alike(channels: NDArray[Any]) -> bool:
    """Tell whether ``channels`` (3, h, w) show one pattern: light of one colour is reflected by all alike, but for what
    each has been sent."""
    few = channels.reshape(len(channels), -1).astype(np.float64)
    return float(few.std(axis=1).min()) < LEAST_SPREAD or float(np.corrcoef(few).min()) >= LEAST_ALIKE


def _different(images: NDArray[Any]) -> list[int]:
    """Return the numbers of the channels (n, h, w), three of each picture, that are images of their own: of a grey
    picture the first."""
    return [
        k
        for first in range(0, len(images), 3)
        for k in range(first, first + (1 if _alike(images[first : first + 3]) else 3))
    ]


# ------------------------------------------------------------------------------------------------ conventions


def _conventions(sequence: ProjectedSequence, images: NDArray[Any]) -> tuple[AxisConvention, ...]:
    """Return the conventions by which ``images`` (n, h, w) are first read; tests say what fits instead.

    Raises ForeignError.
    """
    names = [name for name in "xy" if any(one.axis == name for one in sequence.shown)]
    axes = [_convention(name, sequence, images) for name in names]
    code_alone = [axis.stripe_px for axis in axes if not axis.periods_px]
    # Programs draw stripes of equal widths in both directions.
    return tuple(axis if axis.periods_px else replace(axis, stripe_px=min(code_alone)) for axis in axes)


def _convention(name: str, sequence: ProjectedSequence, images: NDArray[Any]) -> AxisConvention:
    size_px = GUESSED_PX["xy".index(name)]
    mine = [one for one in sequence.shown if one.axis == name]
    bits = sum(one.shows is Shows.GRAY for one in mine)
    stripe_px = 0.0
    if bits:
        size_px = float(2 ** max(round(np.log2(size_px)), bits))
        stripe_px = max(size_px / 2**bits, 0.5)
    fields = {"size_px": size_px, "periods_px": (), "steps_deg": (), **sequence.conventions}
    fringes = [
        [
            k
            for k, one in enumerate(sequence.shown)
            if one.axis == name and one.shows in FRINGES and one.period == period
        ]
        for period in sorted({one.period for one in mine if one.shows in FRINGES})
    ]
    if fringes and not fields["periods_px"]:
        fields["steps_deg"] = tuple(_steps(images[group]) for group in fringes)
        fields["periods_px"] = (stripe_px,)
        if not bits or len(fringes) > 1:
            groups = [images[group] for group in fringes]
            fields["periods_px"] = periods_by_phases(groups, fields["steps_deg"], name, size_px)
            stripe_px = max(fields["periods_px"]) if bits else 0.0
    return AxisConvention(name, bits=bits, stripe_px=stripe_px, **fields)


def _steps(images: NDArray[Any]) -> tuple[float, ...]:
    """Return the steps of images (n, h, w) of one period: equal ones where they fit.

    Raises ForeignError where no steps do.
    """
    steps = equal_steps(len(images))
    if len(steps) < LEAST_STEPS:
        raise ForeignError(f"{len(images)} images tell no phase")
    if len(steps) == LEAST_STEPS:
        return steps  # These fit anything.
    stack = images[:, ::EVERY, ::EVERY].reshape(len(images), -1).astype(np.float64)
    swing = np.ptp(stack, axis=0)
    stack = stack[:, swing > 0.5 * float(np.quantile(swing, 0.9))]
    if misfit(stack, steps) >= MOST_MISFIT:
        steps = measured_steps(stack)
        if misfit(stack, steps) > MOST_MISFIT:
            raise ForeignError(f"{len(images)} images are no steps of one sine")
    return steps


def _explained(candidate: TriedSequence, places: Sequence[int], pictures: _ReducedPictures) -> TriedSequence:
    """Return a candidate that fits its images, and how much of those at ``places`` it explains. Raises ForeignError."""
    candidate, decoded = _fitted(candidate, pictures)
    shares, weights = explained_shares(candidate.description, decoded["left"])
    kept = [k for k, word in enumerate(candidate.words) if word != "-"]
    # What no role explains counts as not explained; images that vary little weigh little: of stripes finer than pixels
    # nothing can be.
    total = float((shares * weights).sum() / max(weights.sum() + 0.25 * (len(places) - len(kept)), 1e-9))
    by_image = np.full(len(candidate.images), np.nan)
    by_image[kept] = shares
    return replace(candidate, explained=total, by_image=tuple(by_image.tolist()))


def _fitted(candidate: TriedSequence, pictures: _ReducedPictures) -> tuple[TriedSequence, dict[str, DecodedCamera]]:
    """Return the candidate with what fits in place of what its tests contradict, and its cameras: the left one alone
    where nothing says how both stand. Raises ForeignError."""
    for _ in range(ROUNDS):
        description = candidate.description
        with_rays = bool(description.cameras.content)
        decoded, sizes_px = {}, {"right": description.projector_px}
        for side in description.files if with_rays else ("left",):
            frames = description.files[side].frames
            images, sizes_px[side] = pictures.of(frames, description.channel)
            decoded[side] = decode_camera(_image_set(frames, description, images), description)
        rig = read_rig(description, sizes_px) if with_rays else None
        candidate = replace(candidate, tested=examine(description, decoded, rig))
        changed = _with_instead(candidate)
        if changed.description == description:
            break
        candidate = changed
    return candidate, decoded


def _image_set(frames: Sequence[Frame], description: Description, images: NDArray[Any]) -> ImageSet:
    """Return those of ``images`` (n, h, w) that show something of the sequence."""
    shown = description.order or ()
    kept = [k for k, one in enumerate(shown) if one.shows is not Shows.OTHER]
    white = next(one for one in FULL_SCALES if float(images.max()) <= one)
    return ImageSet(tuple(shown[k] for k in kept), tuple(frames[k] for k in kept), images[kept], white)


def _with_instead(candidate: TriedSequence) -> TriedSequence:
    """Return the candidate with what fits in place of what was contradicted: fields of its conventions, or the cameras
    exchanged."""
    description = candidate.description
    for one in candidate.tested:
        if one.outcome is not Outcome.WRONG:
            continue
        if one.subject == WHICH_IS_LEFT:
            description = replace(description, files=other_way_round(description.files))
        for key, value in one.corrections.items():
            # Of one camera's images a direction's own words are named; what rays say names the direction, too.
            name, _, word = (key if "." in key else f"{one.subject.rpartition(': ')[2][0]}.{key}").partition(".")
            axis = description.axis(name)
            if axis is not None:
                description = description.with_axis(replace(axis, **{word: value}))
    return replace(candidate, description=description)


# ------------------------------------------------------------------------------------------- cameras, projector


def _on_rig(candidate: TriedSequence, table: Mapping[str, Any], pictures: _ReducedPictures) -> TriedSequence:
    """Return the candidate with the cameras of the folder, and with what their rays make of it."""
    said = replace(candidate.description, cameras=Table("cameras.", table))
    found: list[TriedSequence] = []
    try:
        left_px = pictures.of(said.files["left"].frames, said.channel)[1]
        for description in _on_projectors(said, left_px) if len(said.files) == 1 else [said]:
            found.append(_fitted(replace(candidate, description=description), pictures)[0])
            if not found[-1].contradictions:
                break
    except ForeignError as error:
        return replace(candidate, description=said, notes=(str(error),))
    return min(found, key=lambda one: one.contradictions)


def _on_projectors(description: Description, left_px: tuple[int, int]) -> Iterator[Description]:
    """Yield the description with each size that the projector may have: the one its calibration states, else those by
    its axis."""
    table = description.cameras
    stated_px = None
    if "files" in table.content:
        stated_px = camera_numbers(description.folder, table, of_projector=True).stated_px.get("right")
    sizes = [stated_px] if stated_px else []
    if not sizes:
        # Any size will do to ask where the projector's axis is.
        right = read_rig(description, {"left": left_px, "right": description.projector_px}).rig.right
        width_px = 2.0 * right.lens.c_px[0] + 1.0
        nearest_px = min((width for width, _ in PROJECTORS_PX), key=lambda width: abs(width - width_px))
        sizes = [size for size in PROJECTORS_PX if size[0] == nearest_px]
    for size_px in sizes:
        axes = tuple(_of_size(axis, float(size_px["xy".index(axis.name)])) for axis in description.axes)
        yield replace(description, projector_px=size_px, axes=axes)


def _of_size(axis: AxisConvention, size_px: float) -> AxisConvention:
    """Return the convention of the same images where the pattern is ``size_px`` long."""
    scale = size_px / axis.size_px
    if axis.bits:
        # Beside fringes stripes divide the pattern; of a code alone they are whole powers of two of the projector's px.
        whole_px = size_px / 2**axis.bits
        if not axis.periods_px or whole_px != round(whole_px):
            whole_px = max(2.0 ** (math.ceil(math.log2(size_px)) - axis.bits), 1.0)
        scale = whole_px / axis.stripe_px
    periods_px = axis.periods_px if axis.micro or axis.carriers else tuple(scale * one for one in axis.periods_px)
    stripe_px, offset_px = scale * axis.stripe_px, scale * axis.code_offset_px
    return replace(axis, size_px=size_px, periods_px=periods_px, stripe_px=stripe_px, code_offset_px=offset_px)
