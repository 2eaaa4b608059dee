"""Dive in world time without images: decisions of the machine and temperatures of the housing, coupled."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from appliance.instrument.machine import effects as do
from appliance.instrument.machine import events as on
from appliance.instrument.machine.states import Device, Machine, Part, PartResult, State, boot
from appliance.instrument.machine.step import step
from appliance.measure.cloud import CloudSummary
from drivers.api import Key, KeyPress, LaserState, Telemetry
from hw_sim.heat import Housing, Powers
from tests.support import news

TICK_S = 0.5
"""Heartbeat of the trigger board, and time step of the dive."""
SAMPLE_S = 10.0
AIM_S, LOOK_S = 25.0, 6.0
"""A diver looks for the place so long, and at the cloud."""
SUMMARY = CloudSummary(1000, coverage_percent=80.0, distance_mm=500.0, noise_mm=0.03, gap_mm=0.02)


@dataclass(frozen=True, slots=True)
class Sample:
    """One moment of a dive."""

    minute: float
    case_c: float
    projector_c: float
    camera_c: float
    lit: bool
    state: State


@dataclass(slots=True)
class Dive:
    """One dive, from power-on. ``sensors`` False: no temperature is known to the machine. ``policy`` False: for comparison,
    the light of the live views never rests."""

    outside_c: float
    medium: str = "water"
    sensors: bool = True
    policy: bool = True
    samples: list[Sample] = field(default_factory=list)
    scans: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    light_s: float = 0.0
    machine: Machine = field(init=False)
    housing: Housing = field(init=False)
    _lit: bool = False
    _lasers: bool = False
    _streams: bool = False
    _now_s: float = 0.0

    def __post_init__(self) -> None:
        self.housing = Housing(self.outside_c, self.medium)
        self.machine = boot(0)
        for device in Device:
            self.say(on.DeviceUp(device))
        self.say(on.BootFinished(), *(PartResult(part, True) for part in Part), on.StorageCounted(0, None, 500))

    @property
    def over(self) -> bool:
        """It switched itself off."""
        return self.machine.state is State.SHUTDOWN

    def say(self, *events: on.Event) -> None:
        """Send events to the machine, and apply its effects on the light."""
        for event in events:
            self.machine, effects = step(self.machine, event)
            for effect in effects:
                self._do(effect)

    def wait(self, duration_s: float) -> None:
        """Advance the time."""
        end_s = self._now_s + duration_s
        while self._now_s < end_s and not self.over:
            if not self.policy and self.machine.state is State.AIM:
                self._lit = True
            self._now_s += TICK_S
            self.light_s += TICK_S if self._lit else 0.0
            self.housing.advance(TICK_S, Powers(self._lit, self._streams, self._lasers))
            now_ns = round(self._now_s * 1e9)
            self.say(on.Tick(now_ns), self._telemetry(now_ns))
            if not self.samples or self._now_s - 60.0 * self.samples[-1].minute >= SAMPLE_S:
                self._sample()

    def scan(self) -> bool:
        """Run one scan from aiming to keeping; return True if it was saved."""
        self.wait(AIM_S)
        number = self.machine.captures + 1
        self.say(KeyPress(Key.SCAN, 0))
        if self.machine.state is not State.ARMED:
            self.refused[self.machine.state.value] += 1
            return False
        self.wait(TICK_S)
        self.say(on.Armed(number))
        self._lit = True
        self.wait(TICK_S)
        self._lit = False
        self.say(on.CaptureFinished(number), on.RawStored(number), news.right(number))
        self.wait(TICK_S)
        self.say(news.coarse(number, SUMMARY), news.full(number, SUMMARY))
        self.wait(LOOK_S)
        self.say(KeyPress(Key.SCAN, 0))
        self.wait(TICK_S)
        self.scans += 1
        self.say(on.Saved(number, f"{self.scans:06d}"), on.StorageCounted(self.scans, f"{self.scans:06d}", 500))
        return True

    def _do(self, effect: do.Effect) -> None:
        match effect:
            case do.GoLive(light, lasers):
                self._lit, self._lasers, self._streams = light, lasers, True
            case do.Wish.DARK:
                self._lit = self._lasers = self._streams = False
            case _:
                pass

    def _telemetry(self, now_ns: int) -> Telemetry:
        lasers = LaserState(self._lasers, self._lasers)
        if not self.sensors:
            return Telemetry(now_ns, now_ns // 1000, 0, lasers)
        case_c, projector_c = (round(self.housing.temperature_c(place), 1) for place in ("TCASE", "TPROJ"))
        return Telemetry(now_ns, now_ns // 1000, 0, lasers, projector_c, case_c, self.housing.temperature_c("TBOARD"))

    def _sample(self) -> None:
        case_c, projector_c, camera_c = (self.housing.temperature_c(place) for place in ("TCASE", "TPROJ", "camera"))
        self.samples.append(Sample(self._now_s / 60.0, case_c, projector_c, camera_c, self._lit, self.machine.state))


def dive_of(scans: int, water_c: float, sensors: bool = True) -> Dive:
    """Simulate a dive of ``scans`` scans, one after the other; a refused one is repeated after the next aiming."""
    dive = Dive(water_c, sensors=sensors)
    while dive.scans < scans and not dive.over and sum(dive.refused.values()) < 10 * scans:
        dive.scan()
    return dive


def boat_then_dive(scans: int, air_c: float, water_c: float, minutes: float, policy: bool = True) -> Dive:
    """Simulate an instrument that is switched on and forgotten on deck, then used under water."""
    dive = Dive(air_c, "air", policy=policy)
    dive.wait(60.0 * minutes)
    dive.housing.medium, dive.housing.outside_c, dive.policy = "water", water_c, True
    while dive.scans < scans and not dive.over and sum(dive.refused.values()) < 10 * scans:
        dive.scan()
    return dive
