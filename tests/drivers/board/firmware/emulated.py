"""Owns MicroPython's modules for the RP2040 on an emulated one: ``machine``, ``rp2``, ``usb.device`` and the clock.

PIO, pins and PIO registers are the emulator's, clock by clock; watchdog, converters, sensors' bus and USB are models of what the
firmware asks of them. Python takes two microseconds for each access to the chip.
"""

from __future__ import annotations

import sys
import time
from array import array
from dataclasses import dataclass, field
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from drivers.board.firmware.pins import gpio
from drivers.board.firmware.sensors import crc8

CLOCK_HZ = 125_000_000
US = CLOCK_HZ // 1_000_000
VSYNC, TRIGGER = gpio("VSYNC"), gpio("TRIGGER")
PIO0_BASE = 0x50200000
PIO0 = 6
"""Function of a GPIO."""
INPUT_ENABLED = 0x40
CTRL, FLEVEL, TXF0, RXF0, INSTR_MEM0 = 0x00, 0x0C, 0x10, 0x20, 0x48
CLKDIV, EXECCTRL, SHIFTCTRL, INSTR, PINCTRL = 0xC8, 0xCC, 0xD0, 0xD8, 0xDC
"""Of state machine 0; the others follow 0x18 apart (RP2040 datasheet, table 366)."""
JOIN_RX, OUT_RIGHT, IN_RIGHT = 1 << 31, 1 << 19, 1 << 18


@dataclass
class Chip:
    """One PIO block with its programs, a sync source and an oscilloscope on the trigger line."""

    scope: list[tuple[int, int]] = field(default_factory=list)
    """(clock, level) of each change of the trigger line."""
    now: int = 0
    enabled: int = 0

    def __post_init__(self) -> None:
        simulator = pytest.importorskip("rp2040py.simulator", reason="./dev installs rp2040py")
        self._simulator: Any = simulator.Simulator()
        self._chip: Any = self._simulator.rp2040
        self._block: Any = self._chip.pio[0]
        for number in (VSYNC, TRIGGER):
            self.pin(number).pad_value |= INPUT_ENABLED
            self.pin(number).set_input_value(False)
        self.pin(TRIGGER).ctrl = PIO0
        self.pin(TRIGGER).add_listener(self._seen)

    def pin(self, number: int) -> Any:
        return self._chip.gpio[number]

    def _seen(self, state: Any, _: Any) -> None:
        level = int(state == 1)
        if level == (self.scope[-1][1] if self.scope else 0):
            return
        self.scope.append((self.now, level))
        # The pad reads back what it drives.
        self.pin(TRIGGER).set_input_value(bool(level))

    def write(self, offset: int, value: int) -> None:
        self._chip.write_uint32(PIO0_BASE + offset, value)

    def read(self, offset: int) -> int:
        return int(self._chip.read_uint32(PIO0_BASE + offset))

    def sync(self, level: int) -> None:
        self.pin(VSYNC).set_input_value(bool(level))

    def load(self, machine: int, prog: Any, divider: int, jmp_pin: int | None) -> None:
        """Put a program to its address and set a machine up as MicroPython's StateMachine does; not yet running."""
        words, at, wrap_target, _ = prog
        self.enable(self.enabled & ~(1 << machine))
        for i, word in enumerate(words):
            jumps = word >> 13 == 0
            self.write(INSTR_MEM0 + 4 * (at + i), word + (at if jumps else 0))
        base = 0x18 * machine
        self.write(CLKDIV + base, divider << 16)
        self.write(EXECCTRL + base, (jmp_pin or 0) << 24 | (at + len(words) - 1) << 12 | (at + wrap_target) << 7)
        self.write(SHIFTCTRL + base, (0 if jmp_pin is None else JOIN_RX) | OUT_RIGHT | IN_RIGHT)
        self.write(PINCTRL + base, 1 << 26 | VSYNC << 15 | TRIGGER << 5)
        self.write(CTRL, self.enabled | 1 << 4 + machine)
        # SET PINDIRS, then a jump to the program's beginning, as instructions from outside.
        self.write(INSTR + base, 0xE081)
        self.write(INSTR + base, at)

    def enable(self, mask: int) -> None:
        self.enabled = mask
        self.write(CTRL, mask)

    def run(self, cycles: int) -> None:
        """Clock the block, one cycle at a time wherever a machine has something to do."""
        block, end = self._block, self.now + cycles
        while self.now < end:
            block.advance(1)
            self.now += 1

    def rises(self) -> list[int]:
        return [clock for clock, level in self.scope if level]

    def widths(self) -> list[int]:
        return [b[0] - a[0] for a, b in zip(self.scope[::2], self.scope[1::2], strict=True)]


ACCESS_CYCLES = 2 * US
PERIOD_US = 5_000
"""Syncs come more often than a projector's: a millisecond takes the emulator forty."""
TIMER, WATCHDOG_SCRATCH, IO_BANK0 = 0x40054000, 0x4005800C, 0x40014000
VSYNC_CTRL = IO_BANK0 + 8 * VSYNC + 4
"""Function and overrides of the sync's pin (RP2040 datasheet, table 285): bits 16 and 17 turn its input over."""
POWER_ON, WATCHDOG = 1, 3


def sht40(temperature: int, humidity: int) -> bytes:
    words = [temperature.to_bytes(2, "big"), humidity.to_bytes(2, "big")]
    return b"".join(word + bytes([crc8(word)]) for word in words)


class Emulated:
    """One chip with a video signal on it, whose time passes by what the firmware does."""

    def __init__(self, period_us: int = PERIOD_US, sync_us: int = 124) -> None:
        self.chip = Chip()
        self.period_us, self.sync_us = period_us, sync_us
        self.edges: list[int] = []
        self.synced = True
        self.sync_rises = True
        """What the projector's mode does at the pin; the firmware has to know it."""
        self.scratch = 0
        self.reset_cause = POWER_ON
        self.fed = 0
        self.adc = {gpio("SUPPLY_SENSE"): 43_500}
        self.levels: dict[int, int] = {}
        self.sensors: dict[int, bytes] = {0x48: b"\x0f\xa0", 0x49: b"\x0c\x80", 0x44: sht40(0x6666, 0x7333)}
        self.heard = b""
        self.said = b""
        self.listening = True
        self.next_sync = period_us * US

    def pass_cycles(self, cycles: int) -> None:
        end = self.chip.now + cycles
        while self.chip.now < end:
            edge = min(end, self.next_sync)
            if edge > self.chip.now:
                self.chip.run(edge - self.chip.now)
            if self.chip.now == self.next_sync:
                begins = self.next_sync // US % self.period_us == 0
                if begins:
                    self.edges.append(self.next_sync)
                self.chip.sync(int((begins and self.synced) is self.sync_rises))
                self.next_sync += (self.sync_us if begins else self.period_us - self.sync_us) * US

    # ---- mem32

    def __getitem__(self, address: int) -> int:
        self.pass_cycles(ACCESS_CYCLES)
        if address == TIMER + 0x0C:
            return self.chip.now // US & 0xFFFFFFFF
        if address == TIMER + 0x08:
            return self.chip.now // US >> 32
        if address == WATCHDOG_SCRATCH:
            return self.scratch
        if address == VSYNC_CTRL:
            return int(self.chip.pin(VSYNC).ctrl)
        return self.chip.read(address - PIO0_BASE)

    def __setitem__(self, address: int, value: int) -> None:
        self.pass_cycles(ACCESS_CYCLES)
        if address == WATCHDOG_SCRATCH:
            self.scratch = value
        elif address == VSYNC_CTRL:
            self.chip.pin(VSYNC).ctrl = value
        else:
            assert address >= PIO0_BASE
            self.chip.write(address - PIO0_BASE, value)


class _Emit:
    """What the firmware uses of ``rp2.PIOASMEmit``, with the fields that a program of 1.27 has on RP2040."""

    def __init__(self, **settings: Any) -> None:
        self.prog: list[Any] = [array("H"), -1, 0, settings]

    def start_pass(self, turn: int) -> None:
        del self.prog[0][:]

    def wrap_target(self) -> None:
        self.prog[2] = len(self.prog[0])

    def word(self, word: int) -> None:
        self.prog[0].append(word)


def modules(emulated: Emulated) -> dict[str, ModuleType]:
    """Return the modules that ``chip.py`` imports, on ``emulated``."""
    chip = emulated.chip
    used = 0

    class StateMachine:
        def __init__(self, number: int, prog: Any, **settings: Any) -> None:
            self._number = number
            self.init(prog, **settings)

        def init(self, prog: Any, freq: int = -1, **settings: Any) -> None:
            nonlocal used
            if prog[1] < 0:
                prog[1], used = used, used + len(prog[0])
                assert used <= 32
            assert "in_base" not in settings or settings["in_base"].number == VSYNC
            assert "set_base" not in settings or settings["set_base"].number == TRIGGER
            assert (prog[3].get("out_shiftdir") == 1) is ("in_base" in settings), "GATE shifts to the right"
            jmp_pin = settings["jmp_pin"].number if "jmp_pin" in settings else None
            chip.load(self._number, prog, 1 if freq < 0 else CLOCK_HZ // freq, jmp_pin)
            while self.tx_fifo():
                # PULL without waiting: MicroPython empties the FIFOs here.
                chip.write(INSTR + 0x18 * self._number, 0x8080)

        def active(self, on: int) -> None:
            chip.enable(chip.enabled | 1 << self._number if on else chip.enabled & ~(1 << self._number))
            emulated.pass_cycles(ACCESS_CYCLES)

        def put(self, word: int) -> None:
            chip.write(TXF0 + 4 * self._number, word)
            emulated.pass_cycles(ACCESS_CYCLES)

        def get(self) -> int:
            return chip.read(RXF0 + 4 * self._number)

        def rx_fifo(self) -> int:
            return chip.read(FLEVEL) >> 8 * self._number + 4 & 0xF

        def tx_fifo(self) -> int:
            return chip.read(FLEVEL) >> 8 * self._number & 0xF

        def exec(self, word: int) -> None:
            chip.write(INSTR + 0x18 * self._number, word)
            emulated.pass_cycles(ACCESS_CYCLES)

    class Pin:
        IN, OUT, PULL_DOWN, PULL_UP = 0, 1, 2, 1

        def __init__(self, number: int, mode: int = 0, pull: int | None = None, value: int = 0) -> None:
            self.number = number
            if mode == self.OUT:
                emulated.levels[number] = value

        def value(self, level: int | None = None) -> int:
            emulated.pass_cycles(ACCESS_CYCLES)
            if level is not None:
                emulated.levels[self.number] = int(level)
            if self.number == TRIGGER:
                return chip.scope[-1][1] if chip.scope else 0
            return emulated.levels.get(self.number, 0)

        def toggle(self) -> None:
            emulated.levels[self.number] ^= 1

    class ADC:
        def __init__(self, pin: Pin) -> None:
            self._pin = pin

        def read_u16(self) -> int:
            laser = {gpio("LASER_LEFT_SENSE"): "LASER_LEFT", gpio("LASER_RIGHT_SENSE"): "LASER_RIGHT"}.get(
                self._pin.number
            )
            if laser is not None:
                return 20_000 * emulated.levels[gpio(laser)]
            return emulated.adc[self._pin.number]

    class I2C:
        def __init__(self, *_: Any, **__: Any) -> None:
            pass

        def readfrom_mem(self, address: int, register: int, count: int) -> bytes:
            if address not in emulated.sensors:
                raise OSError(5)
            return b"\x01\x17" if register == 0x0F else emulated.sensors[address]

        def readfrom(self, address: int, count: int) -> bytes:
            return self.readfrom_mem(address, 0, count)

        def writeto(self, address: int, data: bytes) -> None:
            self.readfrom_mem(address, 0, 0)

    class WDT:
        def __init__(self, timeout: int) -> None:
            assert timeout <= 8388

        def feed(self) -> None:
            emulated.fed += 1

    class CDCInterface:
        def __init__(self, timeout: int, txbuf: int, rxbuf: int) -> None:
            assert timeout == 0
            assert txbuf < 64

        @property
        def dtr(self) -> bool:
            return emulated.listening

        def read(self, count: int) -> bytes | None:
            heard, emulated.heard = emulated.heard[:count], emulated.heard[count:]
            return heard or None

        def write(self, data: bytes) -> int:
            taken = data[:40]
            emulated.said += taken
            return len(taken)

    machine, rp2, usb_device, cdc = (ModuleType(name) for name in ("machine", "rp2", "usb.device", "usb.device.cdc"))
    vars(machine).update(
        {"Pin": Pin, "ADC": ADC, "I2C": I2C, "WDT": WDT, "mem32": emulated, "WDT_RESET": WATCHDOG},
        freq=lambda hz: None,
        reset_cause=lambda: emulated.reset_cause,
    )
    pio = SimpleNamespace(SHIFT_RIGHT=1, OUT_LOW=2, JOIN_RX=2)
    vars(rp2).update(StateMachine=StateMachine, PIOASMEmit=_Emit, PIO=pio)
    identity: dict[str, Any] = {}
    vars(usb_device).update(
        get=lambda: SimpleNamespace(init=lambda *_, **words: identity.update(words)), cdc=cdc, identity=identity
    )
    vars(cdc).update(CDCInterface=CDCInterface)
    return {"machine": machine, "rp2": rp2, "usb.device": usb_device, "usb.device.cdc": cdc}


def install(emulated: Emulated, patch: pytest.MonkeyPatch) -> Any:
    """Import ``chip.py`` on ``emulated`` and return the module; ``patch`` takes everything back."""
    import usb

    made = modules(emulated)
    for name, module in made.items():
        patch.setitem(sys.modules, name, module)
    patch.setattr(usb, "device", made["usb.device"], raising=False)
    patch.setattr(time, "sleep_us", lambda us: emulated.pass_cycles(us * US), raising=False)
    patch.setattr(time, "sleep_ms", lambda ms: emulated.pass_cycles(ms * 1000 * US), raising=False)
    patch.delitem(sys.modules, "drivers.board.firmware.chip", raising=False)
    import drivers.board.firmware.chip as module

    patch.delitem(sys.modules, "drivers.board.firmware.chip")
    return module
