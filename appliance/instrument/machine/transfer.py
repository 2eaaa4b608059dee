"""Owns what the instrument knows of the transfer of scans to a desk: whether it is served, where, and for how many
keys.

The diver switches it with the menu's TRANSFER (``Choices.transfer``); another program serves, and tells.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Serving(Enum):
    """States of the program that serves."""

    STARTING = "starting"
    """It was asked for and has not told anything yet."""
    ON = "on"
    FAILED = "failed"
    """It cannot serve; the journal says why."""


@dataclass(frozen=True, slots=True)
class Transfer:
    """The transfer as the program that serves tells it."""

    serving: Serving = Serving.STARTING
    address: str | None = None
    """Address to type at the desk; ``None``: no cable, or none was given yet."""
    keys: int | None = None
    """Number of keys that are enrolled; ``None``: not known."""


NOT_TOLD = Transfer()
"""The transfer as it is known before anything was told."""
