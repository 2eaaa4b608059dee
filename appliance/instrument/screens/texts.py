"""Owns how words and numbers become what a screen writes in a language.

The words are in ``appliance.instrument.machine.words``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import datetime, timedelta

from appliance.instrument.machine.words import Label, Language, Text

DEVICE_NAMES: Mapping[str, Text] = {
    "camera.left": Text.CAMERA_LEFT,
    "camera.right": Text.CAMERA_RIGHT,
    "board": Text.BOARD,
    "keys": Text.KEYS,
    "projector": Text.PROJECTOR,
    "display": Text.DISPLAY,
    "storage": Text.STORAGE,
    "calibration": Text.CALIBRATION,
    "worker": Text.WORKER,
}
"""Names of the devices of the rig file; a device not listed is shown by its own name."""

_DECIMAL = re.compile(r"(?<![\d.])(\d+)\.(\d+)(?![\d.])")
"""Pattern of one point between figures: a version like 0.1.0 has two."""


def numbered(words: str, language: Language) -> str:
    """Return numbers as the language writes them: 0.31 % → 0,31 % in German."""
    return _DECIMAL.sub(r"\1,\2", words) if language is Language.GERMAN else words


def to_the_minute(time: str) -> str:
    """Return an ISO time as people read it: 2026-11-26T20:55:56+00:00 → 2026-11-26 20:55 UTC; what is none, as it is."""
    try:
        at = datetime.fromisoformat(time)
    except ValueError:
        return time
    return f"{at:%Y-%m-%d %H:%M}" + (" UTC" if at.utcoffset() == timedelta(0) else "")


def worded(label: Label, language: Language) -> str:
    """Return a label in a language: its entries translated, its numbers written as there."""
    match label:
        case Text():
            return label.in_language(language)
        case str():
            return numbered(label, language)
        case _:
            return " ".join(worded(part, language) for part in label)
