"""Talks to the trigger board behind the device that is the first argument."""

from __future__ import annotations

import itertools
import sys

from drivers.api import Pulse
from drivers.board import BoardSpec, TriggerBoard
from drivers.native import MonotonicClock
from tests.libraries.clients import say, wait

if __name__ == "__main__":
    with TriggerBoard.open(BoardSpec(sys.argv[1]), MonotonicClock()) as board:
        say(serial=board.info.serial, firmware=board.info.firmware)
        lasers = board.set_lasers(True, False)
        say(lasers=[lasers.left_on, lasers.right_on])
        wait()
        first = board.vsync().count + 30
        board.arm(24, first, 500, 1000)
        pulses: list[Pulse] = []
        while len(pulses) < 24:
            event = board.next_event(3.0)
            if event is None:
                break
            if isinstance(event, Pulse):
                pulses.append(event)
        counters = board.counters
        say(
            vsyncs=[pulse.vsync - first for pulse in pulses],
            steps_us=[b.board_time_us - a.board_time_us for a, b in itertools.pairwise(pulses)],
            damaged=counters.damaged_lines + counters.garbage_bytes + counters.lost_reports,
        )
