"""Owns the safe screen's course: dark, say what is wrong, wait for a key or the time, end so that what was wanted comes."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from kingfisher_safe import devices
from kingfisher_safe.cause import Cause, cause, notice, outputs, question
from kingfisher_safe.page import Picture, draw
from kingfisher_safe.panel import Console, KernelNode, Node, Panel

RIG = Path("/etc/kingfisher/rig.toml")
LAST_WORDS = Path("/run/kingfisher/last-words.json")
SERVICE = "kingfisher.service"
WAITS_S = (30, 120, 600)
"""Before each try without a key, as long as the machine is on; then only the key starts it."""
POWER_OFF = 3
"""The exit code that kingfisher-safe.service knows."""
ASK_OFF_S = 20.0
"""How long the question whether to switch off waits; without an answer it stays on."""
LOOK_S = 1.0
"""How often the time is counted down, and displays are looked for."""
JOURNAL = ("journalctl", "-b", "-u", SERVICE, "-n", "200", "-o", "cat", "--no-pager", "-q")


class Tries:
    """How often the service was started without a key since power-on; a file in memory."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / "tries.json"

    def wait_s(self) -> int | None:
        """Until the next one; ``None``: no more."""
        made = self._made()
        return WAITS_S[made] if made < len(WAITS_S) else None

    def count(self) -> None:
        with contextlib.suppress(OSError):
            self._file.write_text(json.dumps(self._made() + 1))

    def _made(self) -> int:
        try:
            made = json.loads(self._file.read_text())
        except (OSError, ValueError):
            return 0
        return made if isinstance(made, int) and made >= 0 else 0


class Screens:
    """Whatever can show a page: the cards of the rig, else the kernel's console. Looks again as long as nothing can."""

    def __init__(
        self, cards: Sequence[str], display: str | None, projector: str | None,
        open_card: Callable[[Path], Node] = KernelNode, open_console: Callable[[], Console] = Console,
    ) -> None:  # fmt: skip
        self._cards = [Path(card) for card in cards]
        self._display, self._projector = display, projector
        self._open_card, self._open_console = open_card, open_console
        self._panels: dict[Path, Panel] = {}
        self._console: Console | None = None

    def show(self, page: Callable[[int, int], Picture]) -> tuple[str, ...]:
        """Where it is shown now; never raises for what is not there."""
        shown: tuple[str, ...] = ()
        for path in self._cards:
            try:
                if path not in self._panels:
                    self._panels[path] = Panel(self._open_card(path))
                shown += self._panels[path].show(page, self._display, self._projector)
            except OSError:
                self._close(path)
        if shown:
            return shown
        try:
            self._console = self._console or self._open_console()
            self._console.show(page)
        except OSError:
            return ()
        return ("console",)

    def close(self) -> None:
        for path in list(self._panels):
            self._close(path)
        if self._console is not None:
            self._console.close()

    def _close(self, path: Path) -> None:
        panel = self._panels.pop(path, None)
        if panel is not None:
            with contextlib.suppress(OSError):
                panel.close()


def journal() -> list[str]:
    """What was said of the service since power-on; nothing, where it may not be read."""
    try:
        done = subprocess.run(JOURNAL, capture_output=True, text=True, errors="replace", timeout=20, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return []
    return done.stdout.splitlines()


def stay(why: Cause, screens: Screens, language: str, tries: Tries, keys: devices.Keys) -> str:
    """Show the page until a key wants something or the time has come; returns which: ``start``, ``off`` or ``time``.

    BACK held asks whether to switch off, with STAY ON selected: DOWN and UP select, SCAN takes, BACK stays on.
    """
    wait_s = tries.wait_s()
    end_s = None if wait_s is None else time.monotonic() + wait_s
    asked_until_s, off_selected = 0.0, False
    where: tuple[str, ...] | None = None
    while True:
        asking = time.monotonic() < asked_until_s
        left_s = None if end_s is None else max(0, round(end_s - time.monotonic()))
        words = question(language, off_selected) if asking else notice(why, language, left_s)
        shown = screens.show(partial(draw, words))
        if shown != where:
            where = shown
            _say(f"{why.key}: {why.detail}; shown on {', '.join(shown) or 'nothing: no display'}")
        match keys.pressed(LOOK_S):
            case "hold" if not asking:
                asked_until_s, off_selected = time.monotonic() + ASK_OFF_S, False
            case "scan" if asking and off_selected:
                return "off"
            case "scan" if not asking:
                return "start"
            case "scan" | "back" if asking:
                asked_until_s = 0.0
            case "up" | "down" as key if asking:
                off_selected = key == "down"
            case _:
                pass
        if end_s is not None and time.monotonic() >= max(end_s, asked_until_s):
            tries.count()
            return "time"


def main(environment: Mapping[str, str] = os.environ) -> int:
    """Returns 0 when the service is to be started again, ``POWER_OFF`` when the machine is to be switched off."""
    rig = outputs(RIG)
    if not devices.lights_off(Path(rig.board)):
        _say("the board did not confirm that lasers are off")
    why = cause(LAST_WORDS, environment.get("MONITOR_UNIT", SERVICE), journal())
    screens = Screens(rig.cards, rig.display, rig.projector)
    keys = devices.Keys(partial(devices.find_keys, rig.keys))
    try:
        asked = stay(why, screens, rig.language, Tries(Path(environment.get("RUNTIME_DIRECTORY", "/run"))), keys)
    finally:
        screens.close()
        keys.close()
    if asked == "off":
        _say("switching off, asked for by the key")
        return POWER_OFF
    _say(f"starting the service again, asked for by the {'key' if asked == 'start' else asked}")
    return 0


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
