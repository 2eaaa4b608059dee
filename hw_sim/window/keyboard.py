"""The keyboard's keys for each key of the pad, and the state of the pad's keys."""

from __future__ import annotations

from dataclasses import dataclass

QUIT = "quit"
MEANING = {
    "s": "scan",
    "enter": "scan",
    "b": "back",
    "backspace": "back",
    "up": "up",
    "down": "down",
    "q": QUIT,
    "escape": QUIT,
}
"""Name of a key (a letter as the layout has it) → key of the pad, or the end."""
HELP = "S, Enter: scan/OK    B, Backspace: back    ↑ ↓    Q, Esc: quit"


@dataclass(frozen=True, slots=True)
class PadChange:
    """A key of the pad is pressed or released."""

    key: str
    down: bool


class Keyboard:
    """The pressed keys: two with the same meaning hold one key of the pad, until the last is released."""

    def __init__(self) -> None:
        self._held: dict[str, set[str]] = {}

    def change(self, name: str, down: bool) -> PadChange | None:
        """Return the pad's change for one of the keyboard's key ``name``; ``None`` without one, as for ``quit``."""
        key = MEANING.get(name, QUIT)
        if key == QUIT:
            return None
        held = self._held.setdefault(key, set())
        before = bool(held)
        if down:
            held.add(name)
        else:
            held.discard(name)
        return PadChange(key, down) if bool(held) != before else None
