"""Guess at images without a description: hypotheses are tried until one of them stands out.

* ``guess_sequence``: the guess. Hypotheses are data: the sequences of known programs (``SEQUENCES``), and the appearance
  of each image by itself. Appearance selects a few of them. Each of these is decoded, the corrections of its tests are
  adopted, and it counts how much of the images it explains (``expected_values``). With a rig whose numbers are known,
  rays decide which camera is which and where the pattern lies.
* ``explained_shares``: how well a description explains its images. Each is predicted from the coordinates that all of
  them make, and compared.
* ``periods_by_phases``: the periods of several sets of fringes, by their phases alone.

Coordinates are smoothed before a prediction: those of a wrong order are noise, and predict no image. The share of an
image's variation that its prediction explains is near 1 where the description is right and near 0 where the image shows
another pattern. It is near 0, too, for stripes that the camera does not resolve: these vary little, and have little weight.

From a pixel to the next, phase k runs r_k times as fast as that of the finest fringes: r_k is the ratio of their
numbers. The right whole numbers in such ratios make the phases agree on one fringe; that wrong ones do so by chance is
the less likely the fewer fringes there are.
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
    estimate_steps,
    misfit,
)
from appliance.desk.foreign.camera import DecodedCamera, decode_camera
from appliance.desk.foreign.camera_files import camera_numbers, cameras_in
from appliance.desk.foreign.cameras import read_rig
from appliance.desk.foreign.cross_checks import WHICH_IS_LEFT, examine
from appliance.desk.foreign.decode import chance_misfit, place_by_periods
from appliance.desk.foreign.description import EACH, LEAST_STEPS, AxisConvention, Description, ImageFiles, equal_steps
from appliance.desk.foreign.files import camera_files, exchange_sides, in_halves, in_turns
from appliance.desk.foreign.frames import Frame, FrameReader
from appliance.desk.foreign.images import CHANNEL_NUMBER, FULL_SCALES, ImageSet, Pictures, of_channel
from appliance.desk.foreign.order import (
    FRINGES,
    ProjectedSequence,
    ShownImage,
    Shows,
    hypotheses,
    join_words,
    number_images,
)
from appliance.desk.foreign.phase import Floats, fit_sine
from appliance.desk.foreign.problem import ForeignError, Table

SMOOTHED_PX = 5
LEAST_PIXELS = 500
NOWHERE = -1e6


def explained_shares(
    description: Description, camera: DecodedCamera
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return for each image the explained share of its variation, 1 at most, and its weight (n,)."""
    shares, illuminated = share_of_range(np.stack(list(camera.images.images)))
    smooth = {axis.name: _smooth(camera.placed[axis.name].coordinate_px, illuminated) for axis in description.axes}
    explained, weights = np.zeros(len(shares)), np.zeros(len(shares))
    for k, shown in enumerate(camera.images.shown):
        axis = description.axis(shown.axis)
        if axis is None:
            signal = shares[k][illuminated] - 0.5
            expected = np.full_like(signal, 0.5 if shown.shows is Shows.BRIGHT else -0.5)
            weights[k] = 0.25
        else:
            coordinate_px, usable = smooth[axis.name]
            modulated = shown.shows is Shows.MODULATED
            # Average fringes with a carrier over the carrier's steps.
            steps = axis.carriers[shown.period] if modulated else 1
            first = k - shown.index % steps
            signal = shares[first : first + steps, usable].mean(axis=0)
            signal = signal - (signal.mean() if modulated else np.float32(0.5))
            if len(signal) < LEAST_PIXELS:
                continue
            expected = expected_values(axis, shown, coordinate_px[usable] + 0.5)
            # Blur lowers the contrast of stripes and sines: fit the contrast.
            contrast = max(0.0, float(expected @ signal) / max(float(expected @ expected), 1e-9))
            expected = contrast * expected
            weights[k] = float(np.mean(np.square(signal)))
        explained[k] = 1.0 - float(np.mean(np.square(signal - expected))) / max(float(np.mean(np.square(signal))), 1e-9)
    return explained, weights


def expected_values(axis: AxisConvention, shown: ShownImage, edge_px: NDArray[Any]) -> NDArray[Any]:
    """Return the values, −½ … ½, of an image of ``axis`` at distances ``edge_px`` from the pattern's edge."""
    if shown.shows in (Shows.GRAY, Shows.INVERSE):
        number = np.floor((edge_px - axis.code_offset_px) / axis.stripe_px).astype(np.int64)
        digit = shown.index if axis.fine_first else axis.bits - 1 - shown.index
        bit = ((number if axis.plain_binary else number ^ (number >> 1)) >> digit) & 1
        return (bit - 0.5) * (-1.0 if axis.inverted != (shown.shows is Shows.INVERSE) else 1.0)
    period, step = shown.period, shown.index
    if shown.shows is Shows.MICRO:
        period, step = [(k, n) for k, steps in enumerate(axis.steps_deg) for n in range(len(steps))][shown.index]
    elif shown.shows is Shows.MODULATED:
        step = shown.index // axis.carriers[period]
    phase_turns = edge_px / axis.periods_px[period] + (axis.begins_deg[period] + axis.signed_deg[period][step]) / 360.0
    return np.asarray(0.5 * np.cos(2.0 * np.pi * phase_turns))


def _smooth(coordinate_px: Floats, illuminated: NDArray[np.bool_]) -> tuple[Floats, NDArray[np.bool_]]:
    finite = np.isfinite(coordinate_px)
    # A median needs all of its neighbours, or the border of the object would count as an error.
    has_neighbours = cv2.erode(finite.astype(np.uint8), np.ones((SMOOTHED_PX, SMOOTHED_PX), np.uint8)) > 0
    filled = np.where(finite, coordinate_px, NOWHERE).astype(np.float32)
    return np.asarray(cv2.medianBlur(filled, SMOOTHED_PX)), has_neighbours & illuminated


MOST_FRINGES = 200
RATIO_SLACK = 0.03
"""Largest relative error of a ratio of speeds."""
LEAST_RUN_TURNS = 0.004
"""Least change of the finest fringes' phase from a pixel to the next for which a ratio is computed."""
LAGS_PX = (1, 4, 16)
"""Distances over which phases are compared; the longest one counts at which whole turns are known from the shorter."""
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
    fits = [fit_sine(list(group), steps, np.inf) for group, steps in zip(images, steps_deg, strict=True)]
    strong = np.logical_and.reduce([fit.modulation > STRONG * np.quantile(fit.modulation, 0.9) for fit in fits])
    finest = int(np.argmax([_speed(fit.turns, strong, name) for fit in fits]))
    # A lag of several pixels measures slow phases better, and wraps fast ones.
    ratios = np.array([_ratio(fit.turns, fits[finest].turns, strong, name) for fit in fits])
    ratios[finest] = 1.0
    places = np.flatnonzero(strong)
    places = places[:: max(1, len(places) // PIXELS)]
    samples = [fit.turns.ravel()[places] for fit in fits]
    best, best_share = tuple(float(size_px * (k + 1) / len(fits)) for k in range(len(fits)))[::-1], np.inf
    for count in range(len(fits), MOST_FRINGES + 1):
        exact = count * ratios
        fringes = np.rint(exact)
        if fringes.min() < 1.0 or len(set(fringes)) < len(fits) or np.abs(fringes / exact - 1.0).max() >= RATIO_SLACK:
            continue  # no whole numbers, all different, are near
        axis = AxisConvention(
            name, size_px, tuple(float(size_px / fringe_count) for fringe_count in fringes), tuple(steps_deg)
        )
        share = float(np.median(place_by_periods(samples, axis)[1])) / chance_misfit(axis)
        if share < 0.9 * best_share:
            best, best_share = axis.periods_px, share
    return best


def _differences(turns: NDArray[Any], strong: NDArray[np.bool_], name: str, lag: int) -> NDArray[np.float64]:
    """Return the wrapped phase differences over ``lag`` px along the direction, NaN where they are weak."""
    values, valid = (turns, strong) if name == "x" else (turns.T, strong.T)
    step = (values[:, lag:] - values[:, :-lag]).astype(np.float64)
    step -= np.rint(step)
    return np.where(valid[:, lag:] & valid[:, :-lag], step, np.nan)


def _speed(turns: NDArray[Any], strong: NDArray[np.bool_], name: str) -> float:
    step = np.abs(_differences(turns, strong, name, LAGS_PX[0]))
    finite = step[np.isfinite(step)]
    return float(np.median(finite)) if finite.size else 0.0


def _ratio(slow: NDArray[Any], fast: NDArray[Any], strong: NDArray[np.bool_], name: str) -> float:
    """Return the speed of one phase over that of another.

    The longest lag counts at which the shorter one tells the whole turns.
    """
    ratio, shorter = 1.0, None
    for lag in LAGS_PX:
        slow_step, fast_step = (_differences(turns, strong, name, lag) for turns in (slow, fast))
        if shorter is not None:
            # The step over a quarter of the lag says how many whole turns were wrapped.
            length = LAGS_PX[1] // LAGS_PX[0]
            for step, before in ((slow_step, shorter[0]), (fast_step, shorter[1])):
                expected = length * before[:, : step.shape[1]]
                step += np.rint(expected - step)
        shorter = slow_step, fast_step
        usable = np.isfinite(slow_step) & np.isfinite(fast_step) & (np.abs(fast_step) > LEAST_RUN_TURNS * lag)
        if np.count_nonzero(usable) > 100:
            ratio = float(np.median(slow_step[usable] / fast_step[usable]))
    return max(ratio, 1e-4)


MOST_PIXELS = 400_000
"""Pixels of an image on which hypotheses are tried; larger ones are reduced."""
BY_LOOKS = "classifying the images"
MOST_TRIED = 10
SURE, NEARLY = 0.9, 0.3
"""Explained share above which hypotheses are skipped whose appearance agrees less than the best one's by the second
number."""
ROUNDS = 3
EVERY = 4
GUESSED_PX = (1024.0, 768.0)
GOOD, FAIR = 0.75, 0.5
"""Explained share of the images' variation above which a hypothesis is surely right, and below which none is known."""
APART = 1.5
"""Ratio of the unexplained shares from which on one hypothesis stands out before another one."""
LEAST_LEFT = 0.01
"""Least unexplained share, by noise and blur."""
MOST_RIVALS = 4
PER_WRONG = 0.2
COLOURED = 1.06
LEAST_ALIKE, LEAST_SPREAD = 0.5, 4.0
"""Least correlation of the channels of a picture that shows one pattern, and least standard deviation of grey values
for a correlation."""
PROJECTORS_PX = (
    (608, 684), (640, 480), (640, 360), (800, 600), (854, 480), (848, 480), (912, 1140), (1024, 768), (1280, 800), (1280, 720), (1280, 1024),
    (1366, 768), (1400, 1050), (1440, 900), (1600, 1200), (1824, 1140), (1920, 1080), (1920, 1200), (2560, 1600), (3840, 2160),
)  # fmt: skip
"""Usual sizes of projectors; of equal widths the commonest first."""


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
        """The image roles, in the words of a description."""
        return [shown.word for shown in self.description.order or ()]

    @property
    def rank(self) -> float:
        """The explained share, less ``PER_WRONG`` for each contradiction."""
        return self.explained - PER_WRONG * self.contradictions

    @property
    def standing(self) -> tuple[int, int, bool]:
        """Order of sequences with equal shares: by contradictions, confirmed words, and a known program."""
        # Words that could have been contradicted and were not, less those that no test covers.
        evidence = self._count(Outcome.FITS) - self._count(Outcome.UNCHECKED)
        return -self.contradictions - bool(self.notes), evidence, self.program != BY_LOOKS

    @property
    def contradictions(self) -> int:
        """Number of words that the images contradict."""
        return self._count(Outcome.WRONG)

    def _count(self, outcome: Outcome) -> int:
        return sum(assumption.outcome is outcome for assumption in self.tested)


@dataclass(frozen=True, slots=True, eq=False)
class _ReducedPictures:
    """Pictures of a folder, each read once and reduced by whole numbers to ``MOST_PIXELS``.

    Each pixel is a mean.
    """

    progress: Progress
    _read: dict[tuple[Frame, str], NDArray[Any]] = field(default_factory=dict)

    def of(self, frames: Sequence[Frame], channel: str) -> tuple[NDArray[Any], tuple[int, int]]:
        """Return the images (n, h, w) of one camera, and the width and height before reduction.

        Raises ForeignError.
        """
        pictures = Pictures.of(frames, channel)
        height_px, width_px = pictures.shape[1:]
        factor = math.ceil(math.sqrt(height_px * width_px / MOST_PIXELS))
        small_px = width_px // factor, height_px // factor
        for k, frame in enumerate(frames):
            if (frame, channel) not in self._read:
                self.progress(f"reading {frame.name}")
                image = pictures[k][: small_px[1] * factor, : small_px[0] * factor]
                self._read[frame, channel] = cv2.resize(image, small_px, interpolation=cv2.INTER_AREA)
        return np.stack([self._read[frame, channel] for frame in frames]), (width_px, height_px)


def guess_sequence(folder: Path, progress: Progress) -> tuple[TriedSequence, ...]:
    """Return the sequence that the images below ``folder`` show, or the best two if none stands out.

    Raises ForeignError if no known sequence explains them.
    """
    cameras_by_name, table, pictures = camera_files(folder), cameras_in(folder), _ReducedPictures(progress)
    candidates: list[TriedSequence] = []
    rejection: ForeignError | None = None
    for cameras in [cameras_by_name] if len(cameras_by_name) == 2 else _ways(folder, table, cameras_by_name["left"]):
        if candidates and max(candidate.rank for candidate in candidates) >= GOOD:
            break  # share the images in another way only where this one makes no sense
        try:
            candidates += _candidates(folder, cameras, pictures)
        except ForeignError as error:
            rejection = rejection or error
    candidates.sort(key=lambda candidate: -candidate.rank)
    if not candidates or candidates[0].rank < FAIR:
        nearest = (
            f"; the nearest, {join_words(candidates[0].words)}, explains {100 * candidates[0].explained:.0f} % of them"
            if candidates
            else ""
        )
        raise rejection or ForeignError(
            f"{folder}: its images are no known sequence{nearest}; write an image set description with the image "
            "role of each (docs/foreign.md)"
        )
    unexplained = max(1.0 - candidates[0].rank, LEAST_LEFT)
    # Several readings may explain equal shares: a sine of few steps and a code of fine stripes look alike.
    rivals = [candidate for candidate in candidates if 1.0 - candidate.rank < APART * unexplained][:MOST_RIVALS]
    # Only rays tell which camera is left, and in which direction the fringes run.
    if table:
        progress("testing the cameras")
        rivals = [_on_rig(candidate, table, pictures) for candidate in rivals]
    # Of equal shares take the one that more tests could have contradicted.
    best = max(candidate.standing for candidate in rivals)
    return tuple([candidate for candidate in rivals if candidate.standing == best][:2])


def _ways(folder: Path, table: Mapping[str, Any], camera: ImageFiles) -> list[dict[str, ImageFiles]]:
    """Return the assignments of files of one name to one camera or to two, the likeliest first."""
    is_stereo = "calibration" in table
    if "files" in table:
        with suppress(ForeignError):
            is_stereo = not camera_numbers(folder, Table("cameras.", table), of_projector=True).has_projector
    alone = {"left": camera}
    return [*in_halves(camera), *in_turns(camera), alone] if is_stereo else [alone, *in_turns(camera)]


def _candidates(folder: Path, cameras: Mapping[str, ImageFiles], pictures: _ReducedPictures) -> list[TriedSequence]:
    """Return the tried hypotheses about the images of the left camera, the best one of each order."""
    channel = _channel(cameras["left"].frames)
    files = {
        side: replace(camera, frames=tuple(of_channel(camera.frames, channel))) for side, camera in cameras.items()
    }
    images, _ = pictures.of(files["left"].frames, channel)
    places = _different(images) if channel == EACH else list(range(len(images)))
    looks = look_at(images[places])
    ranked = sorted(
        ((agreement(looks, hypothesis.shown), hypothesis) for hypothesis in _all_hypotheses(looks)),
        key=lambda pair: -pair[0],
    )
    best: dict[tuple[ShownImage, ...], TriedSequence] = {}
    # Appearance alone is often wrong about the finest stripes: try those that agree nearly as well, too.
    for score, sequence in ranked[:MOST_TRIED]:
        if score < ranked[0][0] - NEARLY and max((rival.rank for rival in best.values()), default=0.0) > SURE:
            break
        pictures.progress(f"trying {sequence.program}")
        with suppress(ForeignError):  # steps without a phase, stripes without numbers: no candidate
            axes = _conventions(sequence, images[places])
            order = [ShownImage(Shows.OTHER)] * len(images)
            for place, shown in zip(places, sequence.shown, strict=True):
                order[place] = shown
            size_px = [int(size) for size in GUESSED_PX]
            for axis in axes:
                size_px["xy".index(axis.name)] = round(axis.size_px)
            description = Description(
                folder.name, folder, files, tuple(order), channel, None, (size_px[0], size_px[1]), axes, Table("cameras.", {})
            )  # fmt: skip
            candidate = _with_explained_share(TriedSequence(sequence.program, images, description), places, pictures)
            if sequence.shown not in best or candidate.rank > best[sequence.shown].rank:
                best[sequence.shown] = candidate
    return list(best.values())


def _all_hypotheses(looks: Looks) -> Iterator[ProjectedSequence]:
    orders = set()
    for hypothesis in hypotheses(len(looks.mean)):
        if hypothesis.shown not in orders:
            orders.add(hypothesis.shown)
            yield hypothesis
    with suppress(ForeignError):
        yield ProjectedSequence(BY_LOOKS, shown=number_images(words_by_looks(looks), "images.order"))


def _channel(files: Sequence[Frame]) -> str:
    """Return the channel with the most contrast, or ``EACH`` if each channel is an image of its own.

    The first picture decides, or one in the middle.
    """
    for frame in (files[0], files[len(files) // 2]):
        image = FrameReader().raw(frame)
        if image.ndim < 3 or image.shape[2] < len(CHANNEL_NUMBER):
            return "grey"
        thinned = image[::4, ::4, :3]
        if not _alike(np.moveaxis(thinned, 2, 0)):
            return EACH
    spread = thinned.std(axis=(0, 1))
    return list(CHANNEL_NUMBER)[int(np.argmax(spread))] if spread.max() > COLOURED * spread.min() else "grey"


def _alike(channels: NDArray[Any]) -> bool:
    """Return whether ``channels`` (3, h, w) show one pattern.

    All channels reflect light of one colour alike, unless each was sent a pattern of its own.
    """
    flat = channels.reshape(len(channels), -1).astype(np.float64)
    return float(flat.std(axis=1).min()) < LEAST_SPREAD or float(np.corrcoef(flat).min()) >= LEAST_ALIKE


def _different(images: NDArray[Any]) -> list[int]:
    """Return the indices of the channels (n, h, w), three of each picture, that are images of their own.

    A grey picture has only its first.
    """
    return [
        k
        for first in range(0, len(images), 3)
        for k in range(first, first + (1 if _alike(images[first : first + 3]) else 3))
    ]


# ------------------------------------------------------------------------------------------------ conventions


def _conventions(sequence: ProjectedSequence, images: NDArray[Any]) -> tuple[AxisConvention, ...]:
    """Return the conventions by which ``images`` (n, h, w) are first read; tests correct them later.

    Raises ForeignError.
    """
    names = [name for name in "xy" if any(shown.axis == name for shown in sequence.shown)]
    axes = [_convention(name, sequence, images) for name in names]
    code_alone = [axis.stripe_px for axis in axes if not axis.periods_px]
    # Programs draw stripes of equal widths in both directions.
    return tuple(axis if axis.periods_px else replace(axis, stripe_px=min(code_alone)) for axis in axes)


def _convention(name: str, sequence: ProjectedSequence, images: NDArray[Any]) -> AxisConvention:
    size_px = GUESSED_PX["xy".index(name)]
    own_images = [shown for shown in sequence.shown if shown.axis == name]
    bits = sum(shown.shows is Shows.GRAY for shown in own_images)
    stripe_px = 0.0
    if bits:
        size_px = float(2 ** max(round(np.log2(size_px)), bits))
        stripe_px = max(size_px / 2**bits, 0.5)
    fields = {"size_px": size_px, "periods_px": (), "steps_deg": (), **sequence.conventions}
    fringes = [
        [
            k
            for k, shown in enumerate(sequence.shown)
            if shown.axis == name and shown.shows in FRINGES and shown.period == period
        ]
        for period in sorted({shown.period for shown in own_images if shown.shows in FRINGES})
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
    """Return the phase steps of images (n, h, w) of one period: equal ones where they fit.

    Raises ForeignError if no steps fit.
    """
    steps = equal_steps(len(images))
    if len(steps) < LEAST_STEPS:
        raise ForeignError(f"{len(images)} images give no phase")
    if len(steps) == LEAST_STEPS:
        return steps  # Three steps fit any images.
    stack = images[:, ::EVERY, ::EVERY].reshape(len(images), -1).astype(np.float64)
    swing = np.ptp(stack, axis=0)
    stack = stack[:, swing > 0.5 * float(np.quantile(swing, 0.9))]
    if misfit(stack, steps) >= MOST_MISFIT:
        steps = estimate_steps(stack)
        if misfit(stack, steps) > MOST_MISFIT:
            raise ForeignError(f"{len(images)} images are no steps of one sine")
    return steps


def _with_explained_share(candidate: TriedSequence, places: Sequence[int], pictures: _ReducedPictures) -> TriedSequence:
    """Return a candidate corrected by its tests, with the explained share of the images at ``places``.

    Raises ForeignError.
    """
    candidate, decoded = _fit(candidate, pictures)
    shares, weights = explained_shares(candidate.description, decoded["left"])
    used = [k for k, word in enumerate(candidate.words) if word != "-"]
    # Images without a role count as unexplained. Images that vary little have little weight: stripes finer than pixels
    # cannot be explained.
    total = float((shares * weights).sum() / max(weights.sum() + 0.25 * (len(places) - len(used)), 1e-9))
    by_image = np.full(len(candidate.images), np.nan)
    by_image[used] = shares
    return replace(candidate, explained=total, by_image=tuple(by_image.tolist()))


def _fit(candidate: TriedSequence, pictures: _ReducedPictures) -> tuple[TriedSequence, dict[str, DecodedCamera]]:
    """Return the candidate with the corrections of its tests, and its decoded cameras.

    Without camera numbers the left camera alone is decoded. Raises ForeignError.
    """
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
    """Return those of ``images`` (n, h, w) that belong to the sequence."""
    shown = description.order or ()
    used = [k for k, role in enumerate(shown) if role.shows is not Shows.OTHER]
    white = next(scale for scale in FULL_SCALES if float(images.max()) <= scale)
    return ImageSet(tuple(shown[k] for k in used), tuple(frames[k] for k in used), images[used], white)


def _with_instead(candidate: TriedSequence) -> TriedSequence:
    """Return the candidate with corrected conventions, or with the cameras exchanged."""
    description = candidate.description
    for assumption in candidate.tested:
        if assumption.outcome is not Outcome.WRONG:
            continue
        if assumption.subject == WHICH_IS_LEFT:
            description = replace(description, files=exchange_sides(description.files))
        for key, value in assumption.corrections.items():
            # Tests of one camera name the word of a direction alone; tests by rays name the direction, too.
            name, _, word = (key if "." in key else f"{assumption.subject.rpartition(': ')[2][0]}.{key}").partition(".")
            axis = description.axis(name)
            if axis is not None:
                description = description.with_axis(replace(axis, **{word: value}))
    return replace(candidate, description=description)


# ------------------------------------------------------------------------------------------- cameras, projector


def _on_rig(candidate: TriedSequence, table: Mapping[str, Any], pictures: _ReducedPictures) -> TriedSequence:
    """Return the candidate with the cameras of the folder, corrected by their rays."""
    described = replace(candidate.description, cameras=Table("cameras.", table))
    fitted: list[TriedSequence] = []
    try:
        left_px = pictures.of(described.files["left"].frames, described.channel)[1]
        for description in _on_projectors(described, left_px) if len(described.files) == 1 else [described]:
            fitted.append(_fit(replace(candidate, description=description), pictures)[0])
            if not fitted[-1].contradictions:
                break
    except ForeignError as error:
        return replace(candidate, description=described, notes=(str(error),))
    return min(fitted, key=lambda fit: fit.contradictions)


def _on_projectors(description: Description, left_px: tuple[int, int]) -> Iterator[Description]:
    """Yield the description with each possible size of the projector.

    The size is the one that the calibration states, else those that fit the projector's axis.
    """
    table = description.cameras
    stated_px = None
    if "files" in table.content:
        stated_px = camera_numbers(description.folder, table, of_projector=True).stated_px.get("right")
    sizes = [stated_px] if stated_px else []
    if not sizes:
        # Any size will do to find the projector's axis.
        right = read_rig(description, {"left": left_px, "right": description.projector_px}).rig.right
        width_px = 2.0 * right.lens.c_px[0] + 1.0
        nearest_px = min((width for width, _ in PROJECTORS_PX), key=lambda width: abs(width - width_px))
        sizes = [size for size in PROJECTORS_PX if size[0] == nearest_px]
    for size_px in sizes:
        axes = tuple(_of_size(axis, float(size_px["xy".index(axis.name)])) for axis in description.axes)
        yield replace(description, projector_px=size_px, axes=axes)


def _of_size(axis: AxisConvention, size_px: float) -> AxisConvention:
    """Return the convention of the same images on a pattern ``size_px`` long."""
    scale = size_px / axis.size_px
    if axis.bits:
        # Stripes beside fringes divide the pattern; those of a code alone are powers of two of the projector's px.
        exact_px = size_px / 2**axis.bits
        if not axis.periods_px or exact_px != round(exact_px):
            exact_px = max(2.0 ** (math.ceil(math.log2(size_px)) - axis.bits), 1.0)
        scale = exact_px / axis.stripe_px
    periods_px = axis.periods_px if axis.micro or axis.carriers else tuple(scale * period for period in axis.periods_px)
    stripe_px, offset_px = scale * axis.stripe_px, scale * axis.code_offset_px
    return replace(axis, size_px=size_px, periods_px=periods_px, stripe_px=stripe_px, code_offset_px=offset_px)
