"""Owns the state in which a camera comes out of its box, and the manners in which cameras of other makers differ.

A polite camera is set up for whoever triggers it on the rising edge. Others wake up with automatic exposure, on the
falling edge, with the last user's region, name a feature otherwise, round a size without saying so, or still send what
an earlier stream left in their memory. A ``personality`` is a whole camera in the manner of a maker (``makers.py``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from hw_sim.devices.features import Value
from hw_sim.devices.makers import MAKERS, Maker, check_saved

CHOICES = {
    "acquisition_mode": {"Continuous": 0, "SingleFrame": 1, "MultiFrame": 2},
    "trigger_activation": {"RisingEdge": 0, "FallingEdge": 1},
    "trigger_source": {"Line0": 0, "Software": 8},
    "exposure_mode": {"Timed": 1, "TriggerWidth": 2},
    "exposure_auto": {"Off": 0, "Continuous": 2},
    "gain_auto": {"Off": 0, "Continuous": 2},
}
"""The registers' values of the standard's words."""
USUAL = "usual"
LEAST_TRANSFER_BYTES = 4096
OF_THE_USUAL = (*CHOICES, "offset_x_px", "offset_y_px", "width_step_px")
"""Options that describe the usual camera; of a personality ``saved`` says the same."""


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
    personality: str = USUAL
    """The usual camera, or one of ``MAKERS``."""
    saved: Mapping[str, Value] = field(default_factory=dict)
    """Values of features that a personality wakes up with, instead of the factory's: its owner saved them once. Of one
    instance only: ``TriggerMode[FrameStart]``."""
    needs_lock: bool = False
    """A personality refuses to start while TLParamsLocked is 0."""
    left_halted: bool = False
    """A program before left the stream's endpoint halted: it must be halted anew before clearing it helps."""
    largest_transfer_bytes: int | None = None
    """A longer transfer of the stream fails; ``None``: none does."""
    memory_blocks: int = 32
    """Number of frames that the camera keeps for a host that does not read; the next is lost."""

    def __post_init__(self) -> None:
        if self.personality not in (USUAL, *MAKERS):
            raise ValueError(f"personality '{self.personality}'; allowed are {', '.join((USUAL, *MAKERS))}")
        if self.personality == USUAL:
            if self.saved or self.needs_lock:
                raise ValueError("saved and needs_lock are for a personality; name one")
        else:
            check_saved(MAKERS[self.personality], self.saved)
            plain = {f.name: f.default for f in fields(self) if f.name in OF_THE_USUAL}
            for name, value in plain.items():
                if getattr(self, name) != value:
                    raise ValueError(f"{name} is for the usual camera; give '{self.personality}' a feature in saved")
        if self.largest_transfer_bytes is not None and self.largest_transfer_bytes < LEAST_TRANSFER_BYTES:
            raise ValueError(
                f"largest_transfer_bytes {self.largest_transfer_bytes}; allowed are {LEAST_TRANSFER_BYTES} and more"
            )
        if not 1 <= self.memory_blocks <= 1000:
            raise ValueError(f"memory_blocks {self.memory_blocks}; allowed are 1..1000")
        for name, words in CHOICES.items():
            if getattr(self, name) not in words:
                raise ValueError(f"{name} '{getattr(self, name)}'; allowed are {', '.join(words)}")
        if self.offset_x_px % 8 or self.offset_y_px % 2 or min(self.offset_x_px, self.offset_y_px) < 0:
            raise ValueError("offset_x_px and offset_y_px begin at 0, in steps of 8 and 2")
        if self.width_step_px < 0 or self.width_step_px % 8:
            raise ValueError(f"width_step_px {self.width_step_px}; allowed are 0 and multiples of 8")

    @property
    def maker(self) -> Maker | None:
        """The maker's camera; ``None`` for the usual one."""
        return MAKERS.get(self.personality)

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
