"""Owns what the rig file may say about finding the board."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class BoardSpec:
    """The board of the rig. ``url`` is a device path or any URL that pyserial resolves."""

    url: str
    name: str = "board"
