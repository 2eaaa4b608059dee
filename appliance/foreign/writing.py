"""Owns the text of a description that was guessed: each line says how sure it is."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from appliance.foreign.assumptions import ExaminedAssumption, Outcome, equal_steps
from appliance.foreign.description import AxisConvention, Description, ImageFiles

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

    def name(pattern: str) -> str:
        path, own = (description.folder / pattern).absolute(), beside.absolute()
        return str(path.relative_to(own)) if path.is_relative_to(own) else str(path)

    two = "right" in description.files
    said = ["# Guessed from the images. Behind each line stands what checked it; docs/foreign.md explains every word."]
    said += [f"# {note}" for note in notes]
    said += ["", "[images]", *_files(description.files, name)]
    said.append(f'order = "{joined([one.word for one in description.order or ()])}"')
    usual = MOVES_NOTHING if two else NOTHING_TELLS
    said += [f'channel = "{description.channel}"'] if description.channel != "grey" else []
    said += ["", "[projector]"]
    for key, value in zip(("width_px", "height_px"), description.projector_px, strict=True):
        told = MOVES_NOTHING if two else _confidence(tested, f"projector.{key}", NOTHING_TELLS)
        said.append(_line(f"{key} = {value}", told))
    for axis in description.axes:
        said += ["", f"[{axis.name}]"]
        said += [
            _line(line, _confidence(tested, f"{axis.name}.{line.split(' ')[0].replace('steps_deg', 'steps')}", usual))
            for line in _axis(axis)
        ]
    said += ["", "[cameras]", *_cameras(description.cameras.content, name), "", "# [water]", "# index = 1.335", ""]
    return "\n".join(said)


def _line(text: str, told: str) -> str:
    return f"{text:{WIDTH}} # {told}"


def _confidence(tested: Sequence[ExaminedAssumption], about: str, usual: str) -> str:
    said = [one for one in tested if one.about.rpartition(": ")[2] == about]
    if any(one.outcome is Outcome.WRONG for one in said):
        return "WRONG: " + next(one.text for one in said if one.outcome is Outcome.WRONG)
    if any(one.outcome is Outcome.FITS for one in said):
        return CHECKED
    return next((f"{NOTHING_TELLS}: {one.text}" for one in said), usual)


def _files(files: Mapping[str, ImageFiles], name: Callable[[str], str]) -> list[str]:
    left = files["left"]
    if not left.sides:
        return [f"{side} = {_quoted([name(one) for one in found.patterns])}" for side, found in files.items()]
    return [f"both = {_quoted([name(one) for one in left.patterns])}", f'sides = "{left.sides}"']


def _quoted(names: Sequence[str]) -> str:
    quoted = [f'"{one}"' for one in names]
    return quoted[0] if len(quoted) == 1 else f"[{', '.join(quoted)}]"


def _numbers(values: Sequence[float]) -> str:
    said = [f"{one:.8g}" for one in values]
    return said[0] if len(said) == 1 else f"[{', '.join(said)}]"


def _axis(axis: AxisConvention) -> list[str]:
    """Return the lines of a direction."""
    said = []
    if axis.periods_px:
        said.append(f"period_px = {_numbers(axis.periods_px)}")
        steps = [one for one in axis.steps_deg if len(one) > 1]
        if all(one == equal_steps(len(one)) for one in steps):
            counts = [len(one) for one in steps]
            said.append(f"steps = {_numbers(counts[:1] if len(set(counts)) == 1 else counts)}")
        else:
            lists = [f"[{', '.join(f'{step:g}' for step in one)}]" for one in steps]
            said.append(f"steps_deg = {lists[0] if len(set(lists)) == 1 else '[' + ', '.join(lists) + ']'}")
        said.append(f'sign = "{"-" if axis.sign < 0 else "+"}"')
        starts_deg = [axis.start_deg + one for one in axis.starts_deg] or [axis.start_deg]
        said += [f"start_deg = {_numbers(starts_deg)}"] if any(starts_deg) else []
        said += ['start_at = "middle"'] if axis.from_middle else []
    if axis.bits:
        said += ['gray = "shifted"'] if axis.wraps else []
        said.append(f"stripe_px = {axis.stripe_px:g}")
        said += [f"code_offset_px = {axis.code_offset_px:g}"] if axis.code_offset_px else []
        said += ['code = "binary"'] if axis.plain_binary else []
        said += ['code_order = "fine-first"'] if axis.fine_first else []
        said += ["code_inverted = true"] if axis.inverted else []
    return said


def _cameras(table: Mapping[str, Any], name: Callable[[str], str]) -> list[str]:
    """Return the lines of [cameras]."""
    if not table:
        return ['# files = ["stereo.yml"]  # OpenCV: M1 D1 M2 D2 R T; nothing was found here', 'unit = "mm"']
    said = []
    for key, value in table.items():
        if key in ("files", "calibration"):
            names = [value] if isinstance(value, str) else list(value)
            listed = [f'"{name(one)}"' for one in names]
            said.append(f"{key} = {listed[0] if isinstance(value, str) else '[' + ', '.join(listed) + ']'}")
        elif isinstance(value, str):
            said.append(f'{key} = "{value}"')
    for key, value in table.items():
        if isinstance(value, Mapping):
            said += [f"[cameras.{key}]", *(f'{word} = "{one}"' for word, one in value.items())]
    return said
