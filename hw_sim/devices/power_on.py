"""Owns the state in which a camera comes out of its box, and the manners in which cameras of other makers differ.

A polite camera is set up for whoever triggers it on the rising edge. Others wake up with automatic exposure, on the
falling edge, with the last user's region, name a feature otherwise, round a size without saying so, or still send what
an earlier stream left in their memory.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

CHOICES = {
    "acquisition_mode": {"Continuous": 0, "SingleFrame": 1, "MultiFrame": 2},
    "trigger_activation": {"RisingEdge": 0, "FallingEdge": 1},
    "trigger_source": {"Line0": 0, "Software": 8},
    "exposure_mode": {"Timed": 1, "TriggerWidth": 2},
    "exposure_auto": {"Off": 0, "Continuous": 2},
    "gain_auto": {"Off": 0, "Continuous": 2},
}
"""The registers' values of the standard's words."""


@dataclass(frozen=True, slots=True)
class PowerOn:
    """The state of a camera before anybody has set it. Raises ValueError for a word that no camera knows."""

    acquisition_mode: str = "Continuous"
    trigger_activation: str = "RisingEdge"
    trigger_source: str = "Line0"
    exposure_mode: str = "Timed"
    exposure_auto: str = "Off"
    gain_auto: str = "Off"
    offset_x_px: int = 0
    offset_y_px: int = 0
    """The region begins there; it is smaller by as much."""
    lacks: tuple[str, ...] = ()
    """Features that the description calls by a name of the maker's own."""
    width_step_px: int = 0
    """A width between two steps is rounded down, unsaid; 0: the camera refuses it instead."""
    keeps_stale: bool = False
    """Blocks that were not read when a stream ended are sent when the next begins."""

    def __post_init__(self) -> None:
        for name, words in CHOICES.items():
            if getattr(self, name) not in words:
                raise ValueError(f"{name} '{getattr(self, name)}'; allowed are {', '.join(words)}")
        if self.offset_x_px % 8 or self.offset_y_px % 2 or min(self.offset_x_px, self.offset_y_px) < 0:
            raise ValueError("offset_x_px and offset_y_px begin at 0, in steps of 8 and 2")
        if self.width_step_px < 0 or self.width_step_px % 8:
            raise ValueError(f"width_step_px {self.width_step_px}; allowed are 0 and multiples of 8")

    def register(self, name: str) -> int:
        """The value of a choice as its register holds it."""
        return CHOICES[name][str(getattr(self, name))]


POLITE = PowerOn()


@dataclass(frozen=True, slots=True)
class Cameras:
    """The power-on states of the two cameras, from a table of ``PowerOn`` values."""

    left: Mapping[str, Any] = field(default_factory=dict)
    right: Mapping[str, Any] = field(default_factory=dict)

    def of(self, side: str) -> Mapping[str, Any]:
        """The table of one camera."""
        table: Mapping[str, Any] = getattr(self, side)
        return table
