"""Owns a first description of images that nobody has described: which files belong together, and what each of them shows.

What is looked at, of each pixel over the whole sequence: an image of a code is near the pixel's darkest or brightest value, a sine
is often between; stripes of X change along the rows and those of Y along the columns; how often they change tells a period from
another one, and the order of the bits. Then the guess is tested like any other description, and what fits instead is taken over.

Sizes cannot be seen: the projector's is a guess, which scales the pattern and moves no point of two cameras.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.calibration import file as calibration_file
from appliance.foreign.assumptions import MOST_MISFIT, Outcome, equal_steps, examine_axis, measured_steps, misfit
from appliance.foreign.camera import decode_camera
from appliance.foreign.cameras import numbers_in
from appliance.foreign.description import (
    LEAST_STEPS,
    MOST_PERIODS,
    MOST_STEPS,
    AxisConvention,
    Description,
    ImageFiles,
)
from appliance.foreign.files import CameraFiles, camera_files
from appliance.foreign.images import ImageSet, read_images
from appliance.foreign.order import numbered
from appliance.foreign.problem import ForeignError, Table

GUESSED_PX = (1024, 768)
LINES = 48
"""Lines across, and down, of which each image's changes are counted."""
LEAST_RANGE = 0.15
"""Least swing of a pixel that is asked, over that of the liveliest ones."""
BETWEEN = (0.2, 0.8)
SINE_BETWEEN = 0.2
"""Share of the pixels between a fifth and four fifths of their range from which on an image is a sine: 0.41 are expected of one, 0.03 of fine stripes."""
EVEN = 0.1
"""An image whose pixels are nearer to their ends than this, on an average, is bright or dark all over."""
OPPOSITE = -0.75
MOST_FRINGES = 256
ROUNDS = 4


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """Appearance of one image."""

    word: str
    changes: float
    """Changes from dark to bright or back, over all lines."""


def guess_description(folder: Path, beside: Path, progress: Callable[[str], None]) -> str:
    """Return the text of a description of the images below ``folder``, for a file in the folder ``beside``. Raises ForeignError."""
    cameras = camera_files(folder)
    progress("looking at the images")
    channel, images = _stack(cameras[0].files)
    seen = _looked_at(images)
    order = " ".join(_joined([one.word for one in seen]))
    axes = [axis for axis in (_axis(name, seen, images) for name in "xy") if axis is not None]
    if not axes:
        raise ForeignError(
            f"{folder}: none of {len(seen)} images looks like stripes ({order}); give a folder with a whole sequence"
        )
    words = _with_periods(seen, axes, images)
    size_px = (
        round(axes[0].size_px) if axes[0].name == "x" else GUESSED_PX[0],
        round(axes[-1].size_px) if axes[-1].name == "y" else GUESSED_PX[1],
    )
    # As if it were described: what the tests find instead is taken over.
    shown = numbered(words, "images.order")
    description = Description(
        folder.name,
        folder,
        {"left": ImageFiles(("*",))},
        shown,
        channel,
        None,
        size_px,
        tuple(axes),
        Table("cameras.", {}),
    )
    progress("testing what was guessed")
    fitted, notes = _fitted(description, read_images(cameras[0].files, shown, channel))
    return _text(fitted, cameras, beside, folder, " ".join(_joined(words)), notes)


def _stack(files: Sequence[Path]) -> tuple[str, NDArray[Any]]:
    """Return the channel with the most to see, and the images in it."""
    first = cv2.imdecode(np.fromfile(files[len(files) // 2], np.uint8), cv2.IMREAD_UNCHANGED)
    channel = "grey"
    if first is not None and first.ndim == 3:
        spread = [float(first[..., k].std()) for k in range(3)]
        if max(spread) > 1.05 * min(spread):
            channel = ("blue", "green", "red")[int(np.argmax(spread))]
    shown = numbered(["sine-x"] * len(files), "images")
    return channel, read_images(tuple(files), shown, channel).images


def _looked_at(images: NDArray[Any]) -> list[_Seen]:
    low, high = images.min(axis=0).astype(np.float32), images.max(axis=0).astype(np.float32)
    swing = high - low
    usable = swing > max(LEAST_RANGE * float(np.quantile(swing, 0.98)), 4.0)
    if np.count_nonzero(usable) < 1000:
        raise ForeignError(
            f"the images hardly differ: {np.count_nonzero(usable)} pixels change; give a folder with a whole sequence"
        )
    height, width = swing.shape
    across, down = slice(None, None, max(1, height // LINES)), slice(None, None, max(1, width // LINES))
    rows, columns = usable[across], usable.T[down]
    seen: list[_Seen] = []
    before: NDArray[np.float32] | None = None
    for image in images:
        share = (image.astype(np.float32) - low) / np.maximum(swing, np.float32(1.0))
        along_x, along_y = share[across], share.T[down]
        # Lines both ways: those of one way alone meet stripes of the other one at few places of a period.
        values = np.concatenate([along_x[rows], along_y[columns]])
        kind = _kind(values)
        if kind in ("bright", "dark"):
            seen.append(_Seen(kind, 0.0))
            before = None
            continue
        sides = _changes(along_x, rows) * height / LINES, _changes(along_y, columns) * width / LINES
        axis = "x" if _gradient(along_x, rows) >= _gradient(along_y, columns) else "y"
        centred = values - np.float32(0.5)
        inverse = (
            kind == "gray" and before is not None and seen[-1].word == f"gray-{axis}" and
            float(np.corrcoef(before, centred)[0, 1]) < OPPOSITE
        )  # fmt: skip
        seen.append(_Seen(f"{'~' if inverse else ''}{kind}-{axis}", sides[0 if axis == "x" else 1]))
        before = None if inverse else centred
    return _one_of_each(seen)


def _kind(values: NDArray[np.float32]) -> str:
    """Return what an image shows by its pixels' values (n,), 0 at their darkest and 1 at their brightest."""
    mean = float(values.mean())
    if mean > 1.0 - EVEN:
        return "bright"
    if mean < EVEN:
        return "dark"
    return "sine" if float(np.mean((values > BETWEEN[0]) & (values < BETWEEN[1]))) > SINE_BETWEEN else "gray"


def _one_of_each(seen: list[_Seen]) -> list[_Seen]:
    """Return what was seen with one bright and one dark image at most, and inverses everywhere or nowhere."""
    for kind in ("bright", "dark"):
        places = [k for k, one in enumerate(seen) if one.word == kind]
        for k in places[1:]:
            seen[k] = _Seen("-", 0.0)
    for axis in "xy":
        plain = sum(one.word == f"gray-{axis}" for one in seen)
        inverse = sum(one.word == f"~gray-{axis}" for one in seen)
        if inverse and inverse != plain:
            seen = [
                _Seen(one.word.removeprefix("~"), one.changes) if one.word == f"~gray-{axis}" else one for one in seen
            ]
    return seen


def _changes(share: NDArray[np.float32], usable: NDArray[np.bool_]) -> float:
    """Return how often lines (n, length) cross the middle, by pixels that are clearly above or below it."""
    clear = usable & (np.abs(share - np.float32(0.5)) > np.float32(0.15))
    count = 0
    for line, known in zip(share > np.float32(0.5), clear, strict=True):
        count += int(np.count_nonzero(np.diff(line[known].astype(np.int8))))
    return float(count)


def _gradient(share: NDArray[np.float32], usable: NDArray[np.bool_]) -> float:
    step = np.abs(np.diff(share, axis=1))
    both = usable[:, 1:] & usable[:, :-1]
    return float(step[both].mean()) if both.any() else 0.0


def _axis(name: str, seen: list[_Seen], images: NDArray[Any]) -> AxisConvention | None:
    """Return the convention of a direction as far as it can be seen."""
    gray = [one for one in seen if one.word == f"gray-{name}"]
    groups = _groups(name, seen, images)
    size_px = float(GUESSED_PX["xy".index(name)])
    if not gray and not groups:
        return None
    stripe_px, fine_first = 0.0, False
    if gray:
        fine_first = gray[0].changes > gray[-1].changes
        # 2ⁿ stripes cover the pattern: how many of them the projector really has cannot be seen.
        size_px = float(2 ** round(np.log2(size_px)))
        stripe_px = max(size_px / 2 ** len(gray), 0.5)
    finest = max((one.changes for one in gray), default=0.0)
    periods_px = _periods([np.mean([seen[k].changes for k in group]) for group in groups], finest, stripe_px, size_px)
    steps_deg = tuple(_steps(images[group]) for group in groups)
    inverses = any(one.word == f"~gray-{name}" for one in seen)
    return AxisConvention(
        name,
        size_px,
        periods_px,
        steps_deg,
        bits=len(gray),
        inverses=inverses,
        stripe_px=stripe_px,
        fine_first=fine_first,
    )


def _groups(name: str, seen: list[_Seen], images: NDArray[Any]) -> list[list[int]]:
    """Return the numbers of the sine images of each period: as many steps as fit a sine, one period after the other."""
    sines = [k for k, one in enumerate(seen) if one.word == f"sine-{name}"]
    count = len(sines)
    for steps in range(min(count, MOST_STEPS), LEAST_STEPS, -1):
        if count % steps:
            continue
        groups = [sines[k : k + steps] for k in range(0, count, steps)]
        if all(misfit(_strong(images[group]), equal_steps(steps)) < MOST_MISFIT for group in groups):
            return groups
    if count and count % LEAST_STEPS == 0 and count // LEAST_STEPS <= MOST_PERIODS:
        # Three steps fit anything; steps in an order of their own do not fit three by three.
        found = measured_steps(_strong(images[sines])) if count > LEAST_STEPS else ()
        if count == LEAST_STEPS or misfit(_strong(images[sines]), found) > MOST_MISFIT:
            return [sines[k : k + LEAST_STEPS] for k in range(0, count, LEAST_STEPS)]
    return [sines] if count >= LEAST_STEPS else []


def _strong(images: NDArray[Any]) -> NDArray[np.float64]:
    """Return the pixels (n, pixels) of images that change most."""
    stack = images[:, ::5, ::5].reshape(len(images), -1).astype(np.float64)
    swing = stack.max(axis=0) - stack.min(axis=0)
    return np.asarray(stack[:, swing > 0.5 * float(np.quantile(swing, 0.9))])


def _periods(changes: list[Any], finest: float, stripe_px: float, size_px: float) -> tuple[float, ...]:
    if not changes:
        return ()
    if stripe_px:
        # The finest image of a Gray code changes every two stripes, and a sine every half period.
        stripes = [0.25 * float(one) / max(finest, 1e-6) for one in changes]
        return tuple(stripe_px / min((1.0, 0.5, 0.25), key=lambda share: abs(np.log(one / share))) for one in stripes)
    if len(changes) == 1:
        return (size_px,)
    # Whole numbers of fringes across the pattern in the proportion that was counted.
    ratios = np.asarray(changes, np.float64) / max(changes)
    counts = np.arange(len(changes), MOST_FRINGES)
    misfit = [float(np.abs(n * ratios - np.rint(n * ratios)).max()) + 1e-3 * n for n in counts]
    fringes = np.maximum(np.rint(counts[int(np.argmin(misfit))] * ratios), 1.0)
    if len(set(fringes.tolist())) != len(changes):
        fringes = np.arange(len(changes), 0, -1.0)
    return tuple(float(size_px / one) for one in fringes)


def _steps(images: NDArray[Any]) -> tuple[float, ...]:
    count = len(images)
    equal = equal_steps(count)
    stack = _strong(images)
    return equal if count == LEAST_STEPS or misfit(stack, equal) < MOST_MISFIT else measured_steps(stack)


def _with_periods(seen: list[_Seen], axes: list[AxisConvention], images: NDArray[Any]) -> list[str]:
    words = [one.word for one in seen]
    for axis in axes:
        groups = _groups(axis.name, seen, images)
        for period, group in enumerate(groups):
            for k in group:
                words[k] = f"sine-{axis.name}{period + 1 if period else ''}"
        if not groups:
            words = ["-" if word == f"sine-{axis.name}" else word for word in words]
    known = {axis.name for axis in axes}
    return [word if word[-1] not in "xy" or word[-1] in known else "-" for word in words]


def _fitted(description: Description, images: ImageSet) -> tuple[Description, list[str]]:
    """Return the description with what fits its images instead of what was guessed, and what could not be told."""
    notes: dict[str, str] = {}
    for _ in range(ROUNDS):
        camera = decode_camera(images, description)
        changed = False
        notes.clear()
        for axis in description.axes:
            for one in examine_axis(camera, axis):
                if one.outcome is Outcome.WRONG and one.instead:
                    description = description.with_axis(replace(description.axis(axis.name) or axis, **one.instead))
                    changed = True
                elif one.outcome is not Outcome.FITS:
                    notes[one.about] = one.text
        if not changed:
            break
    return description, [f"{about}: {text}" for about, text in notes.items()]


# ------------------------------------------------------------------------------------------------- text


def _joined(words: Sequence[str]) -> list[str]:
    """Return words with repetitions written as such: ``gray-x*6``, ``(gray-x ~gray-x)*6``."""
    said: list[str] = []
    k = 0
    while k < len(words):
        for length in (1, 2):
            unit, count = words[k : k + length], 1
            while list(words[k + count * length : k + (count + 1) * length]) == list(unit):
                count += 1
            if count > 1 and (length == 1 or len(set(unit)) == length):
                said.append(f"{unit[0] if length == 1 else '(' + ' '.join(unit) + ')'}*{count}")
                k += count * length
                break
        else:
            said.append(words[k])
            k += 1
    return said


def _text(
    description: Description,
    cameras: Sequence[CameraFiles],
    beside: Path,
    folder: Path,
    order: str,
    notes: Sequence[str],
) -> str:
    def name(pattern: str) -> str:
        path = (folder / pattern).absolute()
        own = beside.absolute()
        return str(path.relative_to(own)) if path.is_relative_to(own) else str(path)

    said = ["# Guessed by looking at the images; read it before it is believed. docs/foreign.md explains every word."]
    said += [f"# {note}" for note in notes]
    said += ["", "[images]", *(f'{one.side} = "{name(one.pattern)}"' for one in cameras), f'order = "{order}"']
    said += [f'channel = "{description.channel}"'] if description.channel != "grey" else []
    if len(cameras) == 1:
        said.append("# Of one camera only: the projector must be calibrated, and takes the right camera's place.")
    said += ["", "[projector]  # cannot be seen: of two cameras, no point depends on it"]
    said += [f"width_px = {description.projector_px[0]}", f"height_px = {description.projector_px[1]}"]
    for axis in description.axes:
        said += ["", *_axis_text(axis)]
    said += ["", "[cameras]", *_cameras_text(folder, name), "", "# [water]", "# index = 1.335", ""]
    return "\n".join(said)


def _axis_text(axis: AxisConvention) -> list[str]:
    said = [f"[{axis.name}]"]
    if axis.periods_px:
        values = [f"{one:.6g}" for one in axis.periods_px]
        said.append(f"period_px = {values[0] if len(values) == 1 else '[' + ', '.join(values) + ']'}")
        steps = axis.steps_deg[0]
        equal = steps == equal_steps(len(steps))
        said.append(f"steps = {len(steps)}" if equal else f"steps_deg = [{', '.join(f'{one:g}' for one in steps)}]")
        said += ['sign = "-"'] if axis.sign < 0 else []
        said += [f"start_deg = {axis.start_deg:g}"] if axis.start_deg else []
    if axis.bits:
        said.append(f"stripe_px = {axis.stripe_px:g}")
        said += [f"code_offset_px = {axis.code_offset_px:g}"] if axis.code_offset_px else []
        said += ['code = "binary"'] if axis.plain_binary else []
        said += ['code_order = "fine-first"'] if axis.fine_first else []
        said += ["code_inverted = true"] if axis.inverted else []
    return said


def _cameras_text(folder: Path, name: Callable[[str], str]) -> list[str]:
    """Return what the folder has about cameras: a calibration of ours, else files with matrices."""
    files = []
    for path in sorted(folder.rglob("*")):
        if not path.is_file() or path.suffix.lower() not in (".yml", ".yaml", ".xml", ".json", ".npz"):
            continue
        relative = str(path.relative_to(folder))
        if path.suffix == ".json":
            try:
                calibration_file.load(path)
            except calibration_file.CalibrationError:
                pass
            else:
                return [f'calibration = "{name(relative)}"']
        try:
            if any(np.size(value) == 9 for value in numbers_in(path).values()):
                files.append(relative)
        except ForeignError:
            continue
    if files:
        return [
            f"files = [{', '.join(chr(34) + name(one) + chr(34) for one in files)}]",
            'unit = "mm"  # of the translation',
        ]
    return ['# files = ["stereo.yml"]  # OpenCV: M1 D1 M2 D2 R T; nothing was found here', 'unit = "mm"']
