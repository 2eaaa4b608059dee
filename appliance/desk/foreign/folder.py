"""Import of a folder of images without a description: guess, description, contact sheet and points.

Each guessed line of the description says how it was checked; below each image of the sheet stand its role and the share
that the description explains.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.base import Progress
from appliance.desk.foreign.assumptions import ExaminedAssumption, Outcome
from appliance.desk.foreign.description import AxisConvention, equal_steps, toml_value
from appliance.desk.foreign.guess import TriedSequence, guess_sequence
from appliance.desk.foreign.importing import import_described
from appliance.desk.foreign.order import join_words
from appliance.desk.foreign.problem import ForeignError
from appliance.store import LocalFileSystem

CHECKED, MOVES_NOTHING, NOTHING_TELLS = "checked", "moves no point of two cameras", "UNCHECKED"
WIDTH = 44
WIDTH_PX, TEXT_PX, MOST_COLUMNS = 200, 22, 8
GOOD = 0.5
_PLAIN, _POOR = (235, 235, 235), (80, 160, 255)


def beside_cloud(out: Path) -> tuple[Path, Path, Path]:
    """Return the paths of the description, the contact sheet and the picture beside the cloud ``out``."""
    return out.with_suffix(".toml"), out.with_name(f"{out.stem}.roles.png"), out.with_name(f"{out.stem}.cloud.png")


def import_folder(folder: Path, out: Path, progress: Progress, reasons: Path | None = None) -> dict[str, Any]:
    """Guess the roles of the images below ``folder``, and write the cloud ``out`` with its files.

    Raises ForeignError if no guess stands out or the cameras are unknown: description and contact sheet are written then.
    Raises also as ``import_described``.
    """
    candidates = guess_sequence(folder, progress)
    described, roles, picture = beside_cloud(out)
    files = LocalFileSystem()
    best = candidates[0]
    files.replace_file(roles, contact_sheet(list(best.images), best.words, best.by_image))
    if len(candidates) > 1:
        raise ForeignError(_question(folder, out, candidates))
    _write(best, described)
    if not best.description.cameras.content:
        raise ForeignError(
            f"{folder}: its images are {join_words(best.words)} ({best.program}), and no file has the calibration; "
            f"put it into the folder, or write it under [cameras] of {described.name}"
        )
    report = import_described(described, out, progress, reasons=reasons, picture=picture)
    return {
        **report,
        "program": best.program,
        "order": join_words(best.words),
        "explained_percent": 100.0 * best.explained,
        "description": str(described),
        "roles": str(roles),
        "picture": str(picture),
    }


def _write(candidate: TriedSequence, path: Path) -> None:
    LocalFileSystem().replace_file(path, describe_guess(candidate, path.parent).encode())


def _question(folder: Path, out: Path, candidates: Sequence[TriedSequence]) -> str:
    """Write both descriptions, and return the question that tells them apart."""
    readings = []
    for number, candidate in enumerate(candidates, 1):
        path = out.with_name(f"{out.stem}.{number}.toml")
        _write(candidate, path)
        readings.append(
            f"{join_words(candidate.words)} ({candidate.program}, explains {100 * candidate.explained:.0f} %: {path.name})"
        )
    differing = [
        k
        for k, roles in enumerate(zip(*(candidate.words for candidate in candidates), strict=False), 1)
        if len(set(roles)) > 1
    ]
    question = (
        f"what do images {differing[0]} to {differing[-1]} show? See {beside_cloud(out)[1].name}, and "
        if differing
        else ""
    )
    return (
        f"{folder}: two interpretations of the images fit equally well: {readings[0]}, or {readings[1]}; "
        f"{question}import the right description"
    )


# ------------------------------------------------------------ description


def describe_guess(candidate: TriedSequence, beside: Path) -> str:
    """Return the description of a candidate as the text of a file in the folder ``beside``."""
    description, tested = candidate.description, candidate.tested
    explained = f"{candidate.program}: {100 * candidate.explained:.0f} % of the images' variation is explained."

    def names(patterns: str | Sequence[str]) -> str:
        paths = [
            (description.folder / pattern).absolute()
            for pattern in ([patterns] if isinstance(patterns, str) else patterns)
        ]
        folder = beside.absolute()
        return toml_value([str(path.relative_to(folder) if path.is_relative_to(folder) else path) for path in paths])

    is_stereo, left = "right" in description.files, description.files["left"]
    lines = ["# Estimated from the images. Each line ends with its check; docs/foreign.md explains every word."]
    lines += [*(f"# {note}" for note in (explained, *candidate.notes)), "", "[images]"]
    if left.sides:
        lines += [f"both = {names(left.patterns)}", f"sides = {toml_value(left.sides)}"]
    else:
        lines += [f"{side} = {names(images.patterns)}" for side, images in description.files.items()]
    lines.append(f"order = {toml_value(join_words(candidate.words))}")
    lines += [f"channel = {toml_value(description.channel)}"] if description.channel != "grey" else []
    lines += ["", "[projector]"]
    for word, px in zip(("width_px", "height_px"), description.projector_px, strict=True):
        check = MOVES_NOTHING if is_stereo else _confidence(tested, f"projector.{word}", NOTHING_TELLS)
        lines.append(f"{f'{word} = {px}':{WIDTH}} # {check}")
    for axis in description.axes:
        lines += ["", f"[{axis.name}]"]
        for word, value in _keys_of(axis):
            subject = f"{axis.name}.{'steps' if word == 'steps_deg' else word}"
            check = _confidence(tested, subject, MOVES_NOTHING if is_stereo else NOTHING_TELLS)
            lines.append(f"{f'{word} = {toml_value(value)}':{WIDTH}} # {check}")
    lines += ["", "[cameras]"]
    table = description.cameras.content
    if not table:
        lines += ['# files = ["stereo.yml"]  # OpenCV: M1 D1 M2 D2 R T; none was found', 'unit = "mm"']
    for key, value in table.items():
        if not isinstance(value, Mapping):
            lines.append(f"{key} = {names(value) if key in ('files', 'calibration') else toml_value(value)}")
    for key, value in table.items():
        if isinstance(value, Mapping):
            lines += [f"[cameras.{key}]", *(f"{word} = {toml_value(entry)}" for word, entry in value.items())]
    return "\n".join([*lines, "", "# [water]", "# index = 1.335", ""])


def _confidence(tested: Sequence[ExaminedAssumption], subject: str, usual: str) -> str:
    tests = [test for test in tested if test.subject.rpartition(": ")[2] == subject]
    if any(test.outcome is Outcome.WRONG for test in tests):
        return "WRONG: " + next(test.text for test in tests if test.outcome is Outcome.WRONG)
    if any(test.outcome is Outcome.FITS for test in tests):
        return CHECKED
    return next((f"{NOTHING_TELLS}: {test.text}" for test in tests), usual)


def _keys_of(axis: AxisConvention) -> Iterator[tuple[str, Any]]:
    """Yield the keys of a direction with their values, without those of usual value."""
    if axis.periods_px:
        yield "period_px", axis.periods_px
        # Periods of one image each share the first one's steps.
        steps = [steps_of_period for steps_of_period in axis.steps_deg if len(steps_of_period) > 1]
        steps = steps[:1] if len(set(steps)) == 1 else steps
        if all(steps_of_period == equal_steps(len(steps_of_period)) for steps_of_period in steps):
            yield "steps", [len(steps_of_period) for steps_of_period in steps]
        else:
            yield "steps_deg", steps
        yield "sign", "-" if axis.sign < 0 else "+"
    starts_deg = [axis.start_deg + start for start in axis.starts_deg or (0.0,)]
    for word, value, is_unusual in (
        ("start_deg", starts_deg, any(starts_deg)),
        ("start_at", "middle", axis.from_middle),
        ("gray", "shifted", axis.wraps),
        ("stripe_px", axis.stripe_px, axis.bits > 0),
        ("code_offset_px", axis.code_offset_px, axis.code_offset_px != 0.0),
        ("code", "binary", axis.plain_binary),
        ("code_order", "fine-first", axis.fine_first),
        ("code_inverted", True, axis.inverted),
    ):
        if is_unusual:
            yield word, value


# ------------------------------------------------------------ contact sheet


def contact_sheet(images: Sequence[NDArray[Any]], roles: Sequence[str], explained: Sequence[float]) -> bytes:
    """Return a PNG of ``images`` (h, w), with role and explained share (NaN: none) below each.

    Texts of poor shares are orange.
    """
    height_px = round(WIDTH_PX * images[0].shape[0] / images[0].shape[1])
    columns = min(MOST_COLUMNS, len(images))
    rows = -(-len(images) // columns)
    sheet = np.full((rows * (height_px + TEXT_PX), columns * WIDTH_PX, 3), 30, np.uint8)
    brightest = max(float(image.max()) for image in images)
    for k, (image, word, share) in enumerate(zip(images, roles, explained, strict=True)):
        top, left = k // columns * (height_px + TEXT_PX), k % columns * WIDTH_PX
        small = cv2.resize(image, (WIDTH_PX - 2, height_px - 2), interpolation=cv2.INTER_AREA)
        grey = np.rint(small.astype(np.float32) * np.float32(255.0 / brightest)).astype(np.uint8)
        sheet[top : top + height_px - 2, left : left + WIDTH_PX - 2] = grey[..., None]
        label = f"{k + 1} {word}" + ("" if np.isnan(share) else f" {100 * share:.0f}%")
        colour = _PLAIN if np.isnan(share) or share > GOOD else _POOR
        cv2.putText(
            sheet, label, (left + 3, top + height_px + 14), cv2.FONT_HERSHEY_SIMPLEX, 0.42, colour, 1, cv2.LINE_AA
        )
    return bytes(cv2.imencode(".png", sheet)[1])
