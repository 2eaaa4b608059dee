"""The sensors' bits as values: worked examples of the datasheets."""

from __future__ import annotations

import pytest

from drivers.board.firmware import sensors
from tests.drivers.board.firmware.emulated import sht40


@pytest.mark.parametrize(
    ("raw", "celsius", "written"),
    [
        *(("0000", 0.0, "0.00"), ("0c80", 25.0, "25.00"), ("f380", -25.0, "-25.00"), ("0001", 0.0078125, "0.01")),
        *(("3200", 100.0, "100.00"), ("ffc0", -0.5, "-0.50"), ("8000", None, "-")),
    ],
)
def test_a_tmp117_counts_in_steps_of_a_128th_and_no_value_is_a_dash(
    raw: str, celsius: float | None, written: str
) -> None:
    assert sensors.tmp117_c(bytes.fromhex(raw)) == celsius
    assert sensors.written(celsius, 2) == written


def test_an_sht40_gives_temperature_and_humidity_or_with_a_wrong_bit_nothing() -> None:
    assert sensors.crc8(b"\xbe\xef") == 0x92, "the checksum of its datasheet"
    assert sensors.sht40(sht40(0, 0)) == (-45.0, 0.0), "-6 % is dry"
    assert sensors.sht40(sht40(65535, 65535)) == (130.0, 100.0), "119 % is wet"
    raw = sht40(0x6666, 0x7333)
    assert sensors.sht40(raw) == pytest.approx((25.0, 50.25), abs=0.01)
    assert sensors.sht40(raw[:5]) is None
    for spoilt in (0, 2, 3, 5):
        assert sensors.sht40(raw[:spoilt] + bytes([raw[spoilt] ^ 0x10]) + raw[spoilt + 1 :]) is None


def test_the_supply_is_read_through_its_divider() -> None:
    assert sensors.supply_v(65535, 3300.0, 11.0) == pytest.approx(36.3)


@pytest.mark.parametrize(("milliampere", "on"), [(0.0, False), (9.9, False), (10.1, True), (120.0, True)])
def test_a_laser_is_on_where_its_current_flows(milliampere: float, on: bool) -> None:
    counts = round(milliampere * 20.0 / 3300.0 * 65535)
    assert sensors.laser_conducts(counts, 3300.0, 20.0, 10.0) is on


@pytest.mark.parametrize(
    ("driven", "undriven", "told"),
    [((0, 0), (0, 0), "0"), ((1, 0), (0, 0), "1"), ((0, 1), (0, 0), "1"), ((0, 0), (0, 1), "1")],
)
def test_any_wet_electrode_is_a_leak(driven: tuple[int, ...], undriven: tuple[int, ...], told: str) -> None:
    assert sensors.leak(driven, undriven) == told
