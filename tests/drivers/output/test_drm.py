"""The bytes are the kernel's: sizes, numbers and offsets as a C compiler makes them of drm.h and drm_mode.h."""

from __future__ import annotations

import struct

import pytest

from drivers.output import drm

# 1024×768 at 60 Hz as VESA times it: 65 MHz, 1344 × 806 in all, both syncs negative, preferred by the driver.
XGA = bytes.fromhex(
    "e8fd0000 0004 1804 a004 4005 0000 0003 0303 0903 2603 0000 3c000000 0a000000 48000000".replace(" ", "")
) + b"1024x768".ljust(32, b"\0")


@pytest.mark.parametrize(
    ("at", "changed", "told"),
    [
        (0, "", ("60.004", True, True)),  # not the rounded 60 of vrefresh
        *((at, bytes(size).hex(), ("60.000", True, True)) for at, size in ((0, 4), (10, 2), (20, 2))),  # no timing
        *((28, flags, ("60.004", True, True)) for flags in ("00000000", "0f000000", "40000000")),
        *((28, flags, ("60.004", False, True)) for flags in ("10000000", "20000000")),  # interlaced, doubled
        *((32, kind, ("60.004", True, False)) for kind in ("40000000", "37000000")),
        (32, "08000000", ("60.004", True, True)),
    ],
)
def test_a_mode_is_read_from_the_kernels_bytes(at: int, changed: str, told: tuple[str, bool, bool]) -> None:
    raw = XGA[:at] + bytes.fromhex(changed) + XGA[at + len(changed) // 2 :]
    mode = drm.Mode.unpack(raw)
    assert (mode.width_px, mode.height_px, mode.raw) == (1024, 768, raw)
    assert (f"{mode.refresh_hz:.3f}", mode.progressive, mode.preferred) == told
    assert str(mode) == f"1024×768 60.00 Hz{'' if mode.progressive else ' interlaced'}"


def event(token: int, sequence: int, kind: int = 2, length: int = 32) -> bytes:
    return struct.pack("<IIQIIII", kind, length, token, 7, 16_667, sequence, 42).ljust(length, b"\0")[:length]


def test_several_reports_in_one_read_come_apart_and_others_are_passed_over() -> None:
    first, second = drm.parse_events(event(3, 100) + event(4, 101))
    assert (first.token, first.raw_sequence, first.time_ns) == (3, 100, 7_016_667_000)
    assert (second.token, second.raw_sequence) == (4, 101)
    other = struct.pack("<II4s", 0x80000000, 12, b"abcd")
    mixed = event(1, 5, kind=1) + other + event(2, 6) + event(5, 5, length=40) + event(6, 6, length=24) + event(7, 7)
    assert [flip.token for flip in drm.parse_events(mixed)] == [2, 5, 7], "a longer one is read, a shorter one is none"
    assert drm.parse_events(b"") == []
    for out_of_step in (event(1, 1)[:5], event(1, 1)[:20], event(1, 1) + bytes(8)):
        with pytest.raises(ValueError, match="DRM event"):
            drm.parse_events(out_of_step)


def test_connectors_are_named_as_in_sys_class_drm() -> None:
    names = {11: "HDMI-A-3", 10: "DP-3", 15: "Virtual-3", 14: "eDP-3", 2: "DVI-I-3", 1: "VGA-3", 20: "USB-3"}
    names |= dict.fromkeys((0, 21, 99), "Unknown-3")
    assert {kind: drm.connector_name(kind, 3) for kind in names} == names
