"""Owns the conditions that a script can wait for: questions to the product's status file, and to nothing else of it."""

from __future__ import annotations

import fnmatch
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

Status = Mapping[str, Any]


def _alerts(status: Status, field: str) -> list[str]:
    alerts = status.get("alerts")
    return [str(_table(alert).get(field)) for alert in alerts] if isinstance(alerts, list) else []


def _table(value: object) -> Mapping[str, Any]:
    """Return a table of the file; empty where it has something else in that place."""
    return value if isinstance(value, Mapping) else {}


def _calibration(status: Status, field: str, name: str) -> bool:
    """Return whether ``field`` of a calibration is ``name``, when nothing is computed for it any more."""
    at = _table(status.get("calibration"))
    return at.get(field) == name and not at.get("busy")


def _distance(status: Status, mm: float, within_mm: float) -> bool:
    """Return whether the laser dots tell a distance within so much of ``mm``."""
    found = _table(status.get("range")).get("distance_mm")
    return isinstance(found, int | float) and abs(found - mm) <= within_mm


def _tilt(status: Status, deg: float, within_deg: float) -> bool:
    """Return whether the laser dots tell a tilt within so much of ``deg``."""
    found = _table(status.get("range")).get("tilt_deg")
    return isinstance(found, int | float) and abs(found - deg) <= within_deg


def _gallery(status: Status, scan: str, what: str) -> bool:
    """Return whether the gallery shows ``scan``, with a mark of ``GALLERY`` or with a date that begins with ``what``."""
    shown = _table(status.get("gallery"))
    if shown.get("scan") != scan:
        return False
    if what in GALLERY:
        return GALLERY[what](shown)
    return str(shown.get("taken") or "").startswith(what)


GALLERY: Mapping[str, Callable[[Mapping[str, Any]], bool]] = {
    "damaged": lambda shown: shown.get("damaged") is True,
    "whole": lambda shown: shown.get("damaged") is False,
    "undated": lambda shown: "taken" in shown and shown["taken"] is None,
}
"""Marks of a scan in the gallery, besides its date."""


def _like(texts: list[str], pattern: str) -> bool:
    """Return whether one of ``texts`` is like ``pattern``; ``*`` stands for anything: numbers that a scene does not fix."""
    return any(fnmatch.fnmatchcase(text, pattern) for text in texts)


CONDITIONS: Mapping[str, tuple[int, Callable[[Status, list[str]], bool]]] = {
    "state": (1, lambda status, words: status.get("state") == words[0]),
    "alert": (1, lambda status, words: words[0] in _alerts(status, "code")),
    "gone": (1, lambda status, words: bool(status) and words[0] not in _alerts(status, "code")),
    "headline": (1, lambda status, words: _like(_alerts(status, "headline"), " ".join(words))),
    "action": (1, lambda status, words: _like(_alerts(status, "action"), " ".join(words))),
    "label": (2, lambda status, words: _like([str(_table(status.get("keys")).get(words[0]))], " ".join(words[1:]))),
    "device": (2, lambda status, words: _table(status.get("devices")).get(words[0]) == words[1]),
    "distance": (2, lambda status, words: _distance(status, float(words[0]), float(words[1]))),
    "tilt": (2, lambda status, words: _tilt(status, float(words[0]), float(words[1]))),
    "gallery": (2, lambda status, words: _gallery(status, words[0], words[1])),
    "reach": (1, lambda status, words: _table(status.get("range")).get("word") == words[0]),
    "scans": (1, lambda status, words: str(status.get("scans")) == words[0]),
    "overlap": (1, lambda status, words: _like([str(status.get("overlap"))], " ".join(words))),
    "guidance": (1, lambda status, words: _like([str(_table(status.get("guidance")).get("words"))], " ".join(words))),
    "step": (1, lambda status, words: _calibration(status, "step", words[0])),
    "result": (1, lambda status, words: _calibration(status, "result", words[0])),
}
"""Condition → (number of words it takes at least, whether it is met now)."""


def is_met(status: Status, kind: str, words: list[str]) -> bool:
    """Return whether the condition ``kind`` is met."""
    return CONDITIONS[kind][1](status, words)


def check(kind: str, words: list[str]) -> None:
    """Check a condition and its words. Raises ValueError for what could never be met."""
    if kind not in CONDITIONS:
        raise ValueError(f"'{kind}' cannot be waited for; allowed are {', '.join(CONDITIONS)}")
    if len(words) < CONDITIONS[kind][0]:
        raise ValueError(f"'{kind}' takes {CONDITIONS[kind][0]} words or more, then the seconds")
    if kind in ("distance", "tilt"):
        [float(number) for number in words]


def read(path: Path) -> dict[str, Any]:
    """Return the status now; empty where there is none."""
    try:
        # The file is replaced as a whole while the service runs, but may be missing before it starts and after it ends.
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def summary(status: Status) -> str:
    """Return the whole status in one line, for messages that say what is to be seen instead."""
    listed = status.get("alerts")
    read = ", ".join(_alert(_table(alert)) for alert in listed) if isinstance(listed, list) else ""
    calibration = status.get("calibration")
    return (
        f"the state is {_words(status.get('state'))}; alerts: {read or 'none'}; keys: {_words(status.get('keys'))}; "
        f"scans: {_words(status.get('scans'))}; range: {_words(status.get('range'))}"
        + (f"; calibration: {_words(calibration)}" if calibration else "")
    )


def _alert(alert: Mapping[str, Any]) -> str:
    """Return an alert's code, and what the screen says of it where the file has that."""
    said = ": ".join(str(alert[field]) for field in ("headline", "action") if alert.get(field))
    return f"{alert.get('code')} ({said})" if said else str(alert.get("code"))


def _words(value: object) -> str:
    """Return a value of the file as a person would write it down."""
    match value:
        case None | "":
            return "-"
        case bool():
            return "yes" if value else "no"
        case float():
            return f"{value:.4g}"
        case Mapping():
            return ", ".join(f"{name} {_words(one)}" for name, one in value.items()) or "none"
        case list():
            return ", ".join(_words(one) for one in value) or "none"
        case _:
            return str(value)
