"""Owns the twelve steps of the guided bring-up: their order, what each needs, and which keys of the rig file it uses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from appliance.bringup.finding import Finding
from appliance.bringup.rig_edit import KeyValue

_LIGHT_PATH = ("rig.wires", "camera", "board.url", "projector")
MEASURED = frozenset(
    {
        "projector.latency_blanks",
        "projector.light_begins_us",
        "projector.channels",
        "projector.sub_frames",
        "board.trigger_delay_us",
        "scan.exposures_ms",
        "camera.left.exposure_ms",
        "camera.right.exposure_ms",
    }
)
"""Keys that the guide itself finds and writes: steps before that are not done again because of them."""


@dataclass(frozen=True, slots=True)
class GuideStep:
    """One step of the guide."""

    name: str
    title: str
    needs: tuple[str, ...]
    """Steps that must be good before."""
    uses: tuple[str, ...]
    """Tables and keys of the rig file that it depends on."""
    after_light: bool = False
    """True if it depends on the keys that the guide finds, too."""


STEPS = (
    GuideStep(
        "board", "The trigger board alone", (), ("rig.wires", "board.url", "board.firmware", "limits.supply_low_v")
    ),
    GuideStep("pad", "The key pad", (), ("rig.wires", "keys")),
    GuideStep("vsync", "The projector's vertical sync", ("board",), ("rig.wires", "board.url", "projector")),
    GuideStep("cameras", "Both cameras", ("board", "vsync"), _LIGHT_PATH),
    GuideStep("trigger", "The trigger lines", ("board", "vsync", "cameras"), _LIGHT_PATH),
    GuideStep("raster", "The projector's raster", ("trigger",), _LIGHT_PATH),
    GuideStep("sides", "Left and right", ("trigger",), _LIGHT_PATH),
    GuideStep("latency", "The projector's latency", ("trigger",), _LIGHT_PATH),
    GuideStep("light", "Light within the frame", ("trigger",), (*_LIGHT_PATH, "board", "scan"), after_light=True),
    GuideStep("skew", "Both cameras at once", ("trigger",), _LIGHT_PATH),
    GuideStep("endurance", "Minutes at full rate", ("trigger",), (*_LIGHT_PATH, "limits")),
    GuideStep(
        "plane",
        "The first plane",
        ("raster", "sides", "latency", "light"),
        (*_LIGHT_PATH, "board", "scan"),
        after_light=True,
    ),
)
"""Steps in the order in which they are walked."""
NAMES = tuple(step.name for step in STEPS)
OF_THE_PROJECTOR = ("raster", "sides", "latency", "light", "skew")
"""Steps that are read from one measurement of the projector."""


@dataclass(frozen=True, slots=True)
class StepOutcome:
    """Findings of one step, and what the page shows of it."""

    findings: tuple[Finding, ...]
    tables: Mapping[str, tuple[Mapping[str, Any], ...]] = field(default_factory=dict)
    """Tables for the page by title: rows with the same keys, JSON-ready."""
    pictures: Mapping[str, tuple[str, bytes]] = field(default_factory=dict)
    """Pictures for the page, caption and PNG, by the name of their file."""
    written: Mapping[KeyValue, Any] = field(default_factory=dict)
    """Keys that were written into the rig file."""

    @property
    def good(self) -> bool:
        """True if every finding is good; a step that found nothing is not."""
        return bool(self.findings) and all(one.ok for one in self.findings)


def step_of(name: str) -> GuideStep:
    """Return a step by its name. Raises ValueError where there is none."""
    return STEPS[NAMES.index(name)]


def inputs_of(content: Mapping[str, Any], step: GuideStep) -> dict[str, Any]:
    """Return the keys of a rig file's ``content`` that a step depends on, by dotted name, with their values."""
    # Raw, as it is written: a default that a later version changes is no change of this file.
    flat = dict(_flattened(content, ""))
    return {
        name: value
        for name, value in flat.items()
        if any(name == use or name.startswith(f"{use}.") for use in step.uses)
        and (step.after_light or name not in MEASURED)
    }


def changed(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Return the names of keys whose values differ, came or went."""
    return sorted(name for name in before.keys() | now.keys() if before.get(name) != now.get(name))


def _flattened(content: Mapping[str, Any], prefix: str) -> list[tuple[str, Any]]:
    found: list[tuple[str, Any]] = []
    for key, value in content.items():
        name = f"{prefix}{key}"
        # Lists as they come back from JSON, so that what was kept compares equal.
        found += _flattened(value, f"{name}.") if isinstance(value, Mapping) else [(name, value)]
    return found
