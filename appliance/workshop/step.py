"""A step of the guided bring-up: its inputs, the workplace where it is done, and its outcome."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from appliance.base import Progress
from appliance.store import Rig
from appliance.workshop.finding import Finding
from appliance.workshop.rig_edit import KeyValue, Value
from drivers.api import DeviceError, Wires

MOST_ASKED = 3
"""Largest number of times that the operator is asked for the same action; then the state is judged as it is."""


class GivenUp(Exception):
    """Exception when the operator gives up or is absent: the guide ends, and finished steps stay finished."""


class Person(Protocol):
    """The operator at the instrument. Implemented by the command line."""

    def tell(self, what: str) -> None:
        """Show the next action without waiting for an answer: the software sees for itself when it is done."""

    def ask(self, what: str) -> None:
        """Show the next action and wait until the operator says that it is done. Raises GivenUp."""


def numbered_request(what: str, attempt: int) -> str:
    """Return a request for the ``attempt``-th time, from 0: repeated ones say that it did not help."""
    return what if attempt == 0 else f"{what} (attempt {attempt + 1} of {MOST_ASKED}: not detected)"


@dataclass(frozen=True, slots=True)
class Workplace:
    """The means of a step. Its creator holds the instrument's lock."""

    rig: Rig
    wires: Wires
    person: Person
    say: Progress
    minutes: float
    """Length of the endurance run."""
    plane_mm: float
    """Distance at which a plane is to stand."""


def wall(workplace: Workplace) -> str:
    """Return the request to place the instrument for measurements with its light."""
    return (
        "take the caps off and stand the instrument still before something white and flat, "
        f"{workplace.plane_mm:.0f} mm away and upright, that fills both images"
    )


def refusal(error: DeviceError) -> Finding:
    """Return the finding for a device that is missing or refuses."""
    return Finding(error.device, False, error.message, "present, and as in the rig file", error.remedy)


@dataclass(frozen=True, slots=True)
class StepOutcome:
    """Findings of one step, and its tables and pictures for the page."""

    findings: tuple[Finding, ...]
    tables: Mapping[str, tuple[Mapping[str, Any], ...]] = field(default_factory=dict)
    """Tables for the page by title: rows with the same keys, JSON-ready."""
    pictures: Mapping[str, tuple[str, bytes]] = field(default_factory=dict)
    """Pictures for the page, caption and PNG, by the name of their file."""
    keys: Mapping[KeyValue, Value] = field(default_factory=dict)
    """Keys of the rig file that follow from it; they are written once all steps of the same measurement are good."""

    @property
    def good(self) -> bool:
        """True if there are findings and every one is good."""
        return bool(self.findings) and all(finding.ok for finding in self.findings)


def outcome_itself(outcome: StepOutcome, _rig: Rig) -> StepOutcome:
    """Return the outcome of a step whose ``do`` also judges."""
    return outcome


@dataclass(frozen=True, slots=True)
class GuideStep:
    """One step of the guide: a row in ``appliance.workshop.steps``, and a module that does and judges it."""

    name: str
    title: str
    needs: tuple[str, ...]
    """Steps that must be good before."""
    uses: tuple[str, ...]
    """Tables and keys of the rig file that it depends on."""
    do: Callable[[Workplace], Any]
    """Works with the devices.

    Steps with the same one are done together, from one measurement. Raises DeviceError, BringupError, GivenUp.
    """
    judge: Callable[[Any, Rig], StepOutcome] = outcome_itself
    """Judges the result of ``do``."""
    uses_written: bool = False
    """True if it depends on the keys that the guide itself writes, too."""
    writes: tuple[str, ...] = ()
    """Keys that it may write."""


def inputs_of(content: Mapping[str, Any], step: GuideStep, steps: Sequence[GuideStep]) -> dict[str, Any]:
    """Return the keys of a rig file's ``content`` that a step depends on, by dotted name.

    Keys that one of all the ``steps`` writes do not invalidate earlier steps.
    """
    written = {key for other_step in steps for key in other_step.writes}
    # The raw content: if a later version changes a default, this file has not changed.
    return {
        name: value
        for name, value in _flatten(content, "")
        if any(name == use or name.startswith(f"{use}.") for use in step.uses)
        and (step.uses_written or name not in written)
    }


def _flatten(content: Mapping[str, Any], prefix: str) -> list[tuple[str, Any]]:
    items: list[tuple[str, Any]] = []
    for key, value in content.items():
        name = f"{prefix}{key}"
        items += _flatten(value, f"{name}.") if isinstance(value, Mapping) else [(name, value)]
    return items
