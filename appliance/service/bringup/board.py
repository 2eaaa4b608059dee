"""Owns the step ``board``: the trigger board is asked who it is, listened to for some seconds, and its lasers lit one after the other."""

from __future__ import annotations

from appliance.bringup.board_check import BoardHeard, judge_board
from appliance.bringup.finding import Finding
from appliance.bringup.guide import StepOutcome
from appliance.service.bringup.workplace import Workplace
from drivers import rig as drivers_rig
from drivers.api import BoardBooted, BoardTime, Clock, LaserState, Telemetry
from drivers.board import TriggerBoard

LISTENED_S = 20.0
"""Time for which the board is listened to: two clocks' brackets of a millisecond leave some ten ppm of their drift open."""
ASKED_EVERY_S = 0.4
SETTLED_S = 0.05
"""Time after which a laser's current has settled, and is read a second time."""
EYES = "turn both laser windows away from everybody's eyes: each laser lights for a moment"


def board_step(at: Workplace) -> StepOutcome:
    """Do the step. Raises DeviceError, GivenUp."""
    with drivers_rig.open_board(drivers_rig.BoardSpec(at.rig.board.url), at.wires) as board:
        return StepOutcome(_findings(at, board))


def _findings(at: Workplace, board: TriggerBoard) -> tuple[Finding, ...]:
    # An earlier program may have left both on: nobody has been told to turn them away yet.
    board.stop()
    board.set_lasers(False, False)
    at.person.ask(EYES)
    lasers = {side: _laser(board, side, at.wires.clock) for side in ("left", "right")}
    beats, clock, boots, last = _listened(board, at)
    counters, info = board.counters, board.info
    findings = judge_board(
        BoardHeard(
            firmware=info.firmware,
            serial=info.serial,
            beats_us=tuple(beats),
            clock=tuple(clock),
            lost_reports=counters.lost_reports,
            damaged_lines=counters.damaged_lines,
            lasers=lasers,
            fitted=info.capabilities,
            sensors={} if last is None else _sensors(last),
        ),
        at.rig.limits.supply_low_v,
    )
    restarted = [
        Finding(
            "restarts", False, f"restarted while it was listened to ({cause})", "none", "look for dips of its supply"
        )
        for cause in boots
    ]
    return (*_firmware(at, info.firmware), *restarted, *findings)


def _firmware(at: Workplace, found: str) -> list[Finding]:
    wanted = at.rig.board.firmware
    if wanted is None or wanted == found:
        return []
    remedy = "flash that version, or correct firmware of [board] in the rig file"
    return [Finding("firmware", False, f"firmware {found}; the rig file wants {wanted}", wanted, remedy)]


def _laser(board: TriggerBoard, side: str, clock: Clock) -> tuple[LaserState, LaserState, LaserState]:
    """Return the read-backs before one laser is switched on, while it is, and after. It is off at the end, whatever happens."""
    states = []
    try:
        for on in (False, True, False):
            board.set_lasers(on and side == "left", on and side == "right")
            clock.sleep_s(SETTLED_S)
            # Asked twice: the first answer may be older than the current.
            states.append(board.set_lasers(on and side == "left", on and side == "right"))
    finally:
        board.set_lasers(False, False)
    before, while_on, after = states
    return before, while_on, after


def _listened(board: TriggerBoard, at: Workplace) -> tuple[list[int], list[BoardTime], list[str], Telemetry | None]:
    """Return times of heartbeats, readings of the clock, causes of restarts, and the last heartbeat."""
    clock = at.wires.clock
    beats: list[int] = []
    readings: list[BoardTime] = []
    boots: list[str] = []
    last: Telemetry | None = None
    begun_ns = asked_ns = clock.now_ns()
    readings.append(board.read_clock())
    while (passed_s := (clock.now_ns() - begun_ns) / 1e9) < LISTENED_S:
        at.say("listening to the board", passed_s / LISTENED_S)
        event = board.next_event(ASKED_EVERY_S / 4.0)
        if isinstance(event, Telemetry):
            beats.append(event.board_time_us)
            last = event
        elif isinstance(event, BoardBooted):
            # Its time begins anew: a step across that would be no distance of heartbeats.
            boots.append(event.cause)
            beats.clear()
            readings.clear()
        # Seldom enough that questions and heartbeats do not wait for each other.
        if clock.now_ns() - asked_ns > ASKED_EVERY_S * 1e9:
            asked_ns = clock.now_ns()
            readings.append(board.read_clock())
    return beats, readings, boots, last


def _sensors(last: Telemetry) -> dict[str, float | None]:
    return {
        "TPROJ": last.temperature_projector_c,
        "TCASE": last.temperature_case_c,
        "TBOARD": last.temperature_board_c,
        "LEAK": None if last.leak is None else float(last.leak),
        "HUM": last.humidity_percent,
        "SUPPLY": last.supply_v,
    }
