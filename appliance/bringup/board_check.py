"""Owns what a trigger board by itself must be like: its beat, its clock, its lasers and its sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from appliance.bringup.finding import Finding
from drivers.api import BoardTime, LaserState

BEAT_MS, LONGEST_BEAT_MS = 500.0, 750.0
"""Time between heartbeats, and the longest that is taken: one and a half, since a missing one makes two."""
MOST_DRIFT_PPM = 50.0
"""Largest difference of rate to the host's clock that the board's protocol allows."""
TEMPERATURE_C = (-10.0, 70.0)
HUMIDITY_PERCENT = (1.0, 90.0)
SUPPLY_V = (4.0, 60.0)
_LIMITS = {
    "TPROJ": (*TEMPERATURE_C, "°C"),
    "TCASE": (*TEMPERATURE_C, "°C"),
    "TBOARD": (*TEMPERATURE_C, "°C"),
    "LEAK": (0.0, 0.0, "(0 dry, 1 wet)"),
    "HUM": (*HUMIDITY_PERCENT, "%"),
    "SUPPLY": (*SUPPLY_V, "V"),
}
"""Range of each sensor on a bench, with its unit."""
_LASER_CALM = "off, on, off"


@dataclass(frozen=True, slots=True)
class BoardHeard:
    """Everything that a board said while it was listened to."""

    firmware: str
    serial: str
    beats_us: tuple[int, ...]
    """Times of its heartbeats by its own clock."""
    clock: tuple[BoardTime, ...]
    """Readings of its clock, in order."""
    lost_reports: int
    damaged_lines: int
    lasers: Mapping[str, tuple[LaserState, LaserState, LaserState]]
    """Read-backs by side: before it was switched on, while it was, and after."""
    fitted: frozenset[str]
    """Sensors that the board says it has."""
    sensors: Mapping[str, float | None]
    """Values by sensor; ``None``: it does not answer."""


def judge_board(heard: BoardHeard, supply_low_v: float | None = None) -> tuple[Finding, ...]:
    """Judge a board; ``supply_low_v`` is the rig file's limit of the supply, ``None``: it has none."""
    return (
        Finding("identity", True, f"board {heard.serial}, firmware {heard.firmware}"),
        judge_beats(heard.beats_us, heard.lost_reports, heard.damaged_lines),
        judge_clock(heard.clock),
        *(judge_laser(side, states) for side, states in heard.lasers.items()),
        *(judge_sensor(name, name in heard.fitted, heard.sensors.get(name), supply_low_v) for name in _LIMITS),
    )


def judge_beats(beats_us: Sequence[int], lost_reports: int, damaged_lines: int) -> Finding:
    """Judge the heartbeats of some seconds, and whether anything of the reports was lost or damaged."""
    limits = f"{BEAT_MS:g} ms apart, {LONGEST_BEAT_MS:g} at most; nothing lost or damaged"
    numbers: dict[str, float | None] = {"lost_reports": float(lost_reports), "damaged_lines": float(damaged_lines)}
    if len(beats_us) < 2:
        said = f"{len(beats_us)} heartbeats were heard"
        return Finding("heartbeats", False, said, limits, "flash the board's firmware anew", numbers)
    # By the board's own clock: when a line reached the host says more about the host.
    steps_ms = [(after - before) / 1000.0 for before, after in pairwise(beats_us)]
    numbers["longest_ms"] = longest_ms = max(steps_ms)
    said = f"{len(beats_us)} heartbeats, {longest_ms:.0f} ms apart at most; {lost_reports} reports lost, {damaged_lines} lines damaged"
    ok = longest_ms <= LONGEST_BEAT_MS and lost_reports == 0 and damaged_lines == 0
    remedy = (
        ""
        if ok
        else "give the board a USB port of its own and a short cable; if it goes on, look for supply dips at the board"
    )
    return Finding("heartbeats", ok, said, limits, remedy, numbers)


def judge_clock(readings: Sequence[BoardTime]) -> Finding:
    """Compare the rates of board and host by the least uncertain readings of the first and the last third."""
    limits = f"up to {MOST_DRIFT_PPM:g} ppm"
    third = len(readings) // 3
    if third < 1:
        return Finding("clock", False, f"{len(readings)} readings of the clock are too few", limits, "try again")

    def bracket_ns(one: BoardTime) -> int:
        return one.host_received_ns - one.host_sent_ns

    first, last = min(readings[:third], key=bracket_ns), min(readings[-third:], key=bracket_ns)
    passed_ns = (last.host_sent_ns + last.host_received_ns - first.host_sent_ns - first.host_received_ns) / 2.0
    drift_ppm = (1000.0 * (last.board_time_us - first.board_time_us) / passed_ns - 1.0) * 1e6
    # The board read its clock somewhere within each question.
    unsure_ppm = (bracket_ns(first) + bracket_ns(last)) / 2.0 / passed_ns * 1e6
    numbers: dict[str, float | None] = {"drift_ppm": drift_ppm, "uncertainty_ppm": unsure_ppm}
    said = f"the board's clock runs {drift_ppm:+.1f} ± {unsure_ppm:.1f} ppm against the host's"
    # What the brackets leave open speaks for the board: it is not its fault.
    ok = abs(drift_ppm) - unsure_ppm <= MOST_DRIFT_PPM
    remedy = (
        "" if ok else "let the board run from its crystal, not from an RC oscillator; check the clock in its firmware"
    )
    return Finding("clock", ok, said, limits, remedy, numbers)


def judge_laser(side: str, states: tuple[LaserState, LaserState, LaserState]) -> Finding:
    """Judge the read-backs of one laser before, while and after it was switched on; the other one was off."""
    other = "right" if side == "left" else "left"
    # A read-back of the other laser tells a wire at the wrong pin from one that is broken.
    own = [_on(state, side) for state in states]
    strange = [_on(state, other) for state in states]
    name = f"laser.{side}"
    spelled = ", ".join("on" if on else "off" for on in own)
    said = f"the read-back says {spelled}"
    if own == [False, True, False] and not any(strange):
        return Finding(name, True, said, _LASER_CALM)
    # The current where it must not be is the one that hurts eyes: said first.
    if own[0] or own[2]:
        remedy = "do not look into it: its driver conducts while it is off; check the enable's pull-down and the driver"
    elif strange[1] and not own[1]:
        said += f"; the {other} one answered instead"
        remedy = "exchange the two lasers' wires at the board"
    elif strange[1]:
        said += f"; the {other} one came on as well"
        remedy = "look for a bridge between the two enables"
    else:
        remedy = "check its wires, its driver's supply, the shunt amplifier, and that the hardware gate sees heartbeats"
    return Finding(name, False, said, _LASER_CALM, remedy)


def judge_sensor(name: str, fitted: bool, value: float | None, supply_low_v: float | None = None) -> Finding:
    """Judge one sensor; what is not fitted is said and is no fault."""
    low, high, unit = _LIMITS[name]
    if name == "SUPPLY" and supply_low_v is not None:
        low = supply_low_v
    limits = f"{low:g}..{high:g} {unit}"
    word = f"sensor.{name}"
    # Nobody needs every sensor, and which are there is the builder's word in the firmware.
    if not fitted:
        return Finding(word, True, "not fitted, says the board", limits)
    if value is None:
        remedy = "check its wires and its address on the bus; leave it out of the firmware's list if it is not fitted"
        return Finding(word, False, "fitted, but does not answer", limits, remedy)
    numbers: dict[str, float | None] = {"value": value}
    said = f"{value:g} {unit}"
    if low <= value <= high:
        return Finding(word, True, said, limits, "", numbers)
    remedy = {
        "LEAK": "dry the electrodes; if they are dry, look for a bridge or a missing pull-up",
        "SUPPLY": "check the divider in the firmware's table, and the supply itself",
    }.get(name, "check the sensor's type in the firmware's table, and its wires")
    return Finding(word, False, f"{said} is not plausible on a bench", limits, remedy, numbers)


def _on(state: LaserState, side: str) -> bool:
    return state.left_on if side == "left" else state.right_on
