"""The coil chips' registers, by models that refuse what the chips refuse."""

from __future__ import annotations

import pytest

from drivers.keys.firmware.ldc import Ldc1614, Ldc3114, RegisterBus, found_on


class Model3114(RegisterBus):
    """Byte registers; what is written outside of configuration is ignored, as the chip does."""

    def __init__(self) -> None:
        self.registers = bytearray(256)
        self.registers[0xFC:0x100] = b"\x49\x54\x00\x40"
        self.registers[0x11] = 0x18
        self.busy = 3
        self.stubborn = False

    def readfrom_mem(self, address: int, register: int, count: int) -> bytes:
        if address != 0x2A:
            raise OSError
        if register == 0x00 and self.registers[0x0A] & 1 and not self.stubborn:
            self.busy -= 1
            self.registers[0] = 0x20 if self.busy <= 0 else 0
        return bytes(self.registers[register : register + count])

    def writeto_mem(self, address: int, register: int, data: bytes) -> None:
        if address != 0x2A:
            raise OSError
        if register == 0x0A:
            self.registers[register] = data[0]
            self.registers[0] &= ~0x20
        elif self.registers[0] & 0x20:
            self.registers[register : register + len(data)] = data


class Model1614(RegisterBus):
    """Registers of 16 bit, the high byte first; only CONFIG can be written while it is awake."""

    def __init__(self, forgets: int | None = None) -> None:
        self._forgets = forgets
        self.registers = {0x7E: 0x5449, 0x7F: 0x3055, 0x1A: 0x2801}

    def readfrom_mem(self, address: int, register: int, count: int) -> bytes:
        if address != 0x2A:
            raise OSError
        # A chip of this family has no bytes within a register: each transfer begins at its high byte.
        return self.registers.get(register, 0).to_bytes(2, "big")[:count] + bytes(max(0, count - 2))

    def writeto_mem(self, address: int, register: int, data: bytes) -> None:
        if address != 0x2A:
            raise OSError
        if register != self._forgets and (register == 0x1A or self.registers[0x1A] & 0x2000):
            self.registers[register] = int.from_bytes(data, "big")


def test_each_chip_is_told_by_its_identity_and_an_empty_bus_has_none() -> None:
    assert isinstance(found_on(Model3114(), 0x2A), Ldc3114)
    assert isinstance(found_on(Model1614(), 0x2A), Ldc1614)
    assert found_on(Model3114(), 0x2B) is None


def test_an_ldc3114_is_configured_only_when_it_lets_itself_be() -> None:
    model = Model3114()
    chip = Ldc3114(model, 0x2A)
    chip.set_up()
    assert model.busy <= 0, "it was waited for"
    assert (model.registers[0x0C], model.registers[0x0D], model.registers[0x11]) == (0x0F, 0x00, 0x10)
    assert model.registers[0x0A] == 0, "and runs"
    model.stubborn = True
    with pytest.raises(OSError, match="cannot be configured"):
        chip.set_up()


def test_an_ldc3114s_raw_counts_have_24_bit_with_the_low_byte_first() -> None:
    model = Model3114()
    model.registers[0x59:0x65] = bytes.fromhex("010203 ffffff 000000 0a0000")
    assert Ldc3114(model, 0x2A).counts() == [0x030201, None, None, 10]
    assert not Ldc3114.raises


def test_an_ldc1614_is_asleep_while_it_is_configured_and_then_converts_four_coils() -> None:
    model = Model1614()
    model.registers[0x1A] = 0x1601
    Ldc1614(model, 0x2A).set_up()
    assert model.registers[0x1A] & 0x2000 == 0
    assert model.registers[0x1B] >> 13 == 0b110, "all four in turn"
    for i in range(4):
        assert model.registers[0x08 + i] * 16 / 40e6 == pytest.approx(2e-3)
        assert model.registers[0x14 + i] == 0x1001
        assert model.registers[0x10 + i] > 3
        assert model.registers[0x1E + i] >> 11
    assert model.registers[0x19] & 0xF800 == 0xF800
    with pytest.raises(OSError, match="has not kept"):
        Ldc1614(Model1614(forgets=0x1B), 0x2A).set_up()


def test_an_ldc1614s_counts_have_28_bit_and_its_errors_are_no_counts() -> None:
    model = Model1614()
    model.registers |= {0x00: 0x0123, 0x01: 0x4567, 0x02: 0x8123, 0x03: 1, 0x04: 0x1FFF, 0x06: 0x0000, 0x07: 0x0007}
    assert Ldc1614(model, 0x2A).counts() == [0x1234567, None, None, 7]
    assert Ldc1614.raises
