"""Owns the walk through the twelve steps: which is next, what is kept of each, and what ends it."""

from __future__ import annotations

import platform
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import appliance
from appliance.bringup.finding import BringupError, Finding
from appliance.bringup.guide import NAMES, OF_THE_PROJECTOR, STEPS, GuideStep, StepOutcome, inputs_of, step_of
from appliance.bringup.guide_state import GuideState, StepRecord
from appliance.bringup.person import GivenUp, Person
from appliance.config import Rig, load_rig
from appliance.service.bringup.board import board_step
from appliance.service.bringup.cameras import cameras_step
from appliance.service.bringup.endurance import endurance_step
from appliance.service.bringup.folder import GuideFolder, checksum
from appliance.service.bringup.pad import pad_step
from appliance.service.bringup.plane import plane_step
from appliance.service.bringup.projector import projector_steps
from appliance.service.bringup.trigger import trigger_step
from appliance.service.bringup.vsync import vsync_step
from appliance.service.bringup.workplace import Say, Workplace, refusal
from appliance.service.checkup import whatever_is_there
from appliance.storage.lock import hold_lock
from drivers import rig as drivers_rig
from drivers.api import DeviceError, Wires

_ALONE: Mapping[str, Callable[[Workplace], StepOutcome]] = {
    "board": board_step,
    "pad": pad_step,
    "vsync": vsync_step,
    "cameras": cameras_step,
    "trigger": trigger_step,
    "endurance": endurance_step,
    "plane": plane_step,
}
"""Recordings of the steps that have a measurement of their own."""


@dataclass(frozen=True, slots=True)
class GuideOptions:
    """Wishes for one call of the guide."""

    only: tuple[str, ...] = ()
    """Steps to be done and no others; empty: on from the first that is not good."""
    again: tuple[str, ...] = ()
    """Steps to be done although they are good."""
    minutes: float = 10.0
    """Length of the endurance run."""
    plane_mm: float | None = None
    """Distance of the plane; ``None``: the rig file's working distance."""


@dataclass(frozen=True, slots=True)
class Walked:
    """Outcome of one call."""

    good: bool
    """Every step that was asked for is good; without ``only``: all twelve are."""
    steps: Mapping[str, StepRecord]
    """Everything that is known now, by step, in their order."""
    done: tuple[str, ...]
    """Steps that this call did."""
    written: tuple[Path, ...]
    stopped: str | None = None
    """Reason why the guide ended before its end; ``None``: it did not, or a step's findings say it."""


def walk(
    rig_file: Path,
    folder: Path,
    options: GuideOptions,
    person: Person,
    say: Say,
    told: Callable[[str, StepRecord], None],
) -> Walked:
    """Walk the steps from where the last call ended, and stop at the first that is not good.

    ``told`` is called with each step that was done. State and page are written after each: whatever interrupts it, the next call
    goes on. Raises ConfigError, StorageError (also where an instrument is running), DeviceError without wires, BringupError for
    a damaged state.
    """
    rig = load_rig(rig_file)
    place = GuideFolder(folder)
    with (
        hold_lock(rig.storage.root),
        drivers_rig.open_wires(rig.rig.wires, rig.rig.wires_options) as wires,
    ):
        place.prepare()
        state = replace(place.read(), rig_file=str(rig_file), about=_about(rig, wires))
        return _Walk(rig_file, place, options, wires, person, say, told, state, _outcomes).walk()


@dataclass(slots=True)
class _Walk:
    """One call of the guide."""

    rig_file: Path
    place: GuideFolder
    options: GuideOptions
    wires: Wires
    person: Person
    say: Say
    told: Callable[[str, StepRecord], None]
    state: GuideState
    outcomes: Callable[[GuideStep, Workplace], Mapping[str, StepOutcome]]
    done: list[str] = field(default_factory=list)
    written: dict[Path, None] = field(default_factory=dict)

    def walk(self) -> Walked:
        stopped: str | None = None
        try:
            for step in self._wanted():
                missing = [name for name in step.needs if not self._stands(step_of(name))]
                if missing:
                    stopped = (
                        f"step {step.name} needs {', '.join(missing)}, which {_is_not_good(missing)}; do that first"
                    )
                    break
                self._do(step)
                if not self._stands(step):
                    break
        except GivenUp as error:
            stopped = str(error)
        self._keep()
        asked = [step_of(name) for name in self.options.only] or STEPS
        good = stopped is None and all(self._stands(step) for step in asked)
        steps = {name: self.state.steps[name] for name in NAMES if name in self.state.steps}
        return Walked(good, steps, tuple(self.done), tuple(self.written), stopped)

    def _wanted(self) -> Iterator[GuideStep]:
        """Yield what is to be done, each once, in the order of the guide."""
        for step in STEPS:
            # Here and not before: what stands is asked anew after each step that may have changed the rig file.
            if self.options.only and step.name not in self.options.only:
                continue
            anew = step.name in self.options.again or step.name in self.options.only
            # Steps of one measurement are done together: the first of them does it for all.
            if step.name not in self.done and (anew or not self._stands(step)):
                yield step

    def _do(self, step: GuideStep) -> None:
        at = self._workplace()
        begun_ns = self.wires.clock.now_ns()
        outcomes = self.outcomes(step, at)
        duration_s = (self.wires.clock.now_ns() - begun_ns) / 1e9
        # Read again: the step may have written keys, and rests on the file as it is now.
        content = tomllib.loads(self._rig_text())
        when = self.wires.calendar.today().utc.isoformat(timespec="seconds")
        for name, outcome in outcomes.items():
            self.written |= dict.fromkeys(self.place.keep(outcome))
            record = StepRecord.of(outcome, when, duration_s, inputs_of(content, step_of(name)))
            self.state = self.state.with_step(name, record)
            self.done.append(name)
        # Kept before it is told: whoever sees it and switches off has it.
        self._keep()
        for name in outcomes:
            self.told(name, self.state.steps[name])

    def _workplace(self) -> Workplace:
        rig = load_rig(self.rig_file)
        plane_mm = self.options.plane_mm or rig.volume.working_mm
        return Workplace(rig, self.rig_file, self.wires, self.person, self.say, self.options.minutes, plane_mm)

    def _keep(self) -> None:
        text = self._rig_text()
        self.state = replace(self.state, rig_sha256=checksum(text))
        self.written |= dict.fromkeys(self.place.write(self.state, text))

    def _stands(self, step: GuideStep) -> bool:
        return self.state.stands(step, tomllib.loads(self._rig_text()))

    def _rig_text(self) -> str:
        return self.rig_file.read_text(encoding="utf-8-sig")


def _outcomes(step: GuideStep, at: Workplace) -> dict[str, StepOutcome]:
    """Do a step, and those that are read from the same measurement; what ends it early is a finding like any other. Raises GivenUp."""
    try:
        # One measurement for five steps: each by itself would take two minutes again.
        if step.name in OF_THE_PROJECTOR:
            return projector_steps(at)
        return {step.name: _ALONE[step.name](at)}
    except DeviceError as error:
        return {step.name: StepOutcome((refusal(error),))}
    except BringupError as error:
        said, _, remedy = str(error).partition("; ")
        return {step.name: StepOutcome((Finding("measurement", False, said, "", remedy or "see the findings before"),))}


def _is_not_good(names: Sequence[str]) -> str:
    return "is not good" if len(names) == 1 else "are not good"


def _about(rig: Rig, wires: Wires) -> dict[str, tuple[str, ...]]:
    """Return versions, and what is on the buses now."""
    there = whatever_is_there(rig, wires)
    versions = (
        f"kingfisher {appliance.__version__}",
        f"Python {platform.python_version()}",
        f"{platform.system()} {platform.release()} ({platform.machine()})",
        f"instrument {rig.rig.name}, {rig.rig.serial}",
    )
    return {
        "Versions": versions,
        "Cameras on the buses": there.cameras,
        "Serial ports": there.ports,
        "HID devices": there.hid,
        "Video": there.connectors,
    }
