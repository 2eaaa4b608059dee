"""The bytes are the kernel's: sizes, numbers and offsets as a C compiler makes them of drm.h and drm_mode.h."""

from __future__ import annotations

import pytest

from drivers.output import drm

# 1024×768 at 60 Hz as VESA times it: 65 MHz, 1344 × 806 in all, both syncs negative, preferred by the driver.
XGA = bytes.fromhex(
    "e8fd0000 0004 1804 a004 4005 0000 0003 0303 0903 2603 0000 3c000000 0a000000 48000000".replace(" ", "")
) + b"1024x768".ljust(32, b"\0")


def test_a_mode_is_read_from_the_kernels_bytes() -> None:
    mode = drm.Mode.unpack(XGA)
    assert (mode.width_px, mode.height_px, mode.preferred, mode.progressive) == (1024, 768, True, True)
    assert mode.refresh_hz == pytest.approx(60.004, abs=0.001)  # not the rounded 60 of vrefresh
    assert mode.raw == XGA


@pytest.mark.parametrize(("at", "size"), [(0, 4), (10, 2), (20, 2)], ids=["clock", "htotal", "vtotal"])
def test_a_mode_without_timing_has_its_rounded_refresh(at: int, size: int) -> None:
    assert drm.Mode.unpack(XGA[:at] + bytes(size) + XGA[at + size :]).refresh_hz == 60.0


def event(token: int, sequence: int, kind: int = 2, seconds: int = 7, microseconds: int = 16_667) -> bytes:
    fields = [kind.to_bytes(4, "little"), (32).to_bytes(4, "little"), token.to_bytes(8, "little")]
    fields += [value.to_bytes(4, "little") for value in (seconds, microseconds, sequence, 42)]
    return b"".join(fields)


def test_several_reports_in_one_read_come_apart() -> None:
    first, second = drm.parse_events(event(3, 100) + event(4, 101))
    assert (first.token, first.raw_sequence, first.time_ns) == (3, 100, 7_016_667_000)
    assert (second.token, second.raw_sequence) == (4, 101)
    other = (0x80000000).to_bytes(4, "little") + (12).to_bytes(4, "little") + b"abcd"
    assert [flip.token for flip in drm.parse_events(event(1, 5, kind=1) + other + event(2, 6))] == [2]


@pytest.mark.parametrize("data", [event(1, 1)[:5], event(1, 1)[:20], event(1, 1) + bytes(8)])
def test_a_stream_out_of_step_is_an_error_not_a_loop(data: bytes) -> None:
    with pytest.raises(ValueError, match="DRM event"):
        drm.parse_events(data)


def test_a_report_that_is_longer_than_ours_is_read_and_a_shorter_one_is_none() -> None:
    longer = event(1, 5)[:4] + (40).to_bytes(4, "little") + event(1, 5)[8:] + bytes(8)
    shorter = event(2, 6)[:4] + (24).to_bytes(4, "little") + event(2, 6)[8:24]
    assert [flip.token for flip in drm.parse_events(longer + shorter + event(3, 7))] == [1, 3]
    assert drm.parse_events(b"") == []


@pytest.mark.parametrize(
    ("flags", "progressive"), [(0, True), (0x0F, True), (0x10, False), (0x20, False), (0x40, True)]
)
def test_interlaced_and_doubled_modes_are_not_progressive(flags: int, progressive: bool) -> None:
    mode = drm.Mode.unpack(XGA[:28] + flags.to_bytes(4, "little") + XGA[32:])
    assert mode.progressive == progressive
    assert str(mode) == f"1024×768 60.00 Hz{'' if progressive else ' interlaced'}"


@pytest.mark.parametrize(("kind", "preferred"), [(0x40, False), (0x48, True), (0x08, True), (0x37, False)])
def test_the_preferred_mode_is_known_by_its_bit(kind: int, preferred: bool) -> None:
    assert drm.Mode.unpack(XGA[:32] + kind.to_bytes(4, "little") + XGA[36:]).preferred == preferred


NAMES = {
    11: "HDMI-A-1",
    10: "DP-1",
    15: "Virtual-1",
    14: "eDP-1",
    2: "DVI-I-1",
    1: "VGA-1",
    0: "Unknown-1",
    20: "USB-1",
}


def test_connectors_are_named_as_in_sys_class_drm() -> None:
    assert {kind: drm.connector_name(kind, 1) for kind in NAMES} == NAMES
    assert [drm.connector_name(kind, 3) for kind in (10, 21, 99)] == ["DP-3", "Unknown-3", "Unknown-3"]
