"""The description of an output in the rig file."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class OutputKind(Enum):
    KMS = "kms"
    """A connector of a graphics card, driven without a window system."""
    WINDOW = "window"
    """A window (or, by the name of a monitor, a full screen) on a desk."""


@dataclass(frozen=True, slots=True)
class OutputSpec:
    """One output as the rig file describes it.

    ``card`` and ``connector`` are needed for KMS (``/dev/dri/card0``, ``HDMI-A-1``). For a window ``card`` is
    ignored, and ``connector`` may name a monitor, which the window then fills.
    """

    kind: OutputKind
    card: str | None
    connector: str | None
    width_px: int
    height_px: int
    refresh_hz: float
    all_channels: bool = False
    """True: a projector's frames are drawn into red, green and blue alike; False: into green alone."""
