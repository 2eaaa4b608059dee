"""The step ``vsync``: rate, jitter, count and end of the projector's vertical sync.

The board's syncs are compared with a clock, with 600 flips, and with an output that is dark.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from appliance.instrument import SyncError, SyncMap, output_spec, synchronise
from appliance.workshop.finding import Finding, finding_of
from appliance.workshop.step import StepOutcome, Workplace
from drivers import rig as drivers_rig
from drivers.api import Board, Clock, Flip, Projector, Vsync
from drivers.board.board import BoardRefused
from drivers.board.reports import Refusal
from drivers.output.outputs import Outputs

SETTLED_S = 2.0
"""Time that a projector or a splitter takes to follow a new mode."""
STAMPED_S = 3.0
STOPPED_WITHIN_S, QUIET_S = 3.0, 0.3
"""Time in which syncs must end after the output went dark, and time without a sync that counts as their end."""
SYNC_TRIES = 3
COUNTED = 0xFFFF_FFFF
MOST_OFF_HZ = 0.1
MOST_JITTER_US = 5.0
FLIPS = 600
"""Flips over which syncs are counted: in ten seconds noise would show, but not one lost sync a minute."""
FEWEST_STAMPS = 20


def do(workplace: Workplace) -> StepOutcome:
    """Do the step. Raises DeviceError."""
    rig = workplace.rig
    with (
        drivers_rig.open_board(drivers_rig.BoardSpec(rig.board.url), workplace.wires) as board,
        drivers_rig.open_outputs(output_spec(rig.projector), output_spec(rig.display), workplace.wires) as outputs,
    ):
        return StepOutcome(_findings(workplace, board, outputs))


def _findings(workplace: Workplace, board: Board, outputs: Outputs) -> tuple[Finding, ...]:
    rig, clock = workplace.rig, workplace.wires.clock
    period_ns = 1e9 / rig.projector.refresh_hz
    black = np.zeros((rig.projector.height_px, rig.projector.width_px), np.uint8)
    board.stop()
    projector = outputs.open_projector()
    projector.load([black, black])
    projector.show(0)
    # After a change of the mode a splitter sends no or other syncs for a while.
    clock.sleep_s(SETTLED_S)
    stamps = _stamps(board, clock, 0.4 * period_ns / 1e9)
    beat = judge_stamps_of_syncs(stamps, rig.projector.refresh_hz)
    if not stamps:
        return beat
    try:
        first, last = _count_syncs(board, projector, workplace, period_ns)
    except SyncError as error:
        remedy = "connect the board to the video of the graphics card itself, not behind a converter"
        return (*beat, Finding("count", False, str(error), "as many syncs as blanks", remedy))
    # Dark while this process holds the card: after its release the console would light it again.
    outputs.close_projector()
    return (
        *beat,
        judge_count((last.count - first.count) & COUNTED, _blanks(first.flip, last.flip, period_ns)),
        judge_stop(_stop_time_ms(board, clock)),
        judge_edge(first.phase_error * period_ns / 1000.0),
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
    times_by_count: dict[int, int] = {}
    until_ns = clock.now_ns() + int(STAMPED_S * 1e9)
    while clock.now_ns() < until_ns:
        vsync = _ask(board)
        if vsync is not None:
            # The board is read more often than syncs come: each sync counts once.
            times_by_count[vsync.count] = vsync.board_time_us
        clock.sleep_s(pause_s)
    return list(times_by_count.items())


def _count_syncs(board: Board, projector: Projector, workplace: Workplace, period_ns: float) -> tuple[SyncMap, SyncMap]:
    """Return the syncs of the first and of the last of many flips. Raises SyncError, DeviceError."""
    first = _sync_of_flip(board, projector, period_ns)
    for number in range(FLIPS - 1):
        if number % 60 == 0:
            workplace.say("flips", number / FLIPS)
        projector.show(number % 2)
    return first, _sync_of_flip(board, projector, period_ns)


def _sync_of_flip(board: Board, projector: Projector, period_ns: float) -> SyncMap:
    """Flip and return the board's sync of that flip. Raises SyncError."""
    for _ in range(SYNC_TRIES - 1):
        # A delay of this process between request and answer is chance: try again.
        try:
            return synchronise(board, projector.show(0), period_ns)
        except SyncError:
            continue
    return synchronise(board, projector.show(0), period_ns)


def _blanks(first: Flip, last: Flip, period_ns: float) -> int:
    """Return the number of blanks between two flips, by the kernel's count, else by their times."""
    if first.sequence is not None and last.sequence is not None:
        return last.sequence - first.sequence
    return round((last.time_ns - first.time_ns) / period_ns)


def _stop_time_ms(board: Board, clock: Clock) -> float | None:
    """Return the time until the board saw no more syncs, ms; ``None``: they go on."""
    start_ns = latest_ns = clock.now_ns()
    count: int | None = None
    while clock.now_ns() - start_ns < STOPPED_WITHIN_S * 1e9:
        # At the end of syncs a board may report none, or the last one again.
        vsync = _ask(board)
        if vsync is None or (vsync.count == count and clock.now_ns() - latest_ns > QUIET_S * 1e9):
            return (latest_ns - start_ns) / 1e6
        if vsync.count != count:
            count, latest_ns = vsync.count, clock.now_ns()
        clock.sleep_s(0.01)
    return None


def judge_stamps_of_syncs(stamps: Sequence[tuple[int, int]], refresh_hz: float) -> tuple[Finding, Finding]:
    """Judge rate and jitter by a straight line through numbers and times of syncs."""
    limits = f"{refresh_hz:g} ± {MOST_OFF_HZ:g} Hz"
    jitter_limits = f"up to {MOST_JITTER_US:g} µs (stamps are whole µs)"
    if len(stamps) < FEWEST_STAMPS:
        statement = f"{len(stamps)} syncs are counted"
        remedy = "check the tap of the projector's video, and that a splitter's second output is lit"
        return Finding("rate", False, statement, limits, remedy), Finding(
            "jitter", False, statement, jitter_limits, remedy
        )
    # Relative to the first one: large numbers and times would lose digits in a fit.
    numbers = np.array([number - stamps[0][0] for number, _ in stamps], np.float64)
    times_us = np.array([time_us - stamps[0][1] for _, time_us in stamps], np.float64)
    period_us, begin_us = np.polyfit(numbers, times_us, 1)
    deviation_us = float(np.abs(times_us - period_us * numbers - begin_us).max())
    rate_hz = 1e6 / float(period_us)
    # A whole multiple or a half is the tap's fault, another factor the mode's.
    factor, remedy = rate_hz / refresh_hz, ""
    if abs(rate_hz - refresh_hz) > MOST_OFF_HZ:
        remedy = f"set refresh_hz of [projector] to the rate of the mode, or choose a mode of {refresh_hz:g} Hz"
        if abs(factor - round(factor)) < 0.02 and factor > 1.5:
            remedy = (
                "the board counts edges of horizontal sync, or both edges: check the tap's pin and the firmware's edge"
            )
        elif 0.45 < factor < 0.55:
            remedy = (
                "the board misses every second sync: check the divider behind the tap (5 V to 3.3 V), and its level"
            )
    rate = finding_of("rate", not remedy, f"{rate_hz:.3f} Hz", limits, remedy, rate_hz=rate_hz)
    statement = f"syncs deviate by at most {deviation_us:.1f} µs from equal intervals"
    remedy = "series resistor and ground beside the sync's wire; stamp syncs in hardware, not in an interrupt"
    return rate, finding_of(
        "jitter", deviation_us <= MOST_JITTER_US, statement, jitter_limits, remedy, jitter_us=deviation_us
    )


def judge_count(syncs: int, blanks: int) -> Finding:
    """Judge the board's syncs between two flips by the graphics card's blanks between the same two."""
    statement = f"{syncs} syncs in {blanks} blanks of the graphics card"
    remedy = "syncs are missed: check the level behind the tap, and that nothing else uses the pin"
    if syncs > blanks:
        remedy = "noise is counted as syncs: ground beside the wire, a Schmitt trigger, a filter of a µs"
    # Exactly, not to a tolerance: one sync lost or too many puts every later picture into the wrong frame.
    ok = syncs == blanks and blanks > 0
    return finding_of("count", ok, statement, "as many syncs as blanks", remedy, syncs=syncs, blanks=blanks)


def judge_stop(stopped_after_ms: float | None) -> Finding:
    """Judge the time from darkening the output until the board saw no more syncs; ``None``: they go on."""
    limits = "no syncs while the output is off"
    if stopped_after_ms is None:
        remedy = (
            "the board counts something else: check the tap's pin and its ground; a splitter that makes a picture of "
            "its own "
            "while its input is dark cannot be used"
        )
        return Finding("stop", False, "syncs go on while the projector's output is off", limits, remedy)
    statement = f"the last sync came {stopped_after_ms:.0f} ms after the output was switched off"
    return finding_of("stop", True, statement, limits, "", stopped_after_ms=stopped_after_ms)


def judge_edge(phase_us: float) -> Finding:
    """Return the finding on the time from flips to syncs; the edge itself cannot be determined."""
    statement = (
        f"the board's protocol does not show which edge is counted; the syncs' times are {phase_us:+.0f} µs after the "
        "kernel's flips. The "
        "wrong one shifts every exposure by the pulse's width (some 120 µs): compare sync of [projector] with an "
        "oscilloscope"
    )
    return finding_of("edge", True, statement, "the leading edge", "", phase_us=phase_us)
