"""Owns the guess at images that nobody has described: hypotheses are tried on reduced images until one of them stands out.

Hypotheses are data: the sequences of known programs (``sequences``), and what each image looks like by itself. Looks choose a few of
them; each of these is decoded, what its tests find instead is taken over, and it counts how much of the images it explains
(``expectation``). Of a rig whose numbers are known, rays decide which camera is which and where the pattern lies.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.foreign.appearance import Looks, agreement, look_at, words_by_looks
from appliance.foreign.arrangement import WHICH_IS_LEFT
from appliance.foreign.assumptions import (
    MOST_MISFIT,
    ExaminedAssumption,
    Outcome,
    equal_steps,
    examine_axis,
    examine_references,
    measured_steps,
    misfit,
)
from appliance.foreign.camera import DecodedCamera, decode_camera
from appliance.foreign.camera_files import camera_numbers, cameras_in
from appliance.foreign.cameras import read_rig
from appliance.foreign.description import EACH, LEAST_STEPS, AxisConvention, Description, ImageFiles
from appliance.foreign.expectation import explained_shares
from appliance.foreign.files import CameraFiles, camera_files, in_halves, taken_in_turns
from appliance.foreign.frames import Frame, FrameReader
from appliance.foreign.images import CHANNEL_NUMBER, FULL_SCALES, ImageSet, Pictures, of_channel
from appliance.foreign.order import FRINGES, ShownImage, Shows, numbered
from appliance.foreign.periods import periods_by_phases
from appliance.foreign.problem import ForeignError, Table
from appliance.foreign.reading import examine
from appliance.foreign.sequences import Hypothesis, hypotheses
from appliance.foreign.writing import joined

MOST_PIXELS = 400_000
"""Pixels of an image on which hypotheses are tried; larger ones are reduced."""
BY_LOOKS = "what each image looks like"
MOST_TRIED = 10
SURE, NEARLY = 0.9, 0.3
"""Share explained from which on no hypotheses are tried whose looks agree less by the second number than the best one's."""
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
LEAST_ALIKE = 0.5
"""Least correlation of the channels of a picture that shows one pattern."""
PROJECTORS_PX = (
    (608, 684), (640, 480), (640, 360), (800, 600), (854, 480), (848, 480), (912, 1140), (1024, 768), (1280, 800), (1280, 720), (1280, 1024),
    (1366, 768), (1400, 1050), (1440, 900), (1600, 1200), (1824, 1140), (1920, 1080), (1920, 1200), (2560, 1600), (3840, 2160),
)  # fmt: skip
"""Sizes that projectors have; of equal widths the commonest one first."""
WIDTHS = (1.0, 0.5, 2.0)
"""Stripes of a code in periods of the fringes beside it."""


@dataclass(frozen=True, slots=True, eq=False)
class TriedSequence:
    """A hypothesis that was tried on the images of a folder."""

    program: str
    cameras: tuple[CameraFiles, ...]
    description: Description
    tested: tuple[ExaminedAssumption, ...]
    explained: float
    """Share of the images' variation that it explains."""
    by_image: tuple[float, ...]
    """The same for each image."""
    notes: tuple[str, ...] = ()
    """Remarks to be read before the description."""

    @property
    def rank(self) -> float:
        """The share, less what is taken off for each contradiction."""
        return self.explained - PER_WRONG * self.contradictions

    @property
    def standing(self) -> tuple[int, int, bool]:
        """Order of sequences that explain as much: by contradictions, by what could have been one, and by whether it is known."""
        return -self.contradictions - bool(self.notes), self.evidence, self.program != BY_LOOKS

    @property
    def contradictions(self) -> int:
        """Number of words that the images contradict."""
        return self._count(Outcome.WRONG)

    @property
    def evidence(self) -> int:
        """Number of words that could have been contradicted and were not, less those that nothing tells."""
        return self._count(Outcome.FITS) - self._count(Outcome.UNCHECKED)

    def _count(self, outcome: Outcome) -> int:
        return sum(one.outcome is outcome for one in self.tested)


def guess_sequence(folder: Path, progress: Callable[[str], None]) -> tuple[TriedSequence, ...]:
    """Return what the images below ``folder`` show: one sequence, or the best two where none stands out.

    Raises ForeignError where nothing is known that they could show.
    """
    named = camera_files(folder)
    found: list[TriedSequence] = []
    refused: ForeignError | None = None
    table = cameras_in(folder)
    for cameras in [named] if len(named) == 2 else _ways(folder, table, named[0]):
        if found and max(one.rank for one in found) >= GOOD:
            break  # another way to share the images only where this one makes no sense
        try:
            found += _candidates(folder, cameras, progress)
        except ForeignError as error:
            refused = refused or error
    found.sort(key=lambda one: -one.rank)
    if not found or found[0].rank < FAIR:
        raise refused or _unknown(folder, found)
    left = max(1.0 - found[0].rank, LEAST_LEFT)
    # Several readings may explain as much: a sine of few steps and a code of fine stripes look alike.
    rivals = [one for one in found if 1.0 - one.rank < APART * left][:MOST_RIVALS]
    # Rays know what no image tells: which camera is left, and which way fringes run.
    if table:
        rivals = [_on_rig(one, table, progress) for one in rivals]
    # Of what explains as much, that which more tests could have contradicted.
    best = max(one.standing for one in rivals)
    return tuple([one for one in rivals if one.standing == best][:2])


def _ways(folder: Path, table: Mapping[str, Any], camera: CameraFiles) -> list[list[CameraFiles]]:
    """Return the ways in which files of one name may be those of one camera, or of two, the likeliest first."""
    shared = [*in_halves(camera), *taken_in_turns(camera)]
    two = "calibration" in table
    if "files" in table:
        with suppress(ForeignError):
            two = not camera_numbers(folder, Table("cameras.", table), of_projector=True).has_projector
    return [*shared, [camera]] if two else [[camera], *taken_in_turns(camera)]


def _unknown(folder: Path, found: Sequence[TriedSequence]) -> ForeignError:
    told = ""
    if found:
        words = joined([one.word for one in found[0].description.order or ()])
        told = f"; the nearest, {words}, explains {100 * found[0].explained:.0f} % of them"
    return ForeignError(
        f"{folder}: its images are no sequence that is known{told}; name what each shows in a description (docs/foreign.md)"
    )


def _candidates(folder: Path, cameras: Sequence[CameraFiles], progress: Callable[[str], None]) -> list[TriedSequence]:
    channel = _channel(cameras[0].files)
    if channel == EACH:
        cameras = [replace(one, files=tuple(of_channel(one.files, channel))) for one in cameras]
    images = reduced_images(cameras[0], channel, progress)
    looks = look_at(images)
    agreed = [(agreement(looks, one.shown), one) for one in _all_hypotheses(looks)]
    agreed.sort(key=lambda two: -two[0])
    tried: list[TriedSequence] = []
    # Looks alone are often wrong about the finest stripes: what looks nearly as well is tried, too.
    for agrees, hypothesis in agreed[:MOST_TRIED]:
        if agrees < agreed[0][0] - NEARLY and max((one.rank for one in tried), default=0.0) > SURE:
            break
        progress(f"trying {hypothesis.program}")
        with suppress(ForeignError):  # steps that tell no phase, stripes that number nothing: no candidate
            for axes in _conventions(hypothesis, images):
                tried.append(_tried(folder, cameras, channel, hypothesis, axes, images))
                if not tried[-1].contradictions or tried[-1].explained < FAIR:
                    break
    best: dict[tuple[ShownImage, ...], TriedSequence] = {}
    for one in tried:
        order = one.description.order or ()
        if order not in best or one.rank > best[order].rank:
            best[order] = one
    return list(best.values())


def _all_hypotheses(looks: Looks) -> Iterator[Hypothesis]:
    count = len(looks.mean)
    seen = set()
    for one in hypotheses(count):
        if one.shown not in seen:
            seen.add(one.shown)
            yield one
    with suppress(ForeignError):
        yield Hypothesis(BY_LOOKS, numbered(words_by_looks(looks), "images.order"))


def reduced_images(camera: CameraFiles, channel: str, progress: Callable[[str], None]) -> NDArray[Any]:
    """Return the images (n, h, w) of one camera, reduced by whole numbers to ``MOST_PIXELS``: each pixel is a mean."""
    pictures = Pictures.of(camera.files, channel)
    height_px, width_px = pictures.shape[1:]
    factor = math.ceil(math.sqrt(height_px * width_px / MOST_PIXELS))
    small_px = width_px // factor, height_px // factor
    found = []
    for k in range(len(pictures)):
        if k % 8 == 0:
            progress(f"reading {k + 1} of {len(pictures)}")
        whole = pictures[k][: small_px[1] * factor, : small_px[0] * factor]
        found.append(whole if factor == 1 else cv2.resize(whole, small_px, interpolation=cv2.INTER_AREA))
    return np.stack(found)


def _channel(files: Sequence[Frame]) -> str:
    image = FrameReader().raw(files[len(files) // 2])
    if image.ndim < 3 or image.shape[2] < len(CHANNEL_NUMBER):
        return "grey"
    spread = [float(image[::4, ::4, k].std()) for k in range(3)]
    few = image[::4, ::4, :3].reshape(-1, 3)
    if float(np.corrcoef(few.T.astype(np.float64)).min()) < LEAST_ALIKE:
        return EACH  # Light of one colour is reflected by all channels alike, but for what each has been sent.
    return ("blue", "green", "red")[int(np.argmax(spread))] if max(spread) > COLOURED * min(spread) else "grey"


# ------------------------------------------------------------------------------------------------ conventions


def _conventions(hypothesis: Hypothesis, images: NDArray[Any]) -> Iterator[tuple[AxisConvention, ...]]:
    """Yield the conventions by which the images of a hypothesis may be read; what tests find instead need not be among them."""
    shown = hypothesis.shown
    names = [name for name in "xy" if any(one.axis == name for one in shown)]
    has_both = any(one.shows is Shows.GRAY for one in shown) and any(one.shows in FRINGES for one in shown)
    for width in WIDTHS if has_both else (1.0,):
        axes = [_convention(name, hypothesis, images, width) for name in names]
        code_alone = [axis.stripe_px for axis in axes if not axis.periods_px]
        # Programs draw stripes of equal widths in both directions.
        yield tuple(axis if axis.periods_px else replace(axis, stripe_px=min(code_alone)) for axis in axes)


def _convention(name: str, hypothesis: Hypothesis, images: NDArray[Any], width: float) -> AxisConvention:
    mine = [one for one in hypothesis.shown if one.axis == name]
    size_px = GUESSED_PX["xy".index(name)]
    bits = sum(one.shows is Shows.GRAY for one in mine)
    stripe_px = 0.0
    if bits:
        size_px = float(2 ** max(round(np.log2(size_px)), bits))
        stripe_px = max(size_px / 2**bits, 0.5)
    groups = [
        [
            k
            for k, one in enumerate(hypothesis.shown)
            if one.axis == name and one.shows in FRINGES and one.period == period
        ]
        for period in sorted({one.period for one in mine if one.shows in FRINGES})
    ]
    fields: dict[str, Any] = dict(hypothesis.conventions)
    size_px = fields.pop("size_px", size_px)
    if groups and "periods_px" not in fields:
        fields["steps_deg"] = tuple(_steps(images[group]) for group in groups)
        if not bits or len(groups) > 1:
            fields["periods_px"] = periods_by_phases(
                [images[group] for group in groups], fields["steps_deg"], name, size_px
            )
            stripe_px = max(fields["periods_px"]) * width if bits else 0.0
        else:
            fields["periods_px"] = (stripe_px / width,)
    axis = AxisConvention(
        name, size_px, fields.pop("periods_px", ()), fields.pop("steps_deg", ()), bits=bits, stripe_px=stripe_px,
    )  # fmt: skip
    return replace(axis, **fields)


def _steps(images: NDArray[Any]) -> tuple[float, ...]:
    """Return the steps of images (n, h, w) of one period: equal ones where they fit. Raises ForeignError where no steps do."""
    equal = equal_steps(len(images))
    if len(equal) < LEAST_STEPS:
        raise ForeignError(f"{len(images)} images tell no phase")
    if len(equal) == LEAST_STEPS:
        return equal  # These fit anything.
    stack = images[:, ::EVERY, ::EVERY].reshape(len(images), -1).astype(np.float64)
    swing = np.ptp(stack, axis=0)
    stack = stack[:, swing > 0.5 * float(np.quantile(swing, 0.9))]
    steps = equal if misfit(stack, equal) < MOST_MISFIT else measured_steps(stack)
    if misfit(stack, steps) > MOST_MISFIT:
        raise ForeignError(f"{len(images)} images are no steps of one sine")
    return steps


def _tried(
    folder: Path,
    cameras: Sequence[CameraFiles],
    channel: str,
    hypothesis: Hypothesis,
    axes: tuple[AxisConvention, ...],
    images: NDArray[Any],
) -> TriedSequence:
    """Return a hypothesis with what fits its images in place of what was supposed. Raises ForeignError."""
    size_px = [int(GUESSED_PX[0]), int(GUESSED_PX[1])]
    for axis in axes:
        size_px["xy".index(axis.name)] = round(axis.size_px)
    description = Description(
        folder.name,
        folder,
        files_of(cameras),
        hypothesis.shown,
        channel,
        None,
        (size_px[0], size_px[1]),
        axes,
        Table("cameras.", {}),
    )
    seen = _image_set(cameras[0], hypothesis.shown, images)
    description, camera, tested = fitted(description, seen)
    shares, weights = explained_shares(description, camera)
    # What no role explains counts as not explained.
    kept = [k for k, one in enumerate(hypothesis.shown) if one.shows is not Shows.OTHER]
    unexplained = 0.25 * (len(images) - len(kept))
    # Images that vary little weigh little: of stripes finer than pixels nothing can be explained.
    total = float((shares * weights).sum() / max(weights.sum() + unexplained, 1e-9))
    by_image = np.full(len(images), np.nan)
    by_image[kept] = shares
    return TriedSequence(
        hypothesis.program, tuple(cameras), description, tuple(tested), total, tuple(by_image.tolist())
    )


def fitted(description: Description, images: ImageSet) -> tuple[Description, DecodedCamera, list[ExaminedAssumption]]:
    """Return the description with what fits its images instead, the camera so decoded, and what its tests say then. Raises ForeignError."""
    for _ in range(ROUNDS):
        camera = decode_camera(images, description)
        asked = [axis for axis in description.axes if not axis.micro and not axis.carriers]
        tested = [*examine_references(camera), *(one for axis in asked for one in examine_axis(camera, axis))]
        changed = description
        for axis in description.axes:
            for one in tested:
                if one.outcome is Outcome.WRONG and one.instead and one.about.startswith(f"{axis.name}."):
                    changed = changed.with_axis(replace(changed.axis(axis.name) or axis, **one.instead))
        if changed == description:
            break
        description = changed
    return description, camera, tested


def files_of(cameras: Sequence[CameraFiles]) -> dict[str, ImageFiles]:
    """Return the cameras' files in the words of a description."""
    return {one.side: ImageFiles((one.pattern,), sides=one.sides) for one in cameras}


# ------------------------------------------------------------------------------------------- cameras, projector


def _on_rig(candidate: TriedSequence, table: Mapping[str, Any], progress: Callable[[str], None]) -> TriedSequence:
    """Return the candidate with the cameras of the folder, and with what their rays make of it."""
    progress("trying the cameras")
    said = replace(candidate.description, cameras=Table("cameras.", table))
    found: list[TriedSequence] = []
    try:
        sizes_px = {one.files: _size_px(one, said) for one in candidate.cameras}
        images = {
            one.files: _image_set(one, said.order or (), reduced_images(one, said.channel, progress))
            for one in candidate.cameras
        }
        left_px = sizes_px[candidate.cameras[0].files]
        for description in _on_projectors(said, left_px) if len(candidate.cameras) == 1 else [said]:
            found.append(_seen_by_rays(replace(candidate, description=description), images, sizes_px))
            if not found[-1].contradictions:
                break
    except ForeignError as error:
        return replace(candidate, description=said, notes=(str(error),))
    return min(found, key=lambda one: one.contradictions)


def _seen_by_rays(
    candidate: TriedSequence,
    images: Mapping[tuple[Frame, ...], ImageSet],
    sizes_px: Mapping[tuple[Frame, ...], tuple[int, int]],
) -> TriedSequence:
    """Return the candidate with what its rays say, and what fits in place of what they contradict. Raises ForeignError.

    ``images`` are the reduced ones by files, ``sizes_px`` (width, height) before that.
    """
    for _ in range(ROUNDS):
        description = candidate.description
        decoded = {one.side: decode_camera(images[one.files], description) for one in candidate.cameras}
        own_px = {one.side: sizes_px[one.files] for one in candidate.cameras}
        tested = examine(description, decoded, read_rig(description, {"right": description.projector_px, **own_px}))
        candidate = replace(candidate, tested=tested)
        wrong = next((one for one in tested if one.outcome is Outcome.WRONG), None)
        if wrong is None:
            break
        if wrong.about == WHICH_IS_LEFT:
            cameras = tuple(
                replace(one, side=side) for one, side in zip(candidate.cameras, ("right", "left"), strict=True)
            )[::-1]
            candidate = replace(candidate, cameras=cameras, description=replace(description, files=files_of(cameras)))
        elif wrong.instead:
            candidate = replace(candidate, description=_with_instead(description, wrong.instead))
        else:
            break
    return candidate


def _size_px(camera: CameraFiles, description: Description) -> tuple[int, int]:
    height_px, width_px = Pictures.of(camera.files, description.channel).shape[1:]
    return width_px, height_px


def _image_set(camera: CameraFiles, shown: Sequence[ShownImage], images: NDArray[Any]) -> ImageSet:
    """Return those of ``images`` (n, h, w) that show something of the sequence."""
    kept = [k for k, one in enumerate(shown) if one.shows is not Shows.OTHER]
    white = next(one for one in FULL_SCALES if float(images.max()) <= one)
    return ImageSet(tuple(shown[k] for k in kept), tuple(camera.files[k] for k in kept), images[kept], white)


def _with_instead(description: Description, instead: Mapping[str, Any]) -> Description:
    """Return the description with fields ``x.sign`` … of its conventions."""
    for key, value in instead.items():
        name, _, word = key.rpartition(".")
        axis = description.axis(name)
        if axis is not None:
            description = description.with_axis(replace(axis, **{word: value}))
    return description


def _on_projectors(description: Description, left_px: tuple[int, int]) -> Iterator[Description]:
    """Yield the description with each size that the projector may have: the one its calibration states, else those by its axis."""
    table = description.cameras
    stated_px = None
    if "files" in table.content:
        stated_px = camera_numbers(description.folder, table, of_projector=True).stated_px.get("right")
    if stated_px is None:
        # Any size will do to ask where the projector's axis is.
        right = read_rig(description, {"left": left_px, "right": description.projector_px}).rig.right
        width_px = 2.0 * right.lens.c_px[0] + 1.0
        nearest_px = min((width for width, _ in PROJECTORS_PX), key=lambda width: abs(width - width_px))
        sizes = [size for size in PROJECTORS_PX if size[0] == nearest_px]
    else:
        sizes = [stated_px]
    for size_px in sizes:
        axes = []
        for axis in description.axes:
            size = float(size_px["xy".index(axis.name)])
            scale = size / axis.size_px
            if axis.bits:
                # Beside fringes stripes divide the pattern; of a code alone they are whole powers of two of the projector's px.
                whole_px = size / 2**axis.bits
                if not axis.periods_px or whole_px != round(whole_px):
                    whole_px = max(2.0 ** (math.ceil(math.log2(size)) - axis.bits), 1.0)
                scale = whole_px / axis.stripe_px
            periods_px = (
                axis.periods_px if axis.micro or axis.carriers else tuple(scale * one for one in axis.periods_px)
            )
            axes.append(
                replace(
                    axis,
                    size_px=size,
                    periods_px=periods_px,
                    stripe_px=scale * axis.stripe_px,
                    code_offset_px=scale * axis.code_offset_px,
                )
            )
        yield replace(description, projector_px=size_px, axes=tuple(axes))
        if not any(axis.bits for axis in axes):
            # Fringes alone run either way; mirrored in one direction, cameras would see a surface from behind.
            yield replace(
                description, projector_px=size_px, axes=tuple(replace(axis, sign=-axis.sign) for axis in axes)
            )
