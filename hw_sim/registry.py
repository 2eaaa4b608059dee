"""Owns the names of the worlds that exist: how an URL in a rig file, or a second set of wires, finds one.

The one piece of state that belongs to the process, because pyserial knows a port by nothing but its URL.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hw_sim.world import World

_LOCK = threading.Lock()
_WORLDS: dict[str, World] = {}


def register(name: str, world: World) -> None:
    """Register ``world`` under ``name``. Raises ValueError if there is one of that name."""
    with _LOCK:
        if name in _WORLDS:
            raise ValueError(f"there is already a world named '{name}'; give the new one another name")
        _WORLDS[name] = world


def unregister(name: str, world: World) -> None:
    """Forget ``world``, if it is the one of that name."""
    with _LOCK:
        # A later world may have the name by now.
        if _WORLDS.get(name) is world:
            del _WORLDS[name]


def find(name: str) -> World | None:
    """Return the world of that name, ``None`` if there is none."""
    with _LOCK:
        return _WORLDS.get(name)
