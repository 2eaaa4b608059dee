"""The board's electronics on RP2040 and RP2350: pins, PIO, timer, watchdog, sensors' bus and USB.

The only module beside ``main.py`` that needs MicroPython's ``machine`` and ``rp2``; it runs on the chip alone. Register
addresses: RP2040 datasheet 2.19.6, 3.7, 4.6.5, 4.7.6; RP2350 datasheet 9.11.1, 11.7, 12.8.5, 12.9.7.
"""

import time

import machine
import rp2
import usb.device
from usb.device.cdc import CDCInterface

from drivers.board.firmware import instrument, pins, pio, sensors
from drivers.board.firmware.hardware import BoardHardware
from drivers.board.firmware.outbox import Outbox

RELEASE = 0x0200
CLOCK_HZ = 125_000_000
"""Set on both chips: a multiple of the stamps' 5 MHz, so that no divider has a fraction."""
WATCHDOG_MS = 2000
"""Time after which a board whose loop hangs is reset; at most 8388 on RP2040. The longest turn of the loop, with a
start that waits for a pulse, is below 40 ms.
"""
OUTBOX_BYTES = 2048
LASER_SETTLE_US = 1000
ELECTRODE_US = 200
SHT40_READY_MS = 10
PULSE_END_US = 17_000
HOST_MARK = 0x4B46484F
"""Mark in the watchdog's scratch register: a person at the prompt requested the reset that follows."""

_GATE, _PULSE, _SYNCS, _PULSES = 0, 1, 2, 3
_PIO0 = 0x50200000
_PIO_FDEBUG, _PIO_IRQ = 0x08, 0x30
_TIMER = {"RP2040": 0x40054000, "RP2350": 0x400B0000}
_IO_BANK0 = {"RP2040": 0x40014000, "RP2350": 0x40028000}
_WATCHDOG = {"RP2040": 0x40058000, "RP2350": 0x400D8000}
_TIME_HIGH, _TIME_LOW, _SCRATCH0 = 0x08, 0x0C, 0x0C
_INPUT_INVERTED = 1 << 16


def chip_name(machine_text: str) -> str:
    """Return ``RP2040`` or ``RP2350`` from ``sys.implementation._machine``."""
    return "RP2350" if "RP2350" in machine_text else "RP2040"


def reset_cause(name: str) -> str:
    """Return the cause of the last reset as the protocol names it. A brownout looks like a power-on here."""
    scratch = _WATCHDOG[name] + _SCRATCH0
    requested = machine.mem32[scratch] & 0xFFFFFFFF == HOST_MARK
    machine.mem32[scratch] = 0
    if requested:
        return "HOST"
    return "WATCHDOG" if machine.reset_cause() == machine.WDT_RESET else "POWER"


def restart(name: str) -> None:
    """Reset the board on a person's request: its next BOOT reports HOST."""
    machine.mem32[_WATCHDOG[name] + _SCRATCH0] = HOST_MARK
    machine.reset()


def serial_port(serial: str) -> CDCInterface:
    """Appear on the bus as the trigger board and return its port.

    It replaces MicroPython's own serial port.
    """
    # A ring of 63 bytes never makes a transfer of 64; without a timeout neither reading nor writing waits.
    port = CDCInterface(timeout=0, txbuf=63, rxbuf=512)
    usb.device.get().init(
        port,
        builtin_driver=False,
        id_vendor=instrument.VENDOR,
        id_product=instrument.PRODUCT,
        bcd_device=RELEASE,
        # Two interfaces of one function: interface association (USB 2.0 ECN).
        device_class=0xEF,
        device_subclass=2,
        device_protocol=1,
        manufacturer_str="Kingfisher",
        product_str="Trigger board",
        serial_str=serial,
    )
    return port


def assembled(program: pio.Program, **settings: object) -> object:
    """Return ``program`` in the form that ``rp2.StateMachine`` takes."""
    emit = rp2.PIOASMEmit(**settings)
    for pass_number in (0, 1):
        emit.start_pass(pass_number)
        for i in range(len(program.words)):
            if i == program.wrap_target:
                emit.wrap_target()
            emit.word(program.words[i])
    return emit.prog


class ChipHardware(BoardHardware):
    """The board's electronics; made once after a reset."""

    def __init__(self, name: str, serial: str) -> None:
        """Set up every pin; ``name`` is the chip's."""
        machine.freq(CLOCK_HZ)
        self._timer = _TIMER[name]
        self._began_us = 0
        self._began_us = self.now_us()
        self._lasers = [
            machine.Pin(pins.gpio(line), machine.Pin.OUT, value=0) for line in ("LASER_LEFT", "LASER_RIGHT")
        ]
        self._gate_of_lasers = machine.Pin(pins.gpio("LASER_BEAT"), machine.Pin.OUT, value=0)
        self._led = machine.Pin(pins.gpio("LED"), machine.Pin.OUT, value=0)
        self._trigger = machine.Pin(pins.gpio("TRIGGER"), machine.Pin.OUT, value=0)
        self._vsync = machine.Pin(pins.gpio("VSYNC"), machine.Pin.IN, machine.Pin.PULL_DOWN)
        self._electrode = machine.Pin(pins.gpio("LEAK_DRIVE"), machine.Pin.OUT, value=0)
        self._wet = [machine.Pin(pins.gpio(line), machine.Pin.IN, None) for line in ("LEAK_FRONT", "LEAK_REAR")]
        sense = ("LASER_LEFT_SENSE", "LASER_RIGHT_SENSE", "SUPPLY_SENSE")
        self._adc = [machine.ADC(machine.Pin(pins.gpio(line))) for line in sense]
        self._bus = machine.I2C(
            pins.I2C_NUMBER,
            sda=machine.Pin(pins.gpio("SDA")),
            scl=machine.Pin(pins.gpio("SCL")),
            freq=pins.I2C_HZ,
            timeout=pins.I2C_TIMEOUT_US,
        )
        self._board_c: float | None = None
        self._chips = [chip for chip in pins.CHIPS if self._answers(chip)]
        self._programs = (
            assembled(pio.GATE, out_shiftdir=rp2.PIO.SHIFT_RIGHT),
            assembled(pio.PULSE, set_init=(rp2.PIO.OUT_LOW,)),
            assembled(pio.STAMP, fifo_join=rp2.PIO.JOIN_RX),
        )
        self._gate = rp2.StateMachine(_GATE, self._programs[0], in_base=self._vsync)
        self._pulse = rp2.StateMachine(_PULSE, self._programs[1], set_base=self._trigger)
        if not instrument.SYNC_RISES:
            machine.mem32[_IO_BANK0[name] + 8 * pins.gpio("VSYNC") + 4] |= _INPUT_INVERTED
        self._stamps = [self._stamping(_SYNCS, self._vsync), self._stamping(_PULSES, self._trigger)]
        self._port = serial_port(serial)
        self._outbox = Outbox(OUTBOX_BYTES)
        self._watchdog = machine.WDT(timeout=WATCHDOG_MS)

    def _stamping(self, number: int, pin: object) -> tuple[object, int]:
        """Start a stamper.

        Return it and the time at which its count began, right to the few us of two statements.
        """
        stamper = rp2.StateMachine(number, self._programs[2], freq=pio.STAMP_HZ, jmp_pin=pin)
        before_us = self.now_us()
        stamper.active(1)
        return stamper, (before_us + self.now_us()) // 2

    # ------------------------------------------------------------------------------------------ time, syncs, pulses

    def now_us(self) -> int:
        # Reading the low word holds the high one.
        low = machine.mem32[self._timer + _TIME_LOW] & 0xFFFFFFFF
        high = machine.mem32[self._timer + _TIME_HIGH] & 0xFFFFFFFF
        return int(high << 32 | low) - self._began_us

    def wait_us(self, time_us: int) -> None:
        time.sleep_us(time_us)  # type: ignore[attr-defined]

    def next_sync(self) -> int | None:
        return self._stamp(0)

    def next_pulse(self) -> int | None:
        return self._stamp(1)

    def _stamp(self, which: int) -> int | None:
        stamper, began_us = self._stamps[which]
        if not stamper.rx_fifo():  # type: ignore[attr-defined]
            return None
        return pio.stamp_us(stamper.get(), began_us, self.now_us())  # type: ignore[attr-defined]

    def syncs_lost(self) -> bool:
        flag = 1 << _SYNCS
        lost = machine.mem32[_PIO0 + _PIO_FDEBUG] & flag
        machine.mem32[_PIO0 + _PIO_FDEBUG] = flag
        return bool(lost)

    def start(self, skip: int, every: int, pulses: int | None, delay_us: int, width_us: int) -> None:
        self._gate.active(0)
        self._gate.init(self._programs[0], in_base=self._vsync)
        machine.mem32[_PIO0 + _PIO_IRQ] = 1 << pio.FLAG
        if not self._ends_after_this_pulse():
            self._pulse.active(0)
            self._pulse.init(self._programs[1], set_base=self._trigger)
        for word in pio.pulse_words(pulses, width_us, CLOCK_HZ):
            self._pulse.put(word)
        for word in pio.gate_words(skip, every, delay_us, CLOCK_HZ):
            self._gate.put(word)
        self._pulse.active(1)
        self._gate.active(1)

    def _ends_after_this_pulse(self) -> bool:
        """Return True if a pulse is under way, after which PULSE takes new numbers.

        Else it may be set up anew.
        """
        end_us = self.now_us() + PULSE_END_US
        # Numbers that it has not taken yet are of an earlier start during this pulse: only then is there a wait.
        while self._trigger.value() and self._pulse.tx_fifo() and self.now_us() < end_us:
            pass
        if self._trigger.value():
            self._pulse.exec(pio.LAST_PULSE)
        # Still high afterwards: the count was set during this pulse, which is therefore the last one.
        return bool(self._trigger.value())

    def stop(self) -> None:
        self._gate.active(0)

    # ------------------------------------------------------------------------------------------ lasers, life

    def set_lasers(self, left: bool, right: bool) -> None:
        self._lasers[0].value(left)
        self._lasers[1].value(right)
        self.wait_us(LASER_SETTLE_US)

    def lasers(self) -> tuple[bool, bool]:
        return self._conducts(0), self._conducts(1)

    def _conducts(self, side: int) -> bool:
        counts: int = self._adc[side].read_u16()
        return sensors.laser_conducts(counts, pins.ADC_FULL_MV, pins.LASER_SENSE_MV_PER_MA, pins.LASER_ON_MA)

    def beat(self) -> None:
        self._gate_of_lasers.toggle()
        self._led.value(self.now_us() // 500_000 & 1)

    def feed(self) -> None:
        self._watchdog.feed()

    # ------------------------------------------------------------------------------------------ sensors

    def fitted(self) -> list[str]:
        names = [value for chip in self._chips for value in chip.values] + ["LEAK", "SUPPLY"]
        return [name for name in ("TPROJ", "TCASE", "TBOARD", "LEAK", "HUM", "SUPPLY") if name in names]

    def _answers(self, chip: pins.Chip) -> bool:
        try:
            if chip.part == "SHT40":
                self._begin_sht40(chip)
                time.sleep_ms(SHT40_READY_MS)  # type: ignore[attr-defined]
                # Fetched once here, so that the board's temperature has a value from the first heartbeat on.
                self._humidity(chip)
                time.sleep_ms(SHT40_READY_MS)  # type: ignore[attr-defined]
                return True
            raw = self._bus.readfrom_mem(chip.address, sensors.TMP117_IDENTITY, 2)
        except OSError:
            return False
        return bool((raw[0] << 8 | raw[1]) & 0x0FFF == sensors.TMP117_PART)

    def _begin_sht40(self, chip: pins.Chip) -> None:
        self._bus.writeto(chip.address, bytes([sensors.SHT40_MEASURE]))

    def measure(self, name: str) -> str:
        if name == "LEAK":
            return self._leak()
        if name == "SUPPLY":
            return sensors.written(sensors.supply_v(self._adc[2].read_u16(), pins.ADC_FULL_MV, pins.SUPPLY_DIVIDER), 2)
        if name == "TBOARD":
            return sensors.written(self._board_c, 2)
        for chip in self._chips:
            if name in chip.values:
                try:
                    return self._humidity(chip) if name == "HUM" else self._temperature(chip)
                except OSError:
                    return sensors.MISSING
        return sensors.MISSING

    def _temperature(self, chip: pins.Chip) -> str:
        return sensors.written(sensors.tmp117_c(self._bus.readfrom_mem(chip.address, sensors.TMP117_VALUE, 2)), 2)

    def _humidity(self, chip: pins.Chip) -> str:
        """Fetch the result of the previous call, some 200 ms ago, and begin the next measurement.

        So no call waits for the converter.
        """
        self._board_c = None
        try:
            values = sensors.sht40(self._bus.readfrom(chip.address, 6))
        except OSError:
            values = None
        self._begin_sht40(chip)
        if values is None:
            return sensors.MISSING
        self._board_c = values[0]
        return sensors.written(values[1], 1)

    def _leak(self) -> str:
        self._electrode.value(1)
        self.wait_us(ELECTRODE_US)
        driven = tuple(pin.value() for pin in self._wet)
        self._electrode.value(0)
        self.wait_us(ELECTRODE_US)
        return sensors.leak(driven, tuple(pin.value() for pin in self._wet))

    # ------------------------------------------------------------------------------------------ the host

    def read(self) -> bytes:
        return bytes(self._port.read(256) or b"")

    def write(self, line: bytes) -> None:
        if self._port.dtr:
            self._outbox.add(line)
        else:
            self._outbox.clear()

    def pump(self) -> None:
        """Hand USB as much as it takes; called after each turn of the core."""
        while True:
            piece = self._outbox.piece()
            sent_count = self._port.write(piece) if piece else 0
            if not sent_count:
                return
            self._outbox.sent(sent_count)
