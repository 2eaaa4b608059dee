"""Conversion of a person's real time to world time: a key is held as long in the world as on the keyboard.

A world may be slower than real time while images are made. A press then happens now, but its end keeps its distance to
its beginning, and quick changes keep theirs to each other: a long press remains one, a tap remains a tap.
"""

from __future__ import annotations

GAP_NS = 100_000_000
"""Longer real pauses between two presses need not be preserved."""


class Fingers:
    """The world times of the keyboard's changes; all times in ns, real ones monotonic."""

    def __init__(self) -> None:
        self._pressed: dict[str, tuple[int, int]] = {}
        self._last: tuple[int, int] | None = None

    def at(self, key: str, down: bool, real_ns: int, now_ns: int) -> int:
        """Return the world time of a change that came at ``real_ns``; ``now_ns``: the present world time."""
        world_ns = now_ns
        if self._last is not None:
            last_real_ns, last_world_ns = self._last
            world_ns = max(world_ns, last_world_ns + min(real_ns - last_real_ns, GAP_NS))
        if down:
            self._pressed[key] = (real_ns, world_ns)
        elif key in self._pressed:
            pressed_real_ns, pressed_world_ns = self._pressed.pop(key)
            # A hold keeps its length, as a long press has another meaning.
            world_ns = max(world_ns, pressed_world_ns + real_ns - pressed_real_ns)
        self._last = (real_ns, world_ns)
        return world_ns
