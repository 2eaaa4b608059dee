"""Owns which findings of a measured projector belong to which step of the guide, and what each step shows of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from appliance.bringup.conclusions import conclusions
from appliance.bringup.guide import OF_THE_PROJECTOR, StepOutcome
from appliance.bringup.page import pictures_of, trials_of
from appliance.bringup.projector import ProjectorMeasured
from appliance.bringup.rig_edit import KeyValue

STEP_OF = {
    "orientation": "raster",
    "raster": "raster",
    "sides": "sides",
    "latency": "latency",
    "light": "light",
    "grey": "light",
    "skew": "skew",
}
"""Step that each finding belongs to."""
_PICTURES = {"raster": ("checker", "marker"), "light": ("light", "grey")}
"""Beginnings of the names of the pictures that each step shows."""


def projector_outcomes(
    measured: ProjectorMeasured, refresh_hz: float, written: Mapping[KeyValue, Any]
) -> dict[str, StepOutcome]:
    """Return the outcome of each step that is read from one measurement; ``written`` are the keys that went into the rig file."""
    findings = conclusions(measured, refresh_hz)
    pictures = pictures_of(measured, 1e6 / refresh_hz)
    outcomes = {}
    for step in OF_THE_PROJECTOR:
        shown = {name: one for name, one in pictures.items() if name.startswith(_PICTURES.get(step, ()))}
        tables = {}
        if step == "light" and measured.responses:
            tables["Every exposure that was tried"] = tuple(trials_of(measured))
        outcomes[step] = StepOutcome(
            tuple(one for one in findings if STEP_OF[one.name] == step),
            tables,
            shown,
            written if step == "light" else {},
        )
    return outcomes
