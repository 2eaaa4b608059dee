"""The meaning of the board's reports and answers: sentences in, values of ``drivers.api`` out.

Source: ``docs/protocols/board.md``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

from drivers.api import BoardBooted, BoardEvent, LaserState, Pulse, PulsesDone, Telemetry, VsyncLost
from drivers.board.line import MalformedLine, Sentence, parse_uint

MAX_COUNT = 0xFFFF_FFFF
"""Vertical syncs are counted in 32 bit."""
MAX_TIME_US = 0xFFFF_FFFF_FFFF_FFFF
"""The board's clock has 64 bit."""
MAX_PULSES = 64

_MISSING = "-"


class Refusal(IntEnum):
    """Codes of a refusal."""

    UNKNOWN_VERB = 1
    OUT_OF_RANGE = 2
    BUSY = 3
    NO_VSYNC = 4
    PAST = 5


@dataclass(frozen=True, slots=True)
class BoardInfo:
    """Answer to INFO: ``capabilities`` names the sensors that are fitted."""

    firmware: str
    serial: str
    capabilities: frozenset[str]


def _need(sentence: Sentence, field_count: int) -> tuple[str, ...]:
    if len(sentence.fields) < field_count:
        raise MalformedLine(f"{sentence.verb} with {len(sentence.fields)} fields, expected {field_count}")
    return sentence.fields


def _on(text: str) -> bool:
    return parse_uint(text, 1) == 1


def parse_report(sentence: Sentence, received_ns: int) -> BoardEvent | None:
    """Return the event of a report; ``None`` for a verb that this version does not know.

    Raises MalformedLine.
    """
    match sentence.verb:
        case "PULSE":
            k, vsync, time_us = _need(sentence, 3)[:3]
            return Pulse(parse_uint(k, MAX_PULSES - 1), parse_uint(vsync, MAX_COUNT), parse_uint(time_us, MAX_TIME_US))
        case "DONE":
            return PulsesDone(parse_uint(_need(sentence, 1)[0], MAX_PULSES))
        case "NOSYNC":
            return VsyncLost()
        case "HB":
            return _parse_heartbeat(sentence, received_ns)
        case "BOOT":
            firmware, serial, cause = _need(sentence, 3)[:3]
            return BoardBooted(firmware, serial, cause)
        case _:
            return None


def _parse_heartbeat(sentence: Sentence, received_ns: int) -> Telemetry:
    time_us, vsync, left, right = _need(sentence, 4)[:4]
    sensors = parse_sensors(sentence.fields[4:])
    leak = sensors.get("LEAK")
    return Telemetry(
        received_ns=received_ns,
        board_time_us=parse_uint(time_us, MAX_TIME_US),
        vsync=parse_uint(vsync, MAX_COUNT),
        lasers=LaserState(_on(left), _on(right)),
        temperature_projector_c=sensors.get("TPROJ"),
        temperature_case_c=sensors.get("TCASE"),
        temperature_board_c=sensors.get("TBOARD"),
        leak=None if leak is None else leak != 0.0,
        humidity_percent=sensors.get("HUM"),
        supply_v=sensors.get("SUPPLY"),
    )


def parse_sensors(fields: tuple[str, ...]) -> Mapping[str, float | None]:
    """Parse ``name=value`` fields; a sensor that does not answer (``-``) is ``None``.

    Raises MalformedLine.
    """
    values: dict[str, float | None] = {}
    for field in fields:
        name, equals, text = field.partition("=")
        if not equals or not name:
            raise MalformedLine(f"sensor field {field!r}, expected name=value")
        values[name] = None if text == _MISSING else _parse_value(name, text)
    return values


def _parse_value(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise MalformedLine(f"sensor {name} says {text!r}, not a number") from None
    if not math.isfinite(value):
        # "nan" and "inf" are numbers for float(), not for a thermometer.
        raise MalformedLine(f"sensor {name} says {text!r}, not a finite number")
    return value


def parse_info(sentence: Sentence) -> BoardInfo:
    """Parse the answer to INFO. Raises MalformedLine."""
    firmware, serial = _need(sentence, 2)[:2]
    capabilities = sentence.fields[2] if len(sentence.fields) > 2 else ""
    return BoardInfo(firmware, serial, frozenset(filter(None, capabilities.split("+"))))


def parse_lasers(sentence: Sentence) -> LaserState:
    """Parse the answer to LASER. Raises MalformedLine."""
    left, right = _need(sentence, 2)[:2]
    return LaserState(_on(left), _on(right))


def parse_refusal(sentence: Sentence) -> tuple[int, str]:
    """Return code and text of a refusal. Raises MalformedLine."""
    fields = _need(sentence, 1)
    return parse_uint(fields[0], 9999), ",".join(fields[1:])
