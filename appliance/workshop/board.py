"""The step ``board``: the trigger board alone, with its heartbeat, clock, lasers and sensors.

It is identified, observed for some seconds, and its lasers are switched on one after the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from appliance.workshop.finding import Finding, finding_of
from appliance.workshop.step import StepOutcome, Workplace
from drivers import rig as drivers_rig
from drivers.api import BoardBooted, BoardTime, Clock, LaserState, Telemetry
from drivers.board import TriggerBoard

LISTENED_S = 20.0
"""Duration of the observation: readings that are uncertain by a millisecond leave some ten ppm of the drift open."""
ASKED_EVERY_S = 0.4
SETTLED_S = 0.05
"""Time after which a laser's current has settled, and is read a second time."""
EYES = "turn both laser windows away from all eyes: each laser is switched on for a moment"
BEAT_MS, LONGEST_BEAT_MS = 500.0, 750.0
"""Time between heartbeats, and the longest that is accepted: one and a half of it, since a missing one makes two."""
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
_IMPLAUSIBLE = {
    "LEAK": "dry the electrodes; if they are dry, look for a bridge or a missing pull-up",
    "SUPPLY": "check the divider in the firmware's table, and the supply itself",
}
"""Remedies of sensors whose value is not plausible, where they are particular."""


def do(workplace: Workplace) -> StepOutcome:
    """Do the step. Raises DeviceError, GivenUp."""
    with drivers_rig.open_board(drivers_rig.BoardSpec(workplace.rig.board.url), workplace.wires) as board:
        return StepOutcome(_findings(workplace, board))


def _findings(workplace: Workplace, board: TriggerBoard) -> tuple[Finding, ...]:
    # An earlier program may have left both on, and the operator has not been asked to turn them away yet.
    board.stop()
    board.set_lasers(False, False)
    workplace.person.ask(EYES)
    lasers = {side: _laser(board, side, workplace.wires.clock) for side in ("left", "right")}
    beats_us, readings, boots, last = _observe(board, workplace)
    info, counters = board.info, board.counters
    values = {} if last is None else _sensors(last)
    supply_low_v = workplace.rig.limits.supply_low_v
    return (
        *_firmware(info.firmware, workplace.rig.board.firmware),
        *(_restart(cause) for cause in boots),
        Finding("identity", True, f"board {info.serial}, firmware {info.firmware}"),
        judge_beats(beats_us, counters.lost_reports, counters.damaged_lines),
        judge_clock(readings),
        *(judge_laser(side, states) for side, states in lasers.items()),
        *(judge_sensor(name, name in info.capabilities, values.get(name), supply_low_v) for name in _LIMITS),
    )


def _laser(board: TriggerBoard, side: str, clock: Clock) -> tuple[LaserState, LaserState, LaserState]:
    """Return the read-backs of one laser before it is switched on, while it is, and after.

    It is off at the end in any case.
    """
    states = []
    try:
        for is_on in (False, True, False):
            board.set_lasers(is_on and side == "left", is_on and side == "right")
            clock.sleep_s(SETTLED_S)
            # The second answer counts: the first one may be older than the current.
            states.append(board.set_lasers(is_on and side == "left", is_on and side == "right"))
    finally:
        board.set_lasers(False, False)
    before, while_on, after = states
    return before, while_on, after


def _observe(
    board: TriggerBoard, workplace: Workplace
) -> tuple[list[int], list[BoardTime], list[str], Telemetry | None]:
    """Return the times of heartbeats, readings of the clock, causes of restarts, and the last heartbeat."""
    clock = workplace.wires.clock
    beats_us: list[int] = []
    readings: list[BoardTime] = []
    boots: list[str] = []
    last: Telemetry | None = None
    start_ns = last_reading_ns = clock.now_ns()
    readings.append(board.read_clock())
    while (passed_s := (clock.now_ns() - start_ns) / 1e9) < LISTENED_S:
        workplace.say("reading the board's heartbeats", passed_s / LISTENED_S)
        event = board.next_event(ASKED_EVERY_S / 4.0)
        if isinstance(event, Telemetry):
            beats_us.append(event.board_time_us)
            last = event
        elif isinstance(event, BoardBooted):
            # Its clock starts anew: a difference across the restart would be no time between heartbeats.
            boots.append(event.cause)
            beats_us.clear()
            readings.clear()
        # Rarely enough that readings and heartbeats do not delay each other.
        if clock.now_ns() - last_reading_ns > ASKED_EVERY_S * 1e9:
            last_reading_ns = clock.now_ns()
            readings.append(board.read_clock())
    return beats_us, readings, boots, last


def _sensors(last: Telemetry) -> dict[str, float | None]:
    return {
        "TPROJ": last.temperature_projector_c,
        "TCASE": last.temperature_case_c,
        "TBOARD": last.temperature_board_c,
        "LEAK": None if last.leak is None else float(last.leak),
        "HUM": last.humidity_percent,
        "SUPPLY": last.supply_v,
    }


def _firmware(installed: str, expected: str | None) -> list[Finding]:
    if expected is None or expected == installed:
        return []
    remedy = "flash that version, or correct firmware of [board] in the rig file"
    return [Finding("firmware", False, f"firmware {installed}; the rig file wants {expected}", expected, remedy)]


def _restart(cause: str) -> Finding:
    statement = f"restarted during the check ({cause})"
    return Finding("restarts", False, statement, "none", "look for dips of its supply")


def judge_beats(beats_us: Sequence[int], lost_reports: int, damaged_lines: int) -> Finding:
    """Judge the heartbeats of some seconds, and the numbers of lost and damaged reports."""
    limits = f"{BEAT_MS:g} ms apart, {LONGEST_BEAT_MS:g} at most; nothing lost or damaged"
    numbers: dict[str, float] = {"lost_reports": lost_reports, "damaged_lines": damaged_lines}
    if len(beats_us) < 2:
        statement = f"{len(beats_us)} heartbeats are received"
        return finding_of("heartbeats", False, statement, limits, "flash the board's firmware anew", **numbers)
    # By the board's own clock: the time at which a line reaches the host depends on the host.
    longest_ms = max((after - before) / 1000.0 for before, after in pairwise(beats_us))
    ok = longest_ms <= LONGEST_BEAT_MS and lost_reports == 0 and damaged_lines == 0
    statement = f"{len(beats_us)} heartbeats, {longest_ms:.0f} ms apart at most; {lost_reports} reports lost, {damaged_lines} lines damaged"
    remedy = "give the board a USB port of its own and a short cable; if it goes on, look for supply dips at the board"
    return finding_of("heartbeats", ok, statement, limits, remedy, **numbers, longest_ms=longest_ms)


def judge_clock(readings: Sequence[BoardTime]) -> Finding:
    """Compare the rates of board and host by the least uncertain readings of the first and the last third."""
    limits = f"up to {MOST_DRIFT_PPM:g} ppm"
    third = len(readings) // 3
    if third < 1:
        return Finding("clock", False, f"{len(readings)} readings of the clock are too few", limits, "try again")

    def bracket_ns(reading: BoardTime) -> int:
        return reading.host_received_ns - reading.host_sent_ns

    first, last = min(readings[:third], key=bracket_ns), min(readings[-third:], key=bracket_ns)
    passed_ns = (last.host_sent_ns + last.host_received_ns - first.host_sent_ns - first.host_received_ns) / 2.0
    drift_ppm = (1000.0 * (last.board_time_us - first.board_time_us) / passed_ns - 1.0) * 1e6
    # The board read its clock at an unknown moment between request and answer.
    unsure_ppm = (bracket_ns(first) + bracket_ns(last)) / 2.0 / passed_ns * 1e6
    statement = f"the board's clock runs {drift_ppm:+.1f} ± {unsure_ppm:.1f} ppm against the host's"
    # The uncertainty counts in the board's favour.
    ok = abs(drift_ppm) - unsure_ppm <= MOST_DRIFT_PPM
    remedy = "let the board run from its crystal, not from an RC oscillator; check the clock in its firmware"
    return finding_of("clock", ok, statement, limits, remedy, drift_ppm=drift_ppm, uncertainty_ppm=unsure_ppm)


def judge_laser(side: str, states: tuple[LaserState, LaserState, LaserState]) -> Finding:
    """Judge the read-backs of one laser before, while and after it was switched on; the other one was off."""
    other_side = "right" if side == "left" else "left"
    # The other laser's read-back distinguishes a wire at the wrong pin from a broken one.
    states_on = [_on(state, side) for state in states]
    other_states_on = [_on(state, other_side) for state in states]
    statement = f"the read-back says {', '.join('on' if is_on else 'off' for is_on in states_on)}"
    remedy = ""
    # A laser that is on when it must be off endangers eyes, and so comes first.
    if states_on[0] or states_on[2]:
        remedy = "do not look into it: its driver conducts while it is off; check the enable's pull-down and the driver"
    elif other_states_on[1] and not states_on[1]:
        statement += f"; the {other_side} one is on instead"
        remedy = "exchange the two lasers' wires at the board"
    elif other_states_on[1]:
        statement += f"; the {other_side} one is on as well"
        remedy = "look for a bridge between the two enables"
    elif not states_on[1] or any(other_states_on):
        remedy = "check its wires, its driver's supply, the shunt amplifier, and that the hardware gate sees heartbeats"
    return finding_of(f"laser.{side}", not remedy, statement, "off, on, off", remedy)


def judge_sensor(name: str, fitted: bool, value: float | None, supply_low_v: float | None = None) -> Finding:
    """Judge one sensor; one that is not fitted is reported and is no fault.

    ``supply_low_v`` is the rig file's limit of the supply.
    """
    low, high, unit = _LIMITS[name]
    if name == "SUPPLY" and supply_low_v is not None:
        low = supply_low_v
    limits = f"{low:g}..{high:g} {unit}"
    word = f"sensor.{name}"
    # No instrument needs every sensor; the builder lists the fitted ones in the firmware.
    if not fitted:
        return Finding(word, True, "not fitted, as the board reports", limits)
    if value is None:
        remedy = "check its wires and its address on the bus; leave it out of the firmware's list if it is not fitted"
        return Finding(word, False, "fitted, but does not answer", limits, remedy)
    ok, remedy = low <= value <= high, "check the sensor's type in the firmware's table, and its wires"
    statement = f"{value:g} {unit}" + ("" if ok else " is not plausible on a bench")
    return finding_of(word, ok, statement, limits, _IMPLAUSIBLE.get(name, remedy), value=value)


def _on(state: LaserState, side: str) -> bool:
    return state.left_on if side == "left" else state.right_on
