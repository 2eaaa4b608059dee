"""The card obeys the kernel's rules, and what it scans out is what lights the scene."""

from __future__ import annotations

import ctypes
import errno
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.hw_sim.devices.conftest import Bench
from tests.hw_sim.devices.host import CardHost, greys, iowr, stripes

HDMI_A, DISPLAY_PORT = 11, 10
BLANK_US = 16_667


@pytest.fixture
def node(bench: Bench) -> Any:
    return bench.wires.open_card("/dev/dri/card0")


@pytest.fixture
def projector(node: Any) -> CardHost:
    head = CardHost(node, HDMI_A)
    for image in greys([10, 100, 200]):
        head.buffer(image)
    head.set_mode(0)
    return head


def refused(number: int) -> Any:
    """The call fails with that errno."""
    return pytest.raises(OSError, match=rf"\[Errno {number}\]")


def test_there_is_one_card(bench: Bench) -> None:
    with pytest.raises(FileNotFoundError):
        bench.wires.open_card("/dev/dri/card1")


def test_two_heads_with_their_native_modes_first(node: Any) -> None:
    projector, display = CardHost(node, HDMI_A), CardHost(node, DISPLAY_PORT)
    assert projector.size == (1024, 768)
    assert display.size == (800, 480)
    assert projector.crtc != display.crtc
    for head in (projector, display):
        info = head.connector_info(head.connector)
        assert info["connected"]
        for mode in info["modes"]:
            (clock_khz,) = struct.unpack_from("<I", mode)
            htotal, vtotal = struct.unpack_from("<H", mode, 10)[0], struct.unpack_from("<H", mode, 20)[0]
            assert abs(clock_khz * 1000 / (htotal * vtotal) - 60.0) < 0.5


def test_counts_are_asked_first_and_short_arrays_are_not_overrun(node: Any) -> None:
    head = CardHost(node, HDMI_A)
    form = "<4Q12I"
    guard = (ctypes.c_uint8 * 256)(*[0xEE] * 256)
    # Room for one mode only: the kernel copies all or none.
    head.call(0xA7, form, 0, ctypes.addressof(guard), 0, 0, 1, 0, 0, 0, head.connector, 0, 0, 0, 0, 0, 0, 0)
    assert set(guard) == {0xEE}
    # Room for one connector of two: it copies what fits.
    ids = (ctypes.c_uint32 * 2)(7, 7)
    counts = head.call(0xA0, "<4Q8I", 0, 0, ctypes.addressof(ids), 0, 0, 0, 1, 0, 0, 0, 0, 0)[4:8]
    assert counts[2] == 2
    assert ids[0] != 7
    assert ids[1] == 7


def test_a_null_pointer_is_a_fault_of_the_address(node: Any) -> None:
    head = CardHost(node, HDMI_A)
    with refused(errno.EFAULT):
        head.call(0xA0, "<4Q8I", 0, 0, 0, 0, 0, 2, 0, 0, 0, 0, 0, 0)


def test_unknown_things_are_not_there(projector: CardHost) -> None:
    with refused(errno.ENOENT):
        projector.connector_info(9999)
    with refused(errno.ENOENT):
        projector.call(0xB0, "<IIIIQ", projector.crtc, 9999, 1, 0, 0)
    with refused(errno.ENOENT):
        projector.call(0xB0, "<IIIIQ", 9999, projector.fbs[0][0], 1, 0, 0)
    with refused(errno.EINVAL):
        projector.call(0x9F, "<I", 0)
    with refused(errno.EINVAL):
        projector.call(0x0C, "<QQ", 0x999, 0)
    with refused(errno.ENOTTY):
        projector.node.ioctl(3 << 30 | 8 << 16 | ord("x") << 8, bytearray(8))
    with refused(errno.EINVAL):
        projector.node.map(4096, 0x1234)


def test_time_stamps_are_monotonic_and_dumb_buffers_exist(projector: CardHost) -> None:
    assert projector.call(0x0C, "<QQ", 0x1, 0)[1] == 1
    assert projector.call(0x0C, "<QQ", 0x6, 0)[1] == 1


def test_a_flip_happens_at_the_next_blank_and_says_so(bench: Bench, projector: CardHost) -> None:
    first = projector.show(1)
    second = projector.show(2)
    assert second["user"] == 2
    assert second["crtc"] == projector.crtc
    blanks = second["sequence"] - first["sequence"]
    assert blanks >= 1
    assert abs((second["time_ns"] - first["time_ns"]) / 1000 - blanks * BLANK_US) < 3
    assert second["time_ns"] <= bench.wires.clock.now_ns()
    assert (bench.world.scanned_out("projector") == 188).all(), "limited range until it is set"


def test_one_flip_may_be_pending(projector: CardHost) -> None:
    projector.flip(1)
    with refused(errno.EBUSY):
        projector.flip(2)
    projector.wait_flip()
    projector.flip(2)
    projector.wait_flip()


def test_a_flip_with_unknown_flags_is_refused(projector: CardHost) -> None:
    for flags, reserved in ((2, 0), (8, 0), (1, 5)):
        with refused(errno.EINVAL):
            projector.call(0xB0, "<IIIIQ", projector.crtc, projector.fbs[1][0], flags, reserved, 0)


def test_reading_without_an_event(projector: CardHost) -> None:
    with pytest.raises(BlockingIOError):
        projector.node.read(1024)
    assert projector.node.wait_readable(0.02) is False
    projector.flip(1)
    assert projector.node.wait_readable(1.0)
    assert projector.node.read(16) == b"", "events are read whole or not at all"
    assert len(projector.node.read(1024)) == 32


def test_the_range_is_limited_until_it_is_set_to_full(bench: Bench, projector: CardHost) -> None:
    ramp = projector.buffer(np.tile((np.arange(1024) // 4).astype(np.uint8), (768, 1)))
    projector.show(ramp)
    shown = bench.world.scanned_out("projector")
    assert (shown.min(), shown.max()) == (16, 235)
    projector.set_property("Broadcast RGB", "Limited 16:235")
    projector.show(ramp)
    assert bench.world.scanned_out("projector").min() == 16
    projector.set_property("Broadcast RGB", "Full")
    projector.show(ramp)
    assert (bench.world.scanned_out("projector")[0] == np.arange(1024) // 4).all()
    with refused(errno.EINVAL):
        projector.call(0xBA, "<QIIII", 9, projector.property_named("Broadcast RGB")[0], projector.connector, 0, 0)


def test_only_green_lights_the_scene_and_the_display_shows_all(bench: Bench, node: Any) -> None:
    projector, display = CardHost(node, HDMI_A), CardHost(node, DISPLAY_PORT)
    projector.set_property("Broadcast RGB", "Full")
    for head in (projector, display):
        width, height = head.size
        head.buffer(np.zeros((height, width), np.uint8))
        head.fbs[0][1][:] = (11, 22, 33, 0)  # blue, green, red
        head.set_mode(0)
        head.show(0)
    assert (bench.world.scanned_out("projector") == 22).all()
    shown = bench.world.scanned_out("display")
    assert shown.shape == (480, 800, 3)
    assert (shown == (33, 22, 11)).all()


def test_the_beamer_stretches_a_mode_that_is_not_its_own(bench: Bench, projector: CardHost) -> None:
    projector.set_property("Broadcast RGB", "Full")
    mode = next(
        m
        for m in projector.connector_info(projector.connector)["modes"]
        if struct.unpack_from("<IH8xH", m)[1:] == (800, 600)
    )
    projector.mode = mode
    columns = projector.buffer(np.tile((np.arange(800) % 256).astype(np.uint8), (600, 1)))
    projector.set_mode(columns)
    projector.show(columns)
    shown = bench.world.scanned_out("projector")
    assert shown.shape == (768, 1024)
    assert shown[0, 512] == 400 % 256


def test_a_mode_the_monitor_does_not_have_is_refused(projector: CardHost) -> None:
    projector.mode = struct.pack("<I", 99_000) + projector.mode[4:]
    with refused(errno.EINVAL):
        projector.set_mode(0)


def test_a_small_framebuffer_cannot_be_shown(projector: CardHost) -> None:
    small = projector.buffer(np.zeros((480, 640), np.uint8))
    with refused(errno.ENOSPC):
        projector.flip(small)
    with refused(errno.ENOSPC):
        projector.set_mode(small)


@pytest.mark.parametrize(("bpp", "depth", "pitch"), [(16, 16, 4096), (32, 32, 4096), (32, 24, 4095), (32, 24, 8192)])
def test_a_framebuffer_must_fit_its_buffer(projector: CardHost, bpp: int, depth: int, pitch: int) -> None:
    handle = projector.call(0xB2, "<6IQ", 768, 1024, 32, 0, 0, 0, 0)[4]
    with refused(errno.EINVAL):
        projector.call(0xAE, "<7I", 0, 1024, 768, pitch, bpp, depth, handle)


def test_the_memory_is_shared_without_a_flip(bench: Bench, projector: CardHost) -> None:
    projector.set_property("Broadcast RGB", "Full")
    projector.show(1)
    projector.fbs[1][1][:] = 77
    projector.show(1)
    assert (bench.world.scanned_out("projector") == 77).all()


def test_the_first_opener_is_master_and_hands_over(bench: Bench, projector: CardHost) -> None:
    other = CardHost(bench.wires.open_card("/dev/dri/card0"), HDMI_A)
    other.buffer(greys([50])[0])
    with refused(errno.EACCES):
        other.set_mode(0)
    with refused(errno.EACCES):
        other.flip(0)
    set_master, drop_master = ord("d") << 8 | 0x1E, ord("d") << 8 | 0x1F
    with refused(errno.EBUSY):
        other.node.ioctl(set_master, bytearray())
    with refused(errno.EINVAL):
        other.node.ioctl(drop_master, bytearray())
    projector.node.ioctl(set_master, bytearray())  # already is
    projector.node.ioctl(drop_master, bytearray())
    other.node.ioctl(set_master, bytearray())
    other.set_mode(0)
    with refused(errno.EACCES):
        projector.flip(1)
    with refused(errno.ENOENT):
        projector.call(0xAF, "<I", other.fbs[0][0])


def test_removing_what_is_shown_darkens_the_head(bench: Bench, projector: CardHost) -> None:
    projector.show(2)
    projector.call(0xAF, "<I", projector.fbs[2][0])
    bench.wires.clock.sleep_s(0.1)
    assert not bench.world.scanned_out("projector").any()
    assert bench.board.ask("VSYNC")[:2] == ["N", "4"]
    with refused(errno.EBUSY):
        projector.flip(1)


def test_closing_gives_the_card_back_to_the_console(bench: Bench, projector: CardHost) -> None:
    projector.show(2)
    projector.node.close()
    projector.node.close()
    bench.wires.clock.sleep_s(0.04)
    assert (bench.world.scanned_out("projector") == 16).all(), "black, in limited range"
    with refused(errno.EBADF):
        projector.flip(1)
    again = CardHost(bench.wires.open_card("/dev/dri/card0"), HDMI_A)
    again.set_mode(again.buffer(stripes(16)))
    assert again.show(0)["sequence"] > 0


def test_a_waiting_flip_is_answered_even_when_the_mode_goes(projector: CardHost) -> None:
    projector.flip(1, user_data=5)
    projector.call(0xA2, "<QIIIIIII68s", 0, 0, projector.crtc, 0, 0, 0, 0, 0, b"")
    assert projector.wait_flip(0.5)["user"] == 5


def test_the_screen_follows_the_beamers_latency_fault(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench()
    projector = bench.projector()
    a, b, c = (projector.buffer(g) for g in greys([40, 80, 120]))
    projector.show(a)
    bench.world.fault("projector wrong")
    projector.show(a)
    for image, before in ((b, 40), (c, 80), (a, 120)):
        projector.show(image)
        assert (bench.world.scanned_out("projector") == before).all()
    bench.world.fault("projector off")
    projector.show(b)
    assert not bench.world.scanned_out("projector").any()


def test_each_flip_is_late_once(bench: Bench) -> None:
    projector = bench.projector()
    image = projector.buffer(greys([40])[0])
    last = projector.show(image)
    bench.world.fault("projector delayed")
    late = projector.show(image)
    later = projector.show(image)
    assert late["sequence"] >= last["sequence"] + 2
    assert later["sequence"] >= late["sequence"] + 2
    assert later["sequence"] <= late["sequence"] + 3


def test_version_names_the_driver(node: Any) -> None:
    name = ctypes.create_string_buffer(3)
    buffer = bytearray(struct.pack("<iiixxxxQQQQQQ", 0, 0, 0, 3, ctypes.addressof(name), 0, 0, 0, 0))
    node.ioctl(iowr(0x00, len(buffer)), buffer)
    major, *_, length, _, _, _, _, _ = struct.unpack("<iiixxxxQQQQQQ", buffer)
    assert (major, length) == (1, 5)
    assert name.raw == b"kfs", "no more than there is room for"
