"""Owns what a step of the guided bring-up is: what it rests on, what it works with, how it is done, and what comes of
it."""

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
"""Times that one thing is asked for; then it is judged as it is."""


class GivenUp(Exception):
    """The person gave up, or nobody is there: the guide ends, and what was done stays done."""


class Person(Protocol):
    """Whoever stands at the instrument. Implemented by the command line."""

    def tell(self, what: str) -> None:
        """Say what is to be done now. No answer is waited for: the software sees for itself when it was done."""

    def ask(self, what: str) -> None:
        """Say what is to be done now and wait until the person says that it was. Raises GivenUp."""


def numbered(what: str, turn: int) -> str:
    """Return a wish for the ``turn``-th time, from 0: the last ones say that it did not help."""
    return what if turn == 0 else f"{what} (asked again, {turn + 1} of {MOST_ASKED}: it was not seen)"


@dataclass(frozen=True, slots=True)
class Workplace:
    """Everything that a step works with. The instrument's lock is held by whoever made it."""

    rig: Rig
    wires: Wires
    person: Person
    say: Progress
    minutes: float
    """Length of the endurance run."""
    plane_mm: float
    """Distance at which a plane is to stand."""


def wall(at: Workplace) -> str:
    """Return where the instrument is to stand for everything that is measured with its light."""
    return (
        "take the caps off and stand the instrument still before something white and flat, "
        f"{at.plane_mm:.0f} mm away and upright, that fills both images"
    )


def refusal(error: DeviceError) -> Finding:
    """Return the finding that a device which is missing or refuses makes of a step."""
    return Finding(error.device, False, error.message, "there, and as the rig file states it", error.remedy)


@dataclass(frozen=True, slots=True)
class StepOutcome:
    """Findings of one step, and what the page shows of it."""

    findings: tuple[Finding, ...]
    tables: Mapping[str, tuple[Mapping[str, Any], ...]] = field(default_factory=dict)
    """Tables for the page by title: rows with the same keys, JSON-ready."""
    pictures: Mapping[str, tuple[str, bytes]] = field(default_factory=dict)
    """Pictures for the page, caption and PNG, by the name of their file."""
    keys: Mapping[KeyValue, Value] = field(default_factory=dict)
    """Keys of the rig file that follow from it; they are written once everything of the same measurement is good."""

    @property
    def good(self) -> bool:
        """True if every finding is good; a step that found nothing is not."""
        return bool(self.findings) and all(one.ok for one in self.findings)


def outcome_itself(found: StepOutcome, _rig: Rig) -> StepOutcome:
    """Return the outcome of a step whose ``do`` judges what it finds."""
    return found


@dataclass(frozen=True, slots=True)
class GuideStep:
    """One step of the guide: a row in ``appliance.workshop.steps``, and a module that knows how it is done and judged."""

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
    """Judges what ``do`` returned."""
    uses_written: bool = False
    """True if it depends on the keys that the guide itself writes, too."""
    writes: tuple[str, ...] = ()
    """Keys that it may write."""


def inputs_of(content: Mapping[str, Any], step: GuideStep, steps: Sequence[GuideStep]) -> dict[str, Any]:
    """Return the keys of a rig file's ``content`` that a step depends on, by dotted name, with their values.

    Keys that one of all the ``steps`` writes undo no step before that.
    """
    written = {key for one in steps for key in one.writes}
    # Raw, as it is written: a default that a later version changes is no change of this file.
    return {
        name: value
        for name, value in _flattened(content, "")
        if any(name == use or name.startswith(f"{use}.") for use in step.uses)
        and (step.uses_written or name not in written)
    }


def _flattened(content: Mapping[str, Any], prefix: str) -> list[tuple[str, Any]]:
    found: list[tuple[str, Any]] = []
    for key, value in content.items():
        name = f"{prefix}{key}"
        found += _flattened(value, f"{name}.") if isinstance(value, Mapping) else [(name, value)]
    return found
