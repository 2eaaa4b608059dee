"""The registry of the existing worlds by name, for URLs in rig files and for a second set of wires.

It is the one piece of process-wide state, since pyserial knows a port only by its URL.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hw_sim.world import World

_LOCK = threading.Lock()
_WORLDS: dict[str, World] = {}


def register(name: str, world: World) -> None:
    """Register ``world`` under ``name``. Raises ValueError if that name is in use."""
    with _LOCK:
        if name in _WORLDS:
            raise ValueError(f"there is already a world named '{name}'; give the new one another name")
        _WORLDS[name] = world


def unregister(name: str, world: World) -> None:
    """Remove ``world``, if it is registered under ``name``."""
    with _LOCK:
        # A later world may have the name by now.
        if _WORLDS.get(name) is world:
            del _WORLDS[name]


def find(name: str) -> World | None:
    """Return the world of that name, ``None`` if there is none."""
    with _LOCK:
        return _WORLDS.get(name)
