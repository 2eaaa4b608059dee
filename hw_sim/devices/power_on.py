"""The power-on state of a camera, and behaviours in which cameras of other makers differ.

The usual camera is set up for triggers on the rising edge. Others start with automatic exposure, on the falling edge,
with the last user's region, name a feature differently, round a size silently, or still send blocks of an earlier
stream from their memory. A ``personality`` is a complete camera of a maker (``makers.py``).
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
"""Register values of the standard's names."""
USUAL = "usual"
LEAST_TRANSFER_BYTES = 4096
OF_THE_USUAL = (*CHOICES, "offset_x_px", "offset_y_px", "width_step_px")
"""Options of the usual camera; a personality has ``saved`` instead."""


@dataclass(frozen=True, slots=True)
class PowerOn:
    """The power-on state of a camera. Raises ValueError for an unknown value."""

    acquisition_mode: str = "Continuous"
    trigger_activation: str = "RisingEdge"
    trigger_source: str = "Line0"
    exposure_mode: str = "Timed"
    exposure_auto: str = "Off"
    gain_auto: str = "Off"
    offset_x_px: int = 0
    offset_y_px: int = 0
    """Start of the region, which is smaller by as much."""
    lacks: tuple[str, ...] = ()
    """Features with a maker's name in the description."""
    width_step_px: int = 0
    """A width between two steps is rounded down silently; 0: the camera refuses it instead."""
    keeps_stale: bool = False
    """Blocks that were not read when a stream ended are sent when the next begins."""
    personality: str = USUAL
    """The usual camera, or one of ``MAKERS``."""
    saved: Mapping[str, Value] = field(default_factory=dict)
    """Feature values that the owner of a personality saved in place of the factory's. One instance is written
    ``TriggerMode[FrameStart]``."""
    needs_lock: bool = False
    """A personality refuses to start while TLParamsLocked is 0."""
    left_halted: bool = False
    """An earlier program left the stream's endpoint halted: it must be halted again before clearing works."""
    largest_transfer_bytes: int | None = None
    """Largest transfer of the stream that does not fail; ``None``: no limit."""
    memory_blocks: int = 32
    """Number of frames that the camera stores for a host that does not read; the next is lost."""

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
        for name, allowed in CHOICES.items():
            if getattr(self, name) not in allowed:
                raise ValueError(f"{name} '{getattr(self, name)}'; allowed are {', '.join(allowed)}")
        if self.offset_x_px % 8 or self.offset_y_px % 2 or min(self.offset_x_px, self.offset_y_px) < 0:
            raise ValueError("offset_x_px and offset_y_px begin at 0, in steps of 8 and 2")
        if self.width_step_px < 0 or self.width_step_px % 8:
            raise ValueError(f"width_step_px {self.width_step_px}; allowed are 0 and multiples of 8")

    @property
    def maker(self) -> Maker | None:
        """The maker's camera; ``None`` for the usual one."""
        return MAKERS.get(self.personality)

    def register(self, name: str) -> int:
        """Return the register value of a choice."""
        return CHOICES[name][str(getattr(self, name))]


POLITE = PowerOn()


@dataclass(frozen=True, slots=True)
class Cameras:
    """The power-on states of the two cameras, from a table of ``PowerOn`` values."""

    left: Mapping[str, Any] = field(default_factory=dict)
    right: Mapping[str, Any] = field(default_factory=dict)

    def of(self, side: str) -> Mapping[str, Any]:
        """Return the table of one camera."""
        table: Mapping[str, Any] = getattr(self, side)
        return table
