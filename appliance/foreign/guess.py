"""Owns a first description of images that nobody has described: which files belong together, and what each of them shows.

What each image looks like is ``appearance``'s; how often its stripes change tells a period from another one, and the order of the bits.
Then the guess is tested like any other description, and what fits instead is taken over.

Sizes cannot be seen: the projector's is a guess, which scales the pattern and moves no point of two cameras. Of one camera it is the
size whose middle is nearest to the projector's principal point.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.calibration import file as calibration_file
from appliance.foreign.appearance import Seen, looked_at
from appliance.foreign.arrangement import examine_arrangement
from appliance.foreign.assumptions import MOST_MISFIT, Outcome, equal_steps, examine_axis, measured_steps, misfit
from appliance.foreign.camera import decode_camera
from appliance.foreign.camera_files import SUFFIXES as CAMERA_SUFFIXES
from appliance.foreign.camera_files import numbers_from_files, numbers_in
from appliance.foreign.cameras import read_rig
from appliance.foreign.description import (
    LEAST_STEPS,
    MOST_PERIODS,
    MOST_STEPS,
    AxisConvention,
    Description,
    ImageFiles,
)
from appliance.foreign.files import CameraFiles, camera_files, taken_in_turns
from appliance.foreign.frames import Frame, raw_images
from appliance.foreign.images import CHANNEL_NUMBER, ImageSet, read_images
from appliance.foreign.order import numbered
from appliance.foreign.periods import periods_by_phases
from appliance.foreign.problem import ForeignError, Table

GUESSED_PX = (1024, 768)
ROUNDS = 4
MOST_FINER = 6
"""A code's finest stripes are up to 2 to this power finer than fringes beside it."""
PROJECTORS_PX = (
    (608, 684), (640, 480), (640, 360), (800, 600), (854, 480), (848, 480), (912, 1140), (1024, 768), (1280, 800), (1280, 720), (1280, 1024),
    (1366, 768), (1400, 1050), (1440, 900), (1600, 1200), (1920, 1080), (1920, 1200), (2560, 1600), (3840, 2160),
)  # fmt: skip
"""Sizes that projectors have; of equal widths the commonest one first."""
MATRICES, SINGLES = (9, 12), (3, 4, 5, 8, 9, 12, 14)
"""Numbers that a file of cameras has somewhere; and those of one with a single matrix or vector."""
SINGLE_SUFFIXES = (".npy", ".txt", ".csv")
METRES_BELOW = 3.0
"""A translation shorter than this is in metres."""


def guess_description(folder: Path, beside: Path, progress: Callable[[str], None]) -> str:
    """Return the text of a description of the images below ``folder``, for a file in the folder ``beside``. Raises ForeignError."""
    named = camera_files(folder)
    best: _Guessed | None = None
    refused: ForeignError | None = None
    for cameras in [named] if len(named) == 2 else [named, *taken_in_turns(named[0])]:
        try:
            guessed = _guessed(folder, cameras, beside, progress)
        except ForeignError as error:
            refused = refused or error
            continue
        if best is None or guessed.wrong < best.wrong:
            best = guessed
        if not guessed.wrong:
            break
    if best is None:
        assert refused is not None
        raise refused
    return best.text


@dataclass(frozen=True, slots=True)
class _Guessed:
    """A description of one way to share the files among cameras."""

    text: str
    wrong: int
    """Number of assumptions that the images contradict whatever is said."""


def _guessed(folder: Path, cameras: Sequence[CameraFiles], beside: Path, progress: Callable[[str], None]) -> _Guessed:
    progress("looking at the images")
    channel, images = _stack(cameras[0].files)
    seen = looked_at(_side_by_side(images, cameras, channel))
    order = " ".join(_joined([one.word for one in seen]))
    axes = [axis for axis in (_axis(name, seen, images) for name in "xy") if axis is not None]
    if not axes:
        raise ForeignError(
            f"{folder}: none of {len(seen)} images looks like stripes ({order}); give a folder with a whole sequence"
        )
    words = _with_periods(seen, axes, images)
    rig_table = _cameras(folder)
    codes = [axis.stripe_px for axis in axes if not axis.periods_px]
    # Programs draw stripes of equal widths in both directions.
    axes = [axis if axis.periods_px else replace(axis, stripe_px=min(codes)) for axis in axes]
    sizes_px = _projectors_px(folder, rig_table) if len(cameras) == 1 else ()
    if sizes_px:
        axes = _sized(axes, sizes_px[0])
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
        Table("cameras.", rig_table),
    )
    progress("testing what was guessed")
    left = read_images(cameras[0].files, shown, channel)
    fitted, notes, wrong = _fitted(description, left)
    if len(cameras) == 1 and rig_table:
        fitted, more = _on_projector(fitted, left, sizes_px)
        notes += more
        wrong += any(f": {Outcome.WRONG.value}: " in one for one in more)
    return _Guessed(_text(fitted, cameras, beside, folder, " ".join(_joined(words)), notes), wrong)


def _stack(files: Sequence[Frame]) -> tuple[str, NDArray[Any]]:
    """Return the channel with the most to see, and the images in it."""
    first = raw_images([files[len(files) // 2]])[0]
    channel = "grey"
    if first.ndim == 3 and first.shape[2] >= len(CHANNEL_NUMBER):
        spread = [float(first[..., k].std()) for k in range(3)]
        if max(spread) > 1.05 * min(spread):
            channel = ("blue", "green", "red")[int(np.argmax(spread))]
    shown = numbered(["sine-x"] * len(files), "images")
    return channel, read_images(tuple(files), shown, channel).images


def _side_by_side(images: NDArray[Any], cameras: Sequence[CameraFiles], channel: str) -> NDArray[Any]:
    """Return the images of the first camera, and of the second one beside them: coarsest stripes are even where one camera sees few."""
    if len(cameras) == 1:
        return images
    shown = numbered(["sine-x"] * len(images), "images")
    other = read_images(cameras[1].files, shown, channel).images
    height_px = min(images.shape[1], other.shape[1])
    return np.concatenate([images[:, :height_px], other[:, :height_px].astype(images.dtype)], axis=2)


def _axis(name: str, seen: list[Seen], images: NDArray[Any]) -> AxisConvention | None:
    """Return the convention of a direction as far as it can be seen."""
    gray = [one for one in seen if one.word == f"gray-{name}"]
    groups = _groups(name, seen, images)
    size_px = float(GUESSED_PX["xy".index(name)])
    if not gray and not groups:
        return None
    stripe_px, fine_first = 0.0, False
    if gray:
        # Stripes finer than pixels change seldom: where most changes are seen, there is the fine end.
        fine_first = int(np.argmax([one.changes for one in gray])) < (len(gray) - 1) / 2
        # 2ⁿ stripes cover the pattern: how many of them the projector really has cannot be seen. Of ten or more images without fringes the
        # finest stripes are a pixel wide.
        size_px = float(2 ** (round(np.log2(size_px)) if groups else max(round(np.log2(size_px)), len(gray))))
        stripe_px = max(size_px / 2 ** len(gray), 0.5)
    finest = _finest_changes(gray, fine_first)
    steps_deg = tuple(_steps(images[group]) for group in groups)
    if stripe_px:
        periods_px = _beside_code([np.mean([seen[k].changes for k in group]) for group in groups], finest, stripe_px)
    else:
        periods_px = periods_by_phases([images[group] for group in groups], steps_deg, name, size_px)
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


def _groups(name: str, seen: list[Seen], images: NDArray[Any]) -> list[list[int]]:
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


def _beside_code(changes: list[Any], finest: float, stripe_px: float) -> tuple[float, ...]:
    """Return periods by how often images change: the finest of a Gray code every two stripes, and a sine every half period."""
    stripes = [0.25 * float(one) / max(finest, 1e-6) for one in changes]
    shares = [0.5**k for k in range(MOST_FINER + 1)]
    return tuple(stripe_px / min(shares, key=lambda share: abs(np.log(max(one, 1e-9) / share))) for one in stripes)


def _finest_changes(gray: list[Seen], fine_first: bool) -> float:
    """Return how often the finest image would change if the camera resolved it: from the image that is seen to change most."""
    if not gray:
        return 0.0
    k = int(np.argmax([one.changes for one in gray]))
    return gray[k].changes * 2.0 ** (k if fine_first else len(gray) - 1 - k)


def _steps(images: NDArray[Any]) -> tuple[float, ...]:
    count = len(images)
    equal = equal_steps(count)
    stack = _strong(images)
    return equal if count == LEAST_STEPS or misfit(stack, equal) < MOST_MISFIT else measured_steps(stack)


def _with_periods(seen: list[Seen], axes: list[AxisConvention], images: NDArray[Any]) -> list[str]:
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


def _fitted(description: Description, images: ImageSet) -> tuple[Description, list[str], int]:
    """Return the description with what fits its images instead of what was guessed, what could not be told, and how much of it is wrong."""
    notes: dict[str, str] = {}
    wrong = 0
    for _ in range(ROUNDS):
        camera = decode_camera(images, description)
        changed = False
        notes.clear()
        wrong = 0
        for axis in description.axes:
            for one in examine_axis(camera, axis):
                if one.outcome is Outcome.WRONG and one.instead:
                    description = description.with_axis(replace(description.axis(axis.name) or axis, **one.instead))
                    changed = True
                elif one.outcome is not Outcome.FITS:
                    notes[one.about] = one.text
                    wrong += one.outcome is Outcome.WRONG
        if not changed:
            break
    return description, [f"{about}: {text}" for about, text in notes.items()], wrong


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
    said += ["", "[images]"]
    if cameras[0].sides:
        said += [f'both = "{name(cameras[0].pattern)}"', f'sides = "{cameras[0].sides}"  # or right first']
    else:
        said += [f'{one.side} = "{name(one.pattern)}"' for one in cameras]
    said.append(f'order = "{order}"')
    said += [f'channel = "{description.channel}"'] if description.channel != "grey" else []
    if len(cameras) == 1:
        said.append("# Of one camera only: the projector must be calibrated, and takes the right camera's place.")
    said += ["", "[projector]  # cannot be seen: of two cameras, no point depends on it"]
    said += [f"width_px = {description.projector_px[0]}", f"height_px = {description.projector_px[1]}"]
    for axis in description.axes:
        said += ["", *_axis_text(axis)]
    said += ["", "[cameras]", *_cameras_text(description.cameras.content, name), "", "# [water]", "# index = 1.335", ""]
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


def _cameras_text(table: Mapping[str, Any], name: Callable[[str], str]) -> list[str]:
    """Return the lines of [cameras]."""
    if "calibration" in table:
        return [f'calibration = "{name(table["calibration"])}"']
    if not table:
        return ['# files = ["stereo.yml"]  # OpenCV: M1 D1 M2 D2 R T; nothing was found here', 'unit = "mm"']
    return [
        f"files = [{', '.join(chr(34) + name(one) + chr(34) for one in table['files'])}]",
        f'unit = "{table["unit"]}"  # of the translation',
    ]


# ------------------------------------------------------------------------------------------------ cameras, projector


def _cameras(folder: Path) -> dict[str, Any]:
    """Return what the folder has about cameras, as [cameras] would say it: a calibration of ours, else files with matrices."""
    files = []
    for path in sorted(folder.rglob("*")):
        if not path.is_file() or path.suffix.lower() not in CAMERA_SUFFIXES:
            continue
        relative = str(path.relative_to(folder))
        if path.suffix == ".json":
            try:
                calibration_file.load(path)
            except calibration_file.CalibrationError:
                pass
            else:
                return {"calibration": relative}
        try:
            wanted = SINGLES if path.suffix.lower() in SINGLE_SUFFIXES else MATRICES
            if any(np.size(value) in wanted for value in numbers_in(path).values()):
                files.append(relative)
        except ForeignError:
            continue
    if not files:
        return {}
    numbers = _numbers(folder, {"files": files})
    short = "translation" in numbers and float(np.linalg.norm(numbers["translation"])) < METRES_BELOW
    return {"files": files, "unit": "m" if short else "mm"}


def _numbers(folder: Path, table: Mapping[str, Any]) -> dict[str, Any]:
    """Return the numbers of both cameras; nothing where they are not all there."""
    try:
        return numbers_from_files(folder, Table("cameras.", table)) if "files" in table else {}
    except ForeignError:
        return {}


def _projectors_px(folder: Path, table: Mapping[str, Any]) -> tuple[tuple[int, int], ...]:
    """Return the sizes whose middle column is nearest to the projector's principal point, the commonest one first."""
    matrix = _numbers(folder, table).get("right_matrix")
    if matrix is None:
        return (GUESSED_PX,)
    width_px = 2.0 * float(np.reshape(matrix, (3, 3))[0, 2]) + 1.0
    nearest_px = min((width for width, _ in PROJECTORS_PX), key=lambda width: abs(width - width_px))
    return tuple(size for size in PROJECTORS_PX if size[0] == nearest_px)


def _sized(axes: Sequence[AxisConvention], size_px: tuple[int, int]) -> list[AxisConvention]:
    """Return the directions on a projector of that size: a code's stripes are whole powers of two of its px."""
    found = []
    for axis in axes:
        size = float(size_px["xy".index(axis.name)])
        scale = size / axis.size_px
        if axis.bits:
            scale = max(2.0 ** (np.ceil(np.log2(size)) - axis.bits), 1.0) / axis.stripe_px
        periods_px = tuple(scale * one for one in axis.periods_px)
        found.append(replace(axis, size_px=size, periods_px=periods_px, stripe_px=scale * axis.stripe_px))
    return found


def _on_projector(
    description: Description, images: ImageSet, sizes_px: Sequence[tuple[int, int]]
) -> tuple[Description, list[str]]:
    """Return the description with the projector's size and the begin of the code that make points, and what could not be told."""
    height_px, width_px = images.shape
    notes: list[str] = []
    for size_px in sizes_px:
        axes = tuple(_sized(description.axes, size_px))
        tried = replace(description, axes=axes, projector_px=size_px)
        try:
            rig = read_rig(tried, {"left": (width_px, height_px), "right": size_px})
            found = examine_arrangement(tried, rig, {"left": decode_camera(images, tried)})
        except ForeignError as error:
            return description, [str(error)]
        if found.outcome is not Outcome.WRONG:
            return tried, [] if found.outcome is Outcome.FITS else [str(found)]
        if found.instead:
            for axis in axes:
                offset_px = found.instead[f"{axis.name}.code_offset_px"]
                tried = tried.with_axis(replace(axis, code_offset_px=offset_px))
            return tried, []
        notes = notes or [str(found)]
    return description, notes
