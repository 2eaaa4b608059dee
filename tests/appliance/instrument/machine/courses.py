"""Owns the rows of tables: from a start, by events, to facts that the diver or the log would notice, each by its name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from appliance.instrument.machine import effects as do
from appliance.instrument.machine import events as on
from appliance.instrument.machine.leading import alerts, in_full
from appliance.instrument.machine.states import Machine
from appliance.instrument.machine.step import step
from appliance.measure.fault import Fault, FaultCode
from drivers.api import Key, KeyLongPress, KeyPress, Telemetry
from tests.appliance.instrument.machine.walks import SECOND_NS, heartbeat, labels

Then = on.Event | Callable[[Machine], on.Event]
"""An event, or what makes one of the moment at which it comes."""
SCAN, BACK, UP, DOWN = (KeyPress(key, 0) for key in (Key.SCAN, Key.BACK, Key.UP, Key.DOWN))
HOLD_DOWN = (DOWN, KeyLongPress(Key.DOWN, 0))
LEAK = (heartbeat(leak=True), heartbeat(leak=True))
EIO = Fault(FaultCode.NOT_SAVED, "EIO")
STOP = on.StopRequested()


def wait(seconds: float) -> Callable[[Machine], on.Event]:
    return lambda machine: on.Tick(machine.now_ns + round(seconds * SECOND_NS))


def raised(code: FaultCode, detail: str = "", device: str | None = None, **numbers: float) -> on.ConditionRaised:
    return on.ConditionRaised(Fault(code, detail, numbers, device))


def warm(case_c: float, projector_c: float | None = 20.0) -> Telemetry:
    return heartbeat(temperature_case_c=case_c, temperature_projector_c=projector_c)


def full(machine: Machine) -> str | None:
    """The headline that is shown in full."""
    alert = in_full(alerts(machine))
    return None if alert is None else alert.headline


def marks(machine: Machine) -> list[str]:
    return [alert.headline for alert in alerts(machine) if alert.is_acknowledged]


def codes(machine: Machine) -> list[FaultCode]:
    return [alert.code for alert in alerts(machine)]


def shown(machine: Machine) -> list[tuple[str, str]]:
    return [(alert.headline, alert.action) for alert in alerts(machine)]


LOOKS: dict[str, Callable[[Machine], object]] = {
    "full": full,
    "marks": marks,
    "codes": codes,
    "shown": shown,
    "first": lambda machine: next(iter(shown(machine)), None),
    "labels": labels,
    "asked": lambda machine: machine.off_question is not None,
    "task": lambda machine: machine.calibrating and (machine.calibrating.step, machine.calibrating.task),
    "latest": lambda machine: machine.calibrating and machine.calibrating.latest,
    "failed": lambda machine: machine.calibrating and machine.calibrating.failed,
    "cloud": lambda machine: machine.scan and machine.scan.full,
    "publishing": lambda machine: machine.scan and machine.scan.publishing,
    "looked_at": lambda machine: machine.gallery and machine.gallery.scan_id,
} | {f"on_{key.value}": lambda machine, key=key: labels(machine).get(key) for key in Key}


def course(name: str, start: Callable[[], Machine], *events: Then, **facts: Any) -> Any:
    """Return a row. ``effects`` are those of the last event, ``among`` and ``never`` one and a kind of all events' effects; other
    facts are of the machine as it is then."""
    return pytest.param(start, events, facts, id=name)


def seen(start: Callable[[], Machine], events: tuple[Then, ...], facts: dict[str, Any]) -> dict[str, Any]:
    machine, every = start(), list[do.Effect]()
    last: tuple[do.Effect, ...] = ()
    for event in events:
        machine, last = step(machine, event(machine) if callable(event) else event)
        every += last
    found: dict[str, Any] = {}
    for name, wanted in facts.items():
        match name:
            case "effects":
                found[name] = list(last)
            case "among":
                there = all(one in every for one in (wanted if isinstance(wanted, tuple) else (wanted,)))
                found[name] = wanted if there else every
            case "never":
                unwanted = wanted if isinstance(wanted, tuple) else (wanted,)
                came = (one if isinstance(one, do.Wish) else type(one) for one in every)
                found[name] = every if any(one in unwanted for one in came) else wanted
            case _:
                found[name] = LOOKS[name](machine) if name in LOOKS else getattr(machine, name)
    return found
