"""A bench in values: a clock that moves when somebody waits, a board, a pad and a bench that say what the test wants."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from appliance.cli.simrig import default_sim_rig
from appliance.store.config import Rig, load_rig
from appliance.workshop import projector
from appliance.workshop.bench import Image, Shot
from appliance.workshop.finding import Finding
from appliance.workshop.guide import judge_together
from appliance.workshop.projector import ProjectorMeasurement
from appliance.workshop.step import Workplace
from appliance.workshop.steps import STEPS
from drivers.api import BoardEvent, BoardTime, KeyEvent, LaserState, Vsync
from tests.drivers.clock import SteppedClock
from tests.support.told import Told

RIG_FILE = default_sim_rig().with_name("small.toml")
PERIOD_NS = 1e9 / 60.0
BOARD_LATER_NS = 400_000_000
"""The host's clock shows this much more than the board's."""


@dataclass
class AskedPerson:
    """Whoever stands at the bench; keeps what was said."""

    said: list[str] = field(default_factory=list)
    hand: Callable[[str], None] = lambda _what: None

    def tell(self, what: str) -> None:
        self.said.append(what)
        self.hand(what)

    ask = tell


def workplace(
    clock: SteppedClock | None = None, rig: Rig | None = None, rig_file: Path = RIG_FILE, minutes: float = 0.05
) -> tuple[Workplace, AskedPerson, Told]:
    """A workplace whose wires are a clock alone."""
    person, told = AskedPerson(), Told()
    wires: Any = SimpleNamespace(clock=SteppedClock() if clock is None else clock)
    return Workplace(rig or load_rig(rig_file), wires, person, told, minutes, 540.0), person, told


def named(findings: Sequence[Finding]) -> dict[str, Finding]:
    return {one.name: one for one in findings}


def projector_findings(found: ProjectorMeasurement) -> dict[str, Finding]:
    outcomes = judge_together(STEPS, projector.measure_on_wall, found, load_rig())
    return named(projector.outcomes_in_order(outcomes.values())[1])


class TimedEvents:
    def __init__(self, clock: SteppedClock) -> None:
        self.clock = clock
        self._waiting: list[tuple[int, int, Any]] = []
        self._count = 0

    def at_s(self, time_s: float, event: Any) -> None:
        self._count += 1
        heapq.heappush(self._waiting, (self.clock.now_ns() + round(time_s * 1e9), self._count, event))

    def next(self, timeout_s: float) -> Any:
        until_ns = self.clock.now_ns() + round(timeout_s * 1e9)
        if self._waiting and self._waiting[0][0] <= until_ns:
            time_ns, _, event = heapq.heappop(self._waiting)
            self.clock.advance_s(max(0, time_ns - self.clock.now_ns()) / 1e9)
            return event
        self.clock.advance_s(timeout_s)
        return None


class BenchBoard:
    """``drivers.api.Board`` with a vertical sync of 60 Hz, until it goes dark."""

    def __init__(self, clock: SteppedClock) -> None:
        self.clock = clock
        self.events = TimedEvents(clock)
        self.commands: list[tuple[Any, ...]] = []
        self.when: Callable[[tuple[Any, ...]], None] = lambda _command: None
        """Takes each command."""
        self.dark_from_ns: int | None = None
        self.late_us: Mapping[int, int] = {}
        """How late some answers to ``vsync`` are dated, by their place in order."""
        self._asked = 0
        self.info = SimpleNamespace(firmware="1.4", serial="KF-B-1", capabilities=frozenset({"SUPPLY"}))
        self.counters = SimpleNamespace(lost_reports=0, damaged_lines=0)
        self.lag_s = 0.0
        """Time that the read-back of a laser needs to follow."""
        self._switched: tuple[int, LaserState, LaserState] = (0, LaserState(False, False), LaserState(False, False))
        self.lit: Callable[[LaserState], LaserState] = lambda wanted: wanted

    def _said(self, *command: Any) -> None:
        self.commands.append(command)
        self.when(command)

    def vsync(self) -> Vsync:
        now_ns = self.clock.now_ns()
        self._said("vsync")
        seen_ns = now_ns if self.dark_from_ns is None else min(now_ns, self.dark_from_ns)
        count, late_us = int(seen_ns / PERIOD_NS), self.late_us.get(self._asked, 0)
        self._asked += 1
        synced_us, read_us = (round((ns - BOARD_LATER_NS) / 1000.0) for ns in (count * PERIOD_NS, now_ns))
        return Vsync(count, synced_us + late_us, read_us, now_ns - 50_000, now_ns + 50_000)

    def read_clock(self) -> BoardTime:
        self._said("clock")
        now_ns = self.clock.now_ns()
        return BoardTime((now_ns - BOARD_LATER_NS) // 1000, now_ns, now_ns)

    def arm(self, pulses: int, at_vsync: int, delay_us: int, width_us: int) -> None:
        self._said("arm", pulses, at_vsync, delay_us, width_us)

    def live(self, every: int, delay_us: int, width_us: int) -> None:
        self._said("live", every, delay_us, width_us)

    def stop(self) -> None:
        self._said("stop")

    def set_lasers(self, left_on: bool, right_on: bool) -> LaserState:
        self._said("lasers", left_on, right_on)
        since_ns, before, state = self._switched
        wanted = LaserState(left_on, right_on)
        now_ns = self.clock.now_ns()
        if wanted != state:
            since_ns, before, state = self._switched = (now_ns, state, wanted)
        return self.lit(before if now_ns - since_ns < self.lag_s * 1e9 else state)

    def next_event(self, timeout_s: float) -> BoardEvent | None:
        event: BoardEvent | None = self.events.next(timeout_s)
        return event


class BenchPad:
    def __init__(self, clock: SteppedClock) -> None:
        self.events = TimedEvents(clock)
        self.counters = SimpleNamespace(lost_reports=1, garbage_reports=2)

    def next_event(self, timeout_s: float) -> KeyEvent | None:
        event: KeyEvent | None = self.events.next(timeout_s)
        return event


@dataclass
class ValueBench:
    """``appliance.workshop.bench.LightBench`` that sees what ``seen`` says, by side, exposure and number of the take."""

    seen: Callable[[str, Shot, int], Image]
    size_px: tuple[int, int] = (64, 48)
    refresh_hz: float = 60.0
    clock: SteppedClock | None = None
    take_s: float = 0.0
    loaded: list[tuple[list[Image], bool]] = field(default_factory=list)
    taken: list[tuple[list[int], Shot]] = field(default_factory=list)

    def load(self, pictures: Sequence[Image], *, all_channels: bool) -> None:
        self.loaded.append(([one.copy() for one in pictures], all_channels))

    def record(self, order: Sequence[int], shot: Shot) -> Any:
        self.taken.append((list(order), shot))
        if self.clock is not None:
            self.clock.advance_s(self.take_s)
        return SimpleNamespace(fault=None, ledger=None)

    def take(self, order: Sequence[int], shot: Shot) -> Mapping[str, Image]:
        self.record(order, shot)
        return {side: self.frames(side, len(order)) for side in ("left", "right")}

    def frames(self, side: str, count: int) -> Image:
        return np.asarray(self.seen(side, self.taken[-1][1], len(self.taken)), np.uint8)[:count]
