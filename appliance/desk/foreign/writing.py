"""Owns the text of a description that was guessed: each line says how sure it is."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from appliance.desk.foreign.assumptions import ExaminedAssumption, Outcome, equal_steps
from appliance.desk.foreign.description import AxisConvention, Description

CHECKED, MOVES_NOTHING, NOTHING_TELLS = "checked", "moves no point of two cameras", "UNCHECKED"
WIDTH = 44


def joined(words: Sequence[str]) -> str:
    """Return words with repetitions written as such: ``gray-x*6``, ``(gray-x ~gray-x)*6``."""
    said: list[str] = []
    k = 0
    while k < len(words):
        for length in (1, 2):
            unit, count = list(words[k : k + length]), 1
            while list(words[k + count * length : k + (count + 1) * length]) == unit:
                count += 1
            if count > 1 and len(set(unit)) == length:
                said.append(f"{unit[0] if length == 1 else '(' + ' '.join(unit) + ')'}*{count}")
                k += count * length
                break
        else:
            said.append(words[k])
            k += 1
    return " ".join(said)


def description_text(
    description: Description, tested: Sequence[ExaminedAssumption], beside: Path, notes: Sequence[str]
) -> str:
    """Return a description as the text of a file in the folder ``beside``; ``notes`` stand at its head."""

    def names(patterns: str | Sequence[str]) -> str:
        paths = [
            (description.folder / one).absolute() for one in ([patterns] if isinstance(patterns, str) else patterns)
        ]
        own = beside.absolute()
        return _value([str(one.relative_to(own) if one.is_relative_to(own) else one) for one in paths])

    two, left = "right" in description.files, description.files["left"]
    said = ["# Guessed from the images. Behind each line stands what checked it; docs/foreign.md explains every word."]
    said += [*(f"# {note}" for note in notes), "", "[images]"]
    if left.sides:
        said += [f"both = {names(left.patterns)}", f"sides = {_value(left.sides)}"]
    else:
        said += [f"{side} = {names(found.patterns)}" for side, found in description.files.items()]
    said.append(f"order = {_value(joined([one.word for one in description.order or ()]))}")
    said += [f"channel = {_value(description.channel)}"] if description.channel != "grey" else []
    said += ["", "[projector]"]
    for word, px in zip(("width_px", "height_px"), description.projector_px, strict=True):
        told = MOVES_NOTHING if two else _confidence(tested, f"projector.{word}", NOTHING_TELLS)
        said.append(f"{f'{word} = {px}':{WIDTH}} # {told}")
    for axis in description.axes:
        said += ["", f"[{axis.name}]"]
        for word, value in _words(axis):
            about = f"{axis.name}.{'steps' if word == 'steps_deg' else word}"
            told = _confidence(tested, about, MOVES_NOTHING if two else NOTHING_TELLS)
            said.append(f"{f'{word} = {_value(value)}':{WIDTH}} # {told}")
    said += ["", "[cameras]"]
    table = description.cameras.content
    if not table:
        said += ['# files = ["stereo.yml"]  # OpenCV: M1 D1 M2 D2 R T; nothing was found here', 'unit = "mm"']
    for key, value in table.items():
        if not isinstance(value, Mapping):
            said.append(f"{key} = {names(value) if key in ('files', 'calibration') else _value(value)}")
    for key, value in table.items():
        if isinstance(value, Mapping):
            said += [f"[cameras.{key}]", *(f"{word} = {_value(one)}" for word, one in value.items())]
    return "\n".join([*said, "", "# [water]", "# index = 1.335", ""])


def _value(value: Any) -> str:
    """Return a value as TOML has it; a list of one is that one."""
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, Sequence):
        return _value(value[0]) if len(value) == 1 else f"[{', '.join(map(_value, value))}]"
    return str(value).lower() if isinstance(value, bool) else f"{value:.8g}"


def _confidence(tested: Sequence[ExaminedAssumption], about: str, usual: str) -> str:
    said = [one for one in tested if one.about.rpartition(": ")[2] == about]
    if any(one.outcome is Outcome.WRONG for one in said):
        return "WRONG: " + next(one.text for one in said if one.outcome is Outcome.WRONG)
    if any(one.outcome is Outcome.FITS for one in said):
        return CHECKED
    return next((f"{NOTHING_TELLS}: {one.text}" for one in said), usual)


def _words(axis: AxisConvention) -> Iterator[tuple[str, Any]]:
    """Yield the words of a direction with their values, without those that say what is usual."""
    if axis.periods_px:
        yield "period_px", axis.periods_px
        # Periods of one image each share the first one's steps.
        steps = [one for one in axis.steps_deg if len(one) > 1]
        steps = steps[:1] if len(set(steps)) == 1 else steps
        if all(one == equal_steps(len(one)) for one in steps):
            yield "steps", [len(one) for one in steps]
        else:
            yield "steps_deg", steps
        yield "sign", "-" if axis.sign < 0 else "+"
    starts_deg = [axis.start_deg + one for one in axis.starts_deg or (0.0,)]
    for word, value, said in (
        ("start_deg", starts_deg, any(starts_deg)),
        ("start_at", "middle", axis.from_middle),
        ("gray", "shifted", axis.wraps),
        ("stripe_px", axis.stripe_px, axis.bits > 0),
        ("code_offset_px", axis.code_offset_px, axis.code_offset_px != 0.0),
        ("code", "binary", axis.plain_binary),
        ("code_order", "fine-first", axis.fine_first),
        ("code_inverted", True, axis.inverted),
    ):
        if said:
            yield word, value
