"""Owns the step ``vsync``: the board's syncs are compared with a clock, with 600 flips, and with an output that is dark."""

from __future__ import annotations

import numpy as np

from appliance.bringup.finding import Finding
from appliance.bringup.guide import StepOutcome
from appliance.bringup.vsync_check import FLIPS, VsyncSeen, judge_stamps_of_syncs, judge_vsync
from appliance.capture.sync import SyncError, SyncMap, synchronise
from appliance.service.bringup.workplace import Workplace
from appliance.service.devices import output_spec
from drivers import rig as drivers_rig
from drivers.api import Board, Clock, Flip, Projector, Vsync
from drivers.board.board import BoardRefused
from drivers.board.reports import Refusal
from drivers.output.outputs import Outputs

SETTLED_S = 2.0
"""Time that a projector or a splitter takes to follow a new mode."""
STAMPED_S = 3.0
STOPPED_WITHIN_S, QUIET_S = 3.0, 0.3
"""Time in which syncs must end after the output went dark, and for which none has come by then."""
SYNC_TRIES = 3
COUNTED = 0xFFFF_FFFF


def vsync_step(at: Workplace) -> StepOutcome:
    """Do the step. Raises DeviceError."""
    rig = at.rig
    with (
        drivers_rig.open_board(drivers_rig.BoardSpec(rig.board.url), at.wires) as board,
        drivers_rig.open_outputs(output_spec(rig.projector), output_spec(rig.display), at.wires) as outputs,
    ):
        return StepOutcome(_findings(at, board, outputs))


def _findings(at: Workplace, board: Board, outputs: Outputs) -> tuple[Finding, ...]:
    rig, clock = at.rig, at.wires.clock
    period_ns = 1e9 / rig.projector.refresh_hz
    black = np.zeros((rig.projector.height_px, rig.projector.width_px), np.uint8)
    board.stop()
    projector = outputs.open_projector()
    projector.load([black, black])
    projector.show(0)
    # A splitter that has just got a new mode sends nothing, or something else, for a while.
    clock.sleep_s(SETTLED_S)
    stamps = _stamps(board, clock, 0.4 * period_ns / 1e9)
    if not stamps:
        return judge_stamps_of_syncs(stamps, rig.projector.refresh_hz)
    try:
        first, last = _counted(board, projector, at, period_ns)
    except SyncError as error:
        rate = judge_stamps_of_syncs(stamps, rig.projector.refresh_hz)
        remedy = "the board must see the video that the graphics card sends, not one that a converter makes anew"
        return (*rate, Finding("count", False, str(error), "as many syncs as blanks", remedy))
    # Dark while the card is still ours: given back, the console would light it again.
    outputs.close_projector()
    return judge_vsync(
        VsyncSeen(
            refresh_hz=rig.projector.refresh_hz,
            stamps=tuple(stamps),
            blanks=_blanks(first.flip, last.flip, period_ns),
            syncs=(last.count - first.count) & COUNTED,
            phase_us=first.phase_error * period_ns / 1000.0,
            stopped_after_ms=_stopped(board, clock),
        )
    )


def _ask(board: Board) -> Vsync | None:
    """Return the latest sync; ``None`` where the board has seen none for a while."""
    try:
        return board.vsync()
    except BoardRefused as error:
        if error.code != Refusal.NO_VSYNC:
            raise
        return None


def _stamps(board: Board, clock: Clock, pause_s: float) -> list[tuple[int, int]]:
    """Return numbers and board times, µs, of the syncs of some seconds, each once."""
    found: dict[int, int] = {}
    until_ns = clock.now_ns() + int(STAMPED_S * 1e9)
    while clock.now_ns() < until_ns:
        seen = _ask(board)
        if seen is not None:
            # Asked more often than syncs come: the same one again is no second one.
            found[seen.count] = seen.board_time_us
        clock.sleep_s(pause_s)
    return list(found.items())


def _counted(board: Board, projector: Projector, at: Workplace, period_ns: float) -> tuple[SyncMap, SyncMap]:
    """Return which syncs the first and the last of many flips are. Raises SyncError, DeviceError."""
    first = _matched(board, projector, period_ns)
    for number in range(FLIPS - 1):
        if number % 60 == 0:
            at.say("flips", number / FLIPS)
        projector.show(number % 2)
    return first, _matched(board, projector, period_ns)


def _matched(board: Board, projector: Projector, period_ns: float) -> SyncMap:
    """Flip and return which of the board's syncs that was. Raises SyncError."""
    for _ in range(SYNC_TRIES - 1):
        # A host that was interrupted while it asked is not every time.
        try:
            return synchronise(board, projector.show(0), period_ns)
        except SyncError:
            continue
    return synchronise(board, projector.show(0), period_ns)


def _blanks(first: Flip, last: Flip, period_ns: float) -> int:
    """Count the blanks between two flips: as the kernel does, else by their times."""
    if first.sequence is not None and last.sequence is not None:
        return last.sequence - first.sequence
    return round((last.time_ns - first.time_ns) / period_ns)


def _stopped(board: Board, clock: Clock) -> float | None:
    """Return the time until the board saw no more syncs, ms; ``None``: they go on."""
    begun_ns = latest_ns = clock.now_ns()
    count: int | None = None
    while clock.now_ns() - begun_ns < STOPPED_WITHIN_S * 1e9:
        # A board may say that there are none, or go on telling the last one: both are an end.
        seen = _ask(board)
        if seen is None or (seen.count == count and clock.now_ns() - latest_ns > QUIET_S * 1e9):
            return (latest_ns - begun_ns) / 1e6
        if seen.count != count:
            count, latest_ns = seen.count, clock.now_ns()
        clock.sleep_s(0.01)
    return None
