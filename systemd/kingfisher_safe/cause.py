"""Owns why the service does not run, in the diver's words: from its own last words, else from what systemd saw."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kingfisher_safe.page import Notice


@dataclass(frozen=True, slots=True)
class Cause:
    """What is wrong; ``key`` picks the words."""

    key: str
    detail: str


@dataclass(frozen=True, slots=True)
class _Words:
    headline: str
    action: str


_ENGLISH = {
    "config": _Words("RIG FILE IS WRONG", "CORRECT THE RIG FILE AT THE SURFACE"),
    "storage": _Words("DISK REFUSES", "COPY SCANS, CHECK THE DISK"),
    "disk": _Words("DATA DISK IS NOT THERE", "CHECK OR REPLACE THE DISK"),
    "device": _Words("NO GRAPHICS OR NO DEVICES", "CHECK CONNECTORS, SWITCH OFF AND ON"),
    "program": _Words("PROGRAM FAILED", "TRY AGAIN, ELSE SURFACE: SERVICE"),
    "hang": _Words("PROGRAM HANGS", "TRY AGAIN, ELSE SURFACE: SERVICE"),
    "killed": _Words("PROGRAM WAS KILLED", "TRY AGAIN, ELSE SURFACE: SERVICE"),
    "memory": _Words("OUT OF MEMORY", "SWITCH OFF AND ON"),
    "missing": _Words("PROGRAM IS NOT THERE", "INSTALL IT AGAIN AT THE SURFACE"),
    "unknown": _Words("PROGRAM DOES NOT RUN", "TRY AGAIN, ELSE SURFACE: SERVICE"),
}
_GERMAN = {
    "config": _Words("RIG-DATEI IST FALSCH", "RIG-DATEI AN DER OBERFLÄCHE KORRIGIEREN"),
    "storage": _Words("DATENTRÄGER VERWEIGERT", "SCANS KOPIEREN, DATENTRÄGER PRÜFEN"),
    "disk": _Words("DATENTRÄGER FEHLT", "DATENTRÄGER PRÜFEN ODER TAUSCHEN"),
    "device": _Words("KEINE GRAFIK ODER KEINE GERÄTE", "STECKER PRÜFEN, AUS- UND EINSCHALTEN"),
    "program": _Words("PROGRAMM GESCHEITERT", "NOCHMAL, SONST AUFTAUCHEN: SERVICE"),
    "hang": _Words("PROGRAMM HÄNGT", "NOCHMAL, SONST AUFTAUCHEN: SERVICE"),
    "killed": _Words("PROGRAMM WURDE BEENDET", "NOCHMAL, SONST AUFTAUCHEN: SERVICE"),
    "memory": _Words("SPEICHER REICHT NICHT", "AUS- UND EINSCHALTEN"),
    "missing": _Words("PROGRAMM FEHLT", "AN DER OBERFLÄCHE NEU INSTALLIEREN"),
    "unknown": _Words("PROGRAMM LÄUFT NICHT", "NOCHMAL, SONST AUFTAUCHEN: SERVICE"),
}
KEYS = frozenset(_ENGLISH)

_ENDED = re.compile(r"Main process exited, code=(\w+), status=(\S+)")
_SYSTEMD = re.compile(r"^(kingfisher[\w.-]*\.service: |(Started|Starting|Stopped|Stopping|Failed to start) kingfisher)")
"""What systemd itself says of the service; all else is the program's."""


def cause(last_words: Path, unit: str, journal: Sequence[str]) -> Cause:
    """``unit``: whose failure it was; ``journal``: what was said of the service in this boot, the oldest first."""
    if unit.endswith(".mount"):
        return Cause("disk", f"{unit} failed")
    said = _last_words(last_words)
    if said is not None:
        return said
    ended = [found for line in journal if (found := _ENDED.search(line))]
    own = [line for line in journal if line.strip() and not _SYSTEMD.match(line)]
    detail = own[-1] if own else "the journal says nothing"
    if any("Watchdog timeout" in line for line in journal[-60:]):
        where = [line.strip() for line in own if line.strip().startswith('File "')]
        return Cause("hang", re.sub(r'File ".*/site-packages/', 'in "', where[0]) if where else detail)
    killed = [line for line in journal[-20:] if "oom" in line.lower()]
    if killed:
        return Cause("memory", killed[-1])
    if not ended:
        return Cause("unknown", detail)
    code, status = ended[-1].groups()
    if code in ("killed", "dumped"):
        return Cause("killed", f"by signal {status}; {detail}")
    if status.partition("/")[0] in ("203", "200", "209", "238"):  # systemd could not even start it
        return Cause("missing", f"{status}; {detail}")
    return Cause("program", detail)


def notice(why: Cause, language: str, next_try_s: int | None) -> Notice:
    """The page's words. ``next_try_s``: until it is tried again without a key; ``None``: it is not."""
    if language == "de":
        words = _GERMAN[why.key]
        by_itself = "" if next_try_s is None else f"\nVON SELBST IN {next_try_s} S"
        return Notice(
            "SERVICE NÖTIG", words.headline, words.action, why.detail, "GESPEICHERTE SCANS SIND DA",
            f"TASTE SCAN: NOCHMAL STARTEN{by_itself}\nBACK HALTEN: AUSSCHALTEN?",
        )  # fmt: skip
    words = _ENGLISH[why.key]
    by_itself = "" if next_try_s is None else f"\nBY ITSELF IN {next_try_s} S"
    return Notice(
        "SERVICE NEEDED", words.headline, words.action, why.detail, "SAVED SCANS ARE SAFE",
        f"KEY SCAN: START AGAIN{by_itself}\nHOLD BACK: POWER OFF?",
    )  # fmt: skip


def question(language: str, off_selected: bool) -> Notice:
    """The page that asks whether to switch off, with the answer marked that is selected."""
    stay, off = ("- ", "> ") if off_selected else ("> ", "- ")
    if language == "de":
        return Notice(
            "AUSSCHALTEN?", f"{stay}ANBLEIBEN", f"{off}AUSSCHALTEN", "", "",
            "UP, DOWN: AUSWÄHLEN\nSCAN: OK, BACK: ANBLEIBEN",
        )  # fmt: skip
    return Notice(
        "POWER OFF?", f"{stay}STAY ON", f"{off}SWITCH OFF", "", "", "UP, DOWN: SELECT\nSCAN: OK, BACK: STAY ON"
    )


SHIPPED_KEYS = (0x1209, 0x4B46)


@dataclass(frozen=True, slots=True)
class Outputs:
    """What of the rig file the safe screen needs; ``None`` where it cannot be read."""

    cards: tuple[str, ...] = ("/dev/dri/card0", "/dev/dri/card1")
    display: str | None = None
    projector: str | None = None
    board: str = "/dev/kingfisher-board"
    language: str = "en"
    keys: tuple[int, int] = SHIPPED_KEYS
    """USB vendor and product of the key pad."""


def outputs(rig: Path) -> Outputs:
    """Read leniently: the rig file may be what is wrong."""
    try:
        content: Mapping[str, Any] = tomllib.loads(rig.read_text(encoding="utf-8-sig"))
        display, projector = content["display"], content["projector"]
        cards = dict.fromkeys(str(part["card"]) for part in (display, projector))
        return Outputs(
            tuple(cards),
            str(display["connector"]),
            str(projector["connector"]),
            str(content["board"]["url"]),
            str(display.get("language", "en")),
            _keys(content.get("keys")),
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return Outputs()


def _keys(table: object) -> tuple[int, int]:
    """Identity of the key pad; the shipped one where the table names none: the outputs are wanted all the same."""
    if isinstance(table, dict):
        vendor, product = table.get("vendor_id"), table.get("product_id")
        if isinstance(vendor, int) and isinstance(product, int):
            return vendor, product
    return SHIPPED_KEYS


def _last_words(path: Path) -> Cause | None:
    try:
        with path.open("rb") as file:
            content = json.loads(file.read(1 << 16))
        key = str(content["kind"])
        return Cause(key if key in KEYS else "program", str(content["text"]))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
