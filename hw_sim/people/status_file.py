"""The conditions that a script can wait for, as queries of the product's status file."""

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
    """Return a table of the file; empty if the value is no table."""
    return value if isinstance(value, Mapping) else {}


def _calibration(status: Status, field: str, name: str) -> bool:
    """Return True if ``field`` of an idle calibration is ``name``."""
    table = _table(status.get("calibration"))
    return table.get(field) == name and not table.get("busy")


def _distance(status: Status, mm: float, within_mm: float) -> bool:
    """Return True if the distance by the laser dots is within ``within_mm`` of ``mm``."""
    distance_mm = _table(status.get("range")).get("distance_mm")
    return isinstance(distance_mm, int | float) and abs(distance_mm - mm) <= within_mm


def _tilt(status: Status, deg: float, within_deg: float) -> bool:
    """Return True if the tilt by the laser dots is within ``within_deg`` of ``deg``."""
    tilt_deg = _table(status.get("range")).get("tilt_deg")
    return isinstance(tilt_deg, int | float) and abs(tilt_deg - deg) <= within_deg


def _gallery(status: Status, scan: str, what: str) -> bool:
    """Return True if the gallery shows ``scan`` with that mark of ``GALLERY``, or that beginning of its date."""
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
    """Return True if one of ``texts`` matches ``pattern``; ``*`` stands for any text, such as numbers."""
    return any(fnmatch.fnmatchcase(text, pattern) for text in texts)


CONDITIONS: Mapping[str, tuple[int, Callable[[Status, list[str]], bool]]] = {
    "state": (1, lambda status, args: status.get("state") == args[0]),
    "alert": (1, lambda status, args: args[0] in _alerts(status, "code")),
    "gone": (1, lambda status, args: bool(status) and args[0] not in _alerts(status, "code")),
    "headline": (1, lambda status, args: _like(_alerts(status, "headline"), " ".join(args))),
    "action": (1, lambda status, args: _like(_alerts(status, "action"), " ".join(args))),
    "label": (2, lambda status, args: _like([str(_table(status.get("keys")).get(args[0]))], " ".join(args[1:]))),
    "device": (2, lambda status, args: _table(status.get("devices")).get(args[0]) == args[1]),
    "distance": (2, lambda status, args: _distance(status, float(args[0]), float(args[1]))),
    "tilt": (2, lambda status, args: _tilt(status, float(args[0]), float(args[1]))),
    "gallery": (2, lambda status, args: _gallery(status, args[0], args[1])),
    "reach": (1, lambda status, args: _table(status.get("range")).get("word") == args[0]),
    "scans": (1, lambda status, args: str(status.get("scans")) == args[0]),
    "overlap": (1, lambda status, args: _like([str(status.get("overlap"))], " ".join(args))),
    "guidance": (1, lambda status, args: _like([str(_table(status.get("guidance")).get("words"))], " ".join(args))),
    "step": (1, lambda status, args: _calibration(status, "step", args[0])),
    "result": (1, lambda status, args: _calibration(status, "result", args[0])),
}
"""Condition → (least number of arguments, function that returns whether it is met)."""


def is_met(status: Status, kind: str, args: list[str]) -> bool:
    """Return True if the condition ``kind`` is met."""
    return CONDITIONS[kind][1](status, args)


def check(kind: str, args: list[str]) -> None:
    """Check a condition and its arguments. Raises ValueError if it could never be met."""
    if kind not in CONDITIONS:
        raise ValueError(f"'{kind}' is no condition; allowed are {', '.join(CONDITIONS)}")
    if len(args) < CONDITIONS[kind][0]:
        raise ValueError(f"'{kind}' takes {CONDITIONS[kind][0]} words or more, then the seconds")
    if kind in ("distance", "tilt"):
        [float(number) for number in args]


def read(path: Path) -> dict[str, Any]:
    """Return the present status; empty without a file."""
    try:
        # The file is replaced atomically while the service runs; it may be missing before and after.
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def summary(status: Status) -> str:
    """Return the status in one line, for error messages."""
    listed = status.get("alerts")
    read = ", ".join(_alert(_table(alert)) for alert in listed) if isinstance(listed, list) else ""
    calibration = status.get("calibration")
    return (
        f"the state is {_words(status.get('state'))}; alerts: {read or 'none'}; keys: {_words(status.get('keys'))}; "
        f"scans: {_words(status.get('scans'))}; range: {_words(status.get('range'))}"
        + (f"; calibration: {_words(calibration)}" if calibration else "")
    )


def _alert(alert: Mapping[str, Any]) -> str:
    """Return an alert's code and its words on the screen, if there are any."""
    text = ": ".join(str(alert[field]) for field in ("headline", "action") if alert.get(field))
    return f"{alert.get('code')} ({text})" if text else str(alert.get("code"))


def _words(value: object) -> str:
    """Return a value of the file as a person would write it."""
    match value:
        case None | "":
            return "-"
        case bool():
            return "yes" if value else "no"
        case float():
            return f"{value:.4g}"
        case Mapping():
            return ", ".join(f"{name} {_words(item)}" for name, item in value.items()) or "none"
        case list():
            return ", ".join(_words(item) for item in value) or "none"
        case _:
            return str(value)
