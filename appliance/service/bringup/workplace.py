"""Owns what every step of the guide works with: the rig, its wires, and whoever stands at the instrument."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from appliance.bringup.finding import Finding
from appliance.bringup.person import Person
from appliance.config import Rig
from drivers.api import DeviceError, Wires

Say = Callable[[str, float | None], None]


@dataclass(frozen=True, slots=True)
class Workplace:
    """Everything that a step works with. The instrument's lock is held by whoever made it."""

    rig: Rig
    rig_file: Path
    wires: Wires
    person: Person
    say: Say
    """Takes what is being done, and how much of it (0..1; ``None``: not known)."""
    minutes: float
    """Length of the endurance run."""
    plane_mm: float
    """Distance at which a plane is to stand."""


def refusal(error: DeviceError) -> Finding:
    """Return the finding that a device which is missing or refuses makes of a step."""
    return Finding(error.device, False, error.message, "there, and as the rig file states it", error.remedy)
