"""The walk through the steps of the guided bring-up, which keeps a record of each."""

from __future__ import annotations

import hashlib
import platform
import tomllib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import appliance
from appliance.base import Progress
from appliance.instrument import connected_devices
from appliance.store import Rig, hold_lock, load_rig
from appliance.workshop import steps
from appliance.workshop.bench import light_bench
from appliance.workshop.finding import BringupError, Finding
from appliance.workshop.kept import PAGE, STATE, STATE_FILE, GuideFolder, GuideState, StepRecord
from appliance.workshop.light import LightTiming
from appliance.workshop.page import guide_page, outcomes_page
from appliance.workshop.projector import PROJECTOR_PAGE, measure_on_wall, measure_projector, outcomes_in_order
from appliance.workshop.rig_edit import KeyValue, Value, replace_rig, with_keys
from appliance.workshop.step import GivenUp, GuideStep, Person, StepOutcome, Workplace, inputs_of, refusal
from drivers import rig as drivers_rig
from drivers.api import DeviceError, Wires


@dataclass(frozen=True, slots=True)
class GuideOptions:
    """Options of one call of the guide."""

    only: tuple[str, ...] = ()
    """The only steps to do, even if they are good; empty: continue from the first that is not good."""
    minutes: float = 10.0
    """Length of the endurance run."""
    plane_mm: float | None = None
    """Distance of the plane; ``None``: the rig file's working distance."""


@dataclass(frozen=True, slots=True)
class GuideResult:
    """Result of one call of the guide."""

    good: bool
    """True if every step of ``only`` is good; without ``only``: if all steps are."""
    steps: Mapping[str, StepRecord]
    """Records by step, in their order."""
    done: tuple[str, ...]
    """Steps that this call did."""
    written: tuple[Path, ...]
    stopped: str | None = None
    """Reason why the guide ended early; ``None``: it did not, or a step's findings have the reason."""


def walk(
    rig_file: Path,
    folder: Path,
    options: GuideOptions,
    person: Person,
    say: Progress,
    on_step: Callable[[str, StepRecord], None],
) -> GuideResult:
    """Walk the steps from where the last call ended, and stop at the first that is not good.

    ``on_step`` is called with each finished step. State and page are written after each, so that the next call
    continues after any interruption. Raises ConfigError, StorageError (also where an instrument is running),
    DeviceError without wires, BringupError for a damaged state.
    """
    rig = load_rig(rig_file)
    place = GuideFolder(folder)
    with (
        hold_lock(rig.storage.root),
        drivers_rig.open_wires(rig.rig.wires, rig.rig.wires_options) as wires,
    ):
        place.prepare()
        state = replace(place.read(), rig_file=str(rig_file), about=_about(rig, wires))
        return _Walk(rig_file, place, options, wires, person, say, on_step, state, steps.STEPS).walk()


@dataclass(slots=True)
class _Walk:
    """One call of the guide."""

    rig_file: Path
    place: GuideFolder
    options: GuideOptions
    wires: Wires
    person: Person
    say: Progress
    on_step: Callable[[str, StepRecord], None]
    state: GuideState
    steps: Sequence[GuideStep]
    done: list[str] = field(default_factory=list)
    written: dict[Path, None] = field(default_factory=dict)

    def walk(self) -> GuideResult:
        stopped: str | None = None
        by_name = {step.name: step for step in self.steps}
        try:
            for step in self._wanted():
                missing = [name for name in step.needs if not self._stands(by_name[name])]
                if missing:
                    verb = "is not good" if len(missing) == 1 else "are not good"
                    stopped = f"step {step.name} needs {', '.join(missing)}, which {verb}; do that first"
                    break
                self._do(step)
                if not self._stands(step):
                    break
        except GivenUp as error:
            stopped = str(error)
        self._keep()
        requested = [by_name[name] for name in self.options.only] or self.steps
        good = stopped is None and all(self._stands(step) for step in requested)
        return GuideResult(good, self.state.steps, tuple(self.done), tuple(self.written), stopped)

    def _wanted(self) -> Iterator[GuideStep]:
        """Yield the steps to do, each once, in the order of the guide."""
        for step in self.steps:
            # In the loop, not before it: each step may have changed the rig file on which others rest.
            if self.options.only and step.name not in self.options.only:
                continue
            # Steps of one measurement are done together by the first of them.
            if step.name not in self.done and (self.options.only or not self._stands(step)):
                yield step

    def _do(self, step: GuideStep) -> None:
        start_ns = self.wires.clock.now_ns()
        outcomes = self._outcomes(step)
        duration_s = (self.wires.clock.now_ns() - start_ns) / 1e9
        when = self.wires.calendar.today().utc.isoformat(timespec="seconds")
        for done_step, outcome in outcomes.items():
            self._write({name: png for name, (_, png) in outcome.pictures.items()})
            # Read again: the step may have written keys, and rests on the file as it is now.
            record = StepRecord.of(outcome, when, duration_s, self._inputs(done_step))
            self.state = replace(self.state, steps={**self.state.steps, done_step.name: record})
            self.done.append(done_step.name)
        # Stored before it is shown: if the operator switches off then, it is not lost.
        self._keep()
        for done_step in outcomes:
            self.on_step(done_step.name, self.state.steps[done_step.name])

    def _outcomes(self, step: GuideStep) -> dict[GuideStep, StepOutcome]:
        """Do a step, and those of the same measurement; an error that ends it early becomes a finding.

        Raises GivenUp, StorageError.
        """
        rig = load_rig(self.rig_file)
        plane_mm = self.options.plane_mm or rig.volume.working_mm
        workplace = Workplace(rig, self.wires, self.person, self.say, self.options.minutes, plane_mm)
        # Before minutes of measuring, so that an unreadable file is reported first.
        text = self._rig_text()
        try:
            outcomes = judge_together(self.steps, step.do, step.do(workplace), rig)
            keys = keys_of(outcomes.values())
            new = with_keys(text, keys) if keys else text
        except DeviceError as error:
            return {step: StepOutcome((refusal(error),))}
        except BringupError as error:
            statement, _, remedy = str(error).partition("; ")
            finding = Finding("measurement", False, statement, "", remedy or "see the findings above")
            return {step: StepOutcome((finding,))}
        if new != text:
            replace_rig(self.rig_file, text, new)
        return {
            outcome_step: outcome if keys else replace(outcome, keys={}) for outcome_step, outcome in outcomes.items()
        }

    def _keep(self) -> None:
        """Write state and page, the state first, since the next call starts from it."""
        text, records = self._rig_text(), self.state.steps
        in_order = {step.name: records[step.name] for step in self.steps if step.name in records}
        self.state = replace(self.state, rig_sha256=hashlib.sha256(text.encode()).hexdigest(), steps=in_order)
        page = guide_page(self.state, self.steps, text, self.place.pictures(self.state))
        self._write({STATE: STATE_FILE.encode(self.state), PAGE: page.encode()})

    def _write(self, files: Mapping[str, bytes]) -> None:
        self.written |= dict.fromkeys(self.place.write(files))

    def _stands(self, step: GuideStep) -> bool:
        return is_current(self.state, step, self._inputs(step))

    def _inputs(self, step: GuideStep) -> dict[str, Any]:
        return inputs_of(tomllib.loads(self._rig_text()), step, self.steps)

    def _rig_text(self) -> str:
        return self.rig_file.read_text(encoding="utf-8-sig")


def is_current(state: GuideState, step: GuideStep, inputs: Mapping[str, Any]) -> bool:
    """Return True if a step was good, and the keys of the rig file that it rests on have not changed."""
    record = state.steps.get(step.name)
    return record is not None and record.good and record.inputs == inputs


def judge_together(
    steps: Sequence[GuideStep], do: Callable[[Workplace], Any], result: Any, rig: Rig
) -> dict[GuideStep, StepOutcome]:
    """Return the outcome of each step that shares the measurement ``do``, from its result."""
    return {step: step.judge(result, rig) for step in steps if step.do == do}


def keys_of(outcomes: Collection[StepOutcome]) -> dict[KeyValue, Value]:
    """Return the keys of the rig file that follow from one measurement: all or none.

    A mirrored picture's latency would be right, but after its correction the projector is measured again.
    """
    if not all(outcome.good for outcome in outcomes):
        return {}
    return {place: value for outcome in outcomes for place, value in outcome.keys.items()}


@dataclass(frozen=True, slots=True)
class ProjectorReport:
    """Result of measuring a projector outside of the guide."""

    findings: tuple[Finding, ...]
    timing: LightTiming
    keys: Mapping[KeyValue, Value]
    """Keys of the rig file that follow from it, all or none."""
    rig_text: str
    """The rig file with them."""
    files: Mapping[str, bytes]
    """The page, and the pictures in it, by name."""


def projector_report(rig: Rig, rig_text: str, say: Progress) -> ProjectorReport:
    """Measure the projector of ``rig`` on a white wall before the instrument.

    ``rig_text``: of its rig file; empty: it is not to be changed. Raises DeviceError, BringupError, StorageError.
    """
    with light_bench(rig) as bench:
        measured = measure_projector(bench, rig.scan.most_gain_db, say)
    outcomes, findings = outcomes_in_order(judge_together(steps.STEPS, measure_on_wall, measured, rig).values())
    keys = keys_of(outcomes)
    page = outcomes_page("Kingfisher: the projector, as its own cameras see it", findings, outcomes)
    pictures = {name: data for outcome in outcomes for name, (_, data) in outcome.pictures.items()}
    return ProjectorReport(
        tuple(findings),
        measured.lamp.timing,
        keys,
        with_keys(rig_text, keys) if keys and rig_text else rig_text,
        {PROJECTOR_PAGE: page.encode(), **pictures},
    )


def _about(rig: Rig, wires: Wires) -> dict[str, tuple[str, ...]]:
    """Return versions, and the devices that are on the buses now."""
    inventory = connected_devices(rig, wires)
    versions = (
        f"kingfisher {appliance.__version__}",
        f"Python {platform.python_version()}",
        f"{platform.system()} {platform.release()} ({platform.machine()})",
        f"instrument {rig.rig.name}, {rig.rig.serial}",
    )
    return {
        "Versions": versions,
        "Cameras on the buses": inventory.cameras,
        "Serial ports": inventory.ports,
        "HID devices": inventory.hid,
        "Video": inventory.connectors,
    }
