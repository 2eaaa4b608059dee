"""The graphics card's system calls, judged by the kernel's rules, and the light that they cause."""

from __future__ import annotations

import ctypes
import errno
import itertools
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hw_sim.devices import drm_abi as abi
from hw_sim.devices.card import Card
from hw_sim.devices.head import Output
from hw_sim.timing.world_time import BLANK_NS
from hw_sim.wires.card_node import SimCardNode
from tests.hw_sim.devices.bench import Bench, bench
from tests.hw_sim.devices.host import CardHost, iowr

HDMI, DISPLAY_PORT = 11, 10
RAMP = np.tile((np.arange(1024) // 4).astype(np.uint8), (768, 1))


class Machine:
    """A card at a bench and what has it open."""

    def __init__(self, made: Bench) -> None:
        self.bench = made
        self.card = Card(made.time.condition.notify_all)
        self.late: Output | None = None
        made.on_blank = lambda time_ns: self.card.vblank(time_ns, self.late)

    def open(self) -> SimCardNode:
        return SimCardNode(self.card, self.bench.time)

    def head(self, kind: int = HDMI, node: SimCardNode | None = None) -> CardHost:
        """A head that shows black."""
        head = CardHost(node or self.open(), kind)
        width, height = head.size
        head.buffer(np.zeros((height, width), np.uint8))
        head.set_mode(0)
        return head


@pytest.fixture
def machine() -> Iterator[Machine]:
    with bench() as made:
        yield Machine(made)


@contextmanager
def fails(number: int) -> Iterator[None]:
    with pytest.raises(OSError) as caught:
        yield
    assert caught.value.errno == number, errno.errorcode[caught.value.errno or 0]


def grey(head: CardHost, value: int) -> NDArray[np.uint8]:
    width, height = head.size
    return np.full((height, width), value, np.uint8)


# ---------------------------------------------------------------------------------------------- structures


@pytest.mark.parametrize(
    ("structure", "size"),
    [
        *((abi.Version, 64), (abi.Cap, 16), (abi.Modeinfo, 68), (abi.Resources, 64), (abi.ModeCrtc, 104)),
        *((abi.CrtcLut, 32), (abi.Encoder, 20), (abi.ModeGetConnector, 80), (abi.PropertyEnum, 40), (abi.Property, 64)),
        *((abi.ConnectorSetProperty, 16), (abi.ObjectProperties, 32), (abi.ObjectSetProperty, 24), (abi.Fb, 28)),
        *((abi.PageFlip, 24), (abi.CreateDumb, 32), (abi.MapDumb, 16)),
    ],
)
def test_structures_have_the_sizes_of_the_kernels(structure: type[ctypes.Structure], size: int) -> None:
    """sizeof() of a C compiler on x86-64 with linux/drm_mode.h."""
    assert ctypes.sizeof(structure) == size
    assert abi.FLIP_COMPLETE.size == 32


def test_calls_of_another_kind_or_unknown_are_refused(machine: Machine) -> None:
    node = machine.open()
    with fails(errno.ENOTTY):
        node.ioctl(3 << 30 | 4 << 16 | ord("T") << 8 | 1, bytearray(4))
    with fails(errno.EINVAL):
        node.ioctl(iowr(0xBF, 8), bytearray(8))
    with fails(errno.EFAULT):
        node.ioctl(iowr(0xA0, 64), bytearray(60))
    node.close()
    node.close()
    with fails(errno.EBADF):
        node.ioctl(iowr(0xA0, 64), bytearray(64))


# ---------------------------------------------------------------------------------------------- what there is


def test_the_two_monitors_and_their_native_modes(machine: Machine) -> None:
    node = machine.open()
    for kind, size in ((HDMI, (1024, 768)), (DISPLAY_PORT, (800, 480))):
        head = CardHost(node, kind)
        info = head.connector_info(head.connector)
        assert info["connected"]
        assert head.size == size
        assert len(info["modes"]) > 1
        for index, mode in enumerate(info["modes"]):
            clock_khz, width, hs, he, htotal, _, height, vs, ve, vtotal, _, hz, _, kinds = struct.unpack_from(
                "<I10H3I", mode
            )
            assert width < hs < he < htotal
            assert height < vs < ve < vtotal
            assert clock_khz * 1000 / (htotal * vtotal) == pytest.approx(60, abs=0.6)
            assert hz == 60
            assert bool(kinds & 8) == (index == 0), "only the native mode is the preferred one"
            assert mode[36:].rstrip(b"\0") == f"{width}x{height}".encode()


def test_an_array_that_is_too_short_is_not_overrun(machine: Machine) -> None:
    node = machine.open()
    head = CardHost(node, HDMI)
    guarded = (ctypes.c_uint32 * 2)(0, 0xDEADBEEF)
    got = head.call(0xA0, "<4Q8I", 0, 0, ctypes.addressof(guarded), 0, 0, 0, 1, 0, 0, 0, 0, 0)
    assert got[4:8] == [0, 2, 2, 2]
    assert guarded[0] in head.resources()[1]
    assert guarded[1] == 0xDEADBEEF
    modes = ctypes.create_string_buffer(b"\xaa" * 68, 68)
    head.call(0xA7, "<4Q12I", 0, ctypes.addressof(modes), 0, 0, 1, 0, 0, 0, head.connector, *[0] * 7)
    assert modes.raw == b"\xaa" * 68, "modes come all or not at all"


def test_a_pointer_to_nowhere_is_a_fault(machine: Machine) -> None:
    with fails(errno.EFAULT):
        CardHost(machine.open(), HDMI).call(0xA0, "<4Q8I", *[0] * 4, 0, 2, 2, 2, *[0] * 4)


@pytest.mark.parametrize(("number", "form", "at"), [(0xA7, "<4Q12I", 8), (0xA6, "<5I", 0), (0xA1, "<Q7I68s", 2)])
def test_unknown_objects_are_not_found(machine: Machine, number: int, form: str, at: int) -> None:
    values: list[Any] = list(struct.unpack(form, bytes(struct.calcsize(form))))
    values[at] = 4711
    buffer = bytearray(struct.pack(form, *values))
    with fails(errno.ENOENT):
        machine.open().ioctl(iowr(number, len(buffer)), buffer)


@pytest.mark.parametrize(("cap", "value"), [(0x1, 1), (0x6, 1), (0x12, 1), (0x7, 0)])
def test_capabilities(machine: Machine, cap: int, value: int) -> None:
    """Dumb buffers, monotonic time stamps, events that name their engine; no tearing flips."""
    head = CardHost(machine.open(), HDMI)
    assert head.call(0x0C, "<QQ", cap, 99) == [cap, value]
    with fails(errno.EINVAL):
        head.call(0x0C, "<QQ", 0x99, 0)


# ---------------------------------------------------------------------------------------------- flips


def test_a_flip_happens_at_the_next_blank_and_says_so(machine: Machine) -> None:
    head = machine.head()
    head.set_property("Broadcast RGB", "Full")
    white = head.buffer(grey(head, 255))
    head.flip(white, 0xFEEDFACECAFE)
    assert machine.card.flip_pending(Output.PROJECTOR)
    assert not machine.card.projected().any(), "not before the blank"
    assert not head.node.wait_readable(0.0)
    with pytest.raises(BlockingIOError):
        head.node.read(1024)
    machine.bench.blanks(1)
    event = head.wait_flip()
    assert event["user"] == 0xFEEDFACECAFE
    assert event["time_ns"] == machine.bench.time.blank_ns // 1000 * 1000
    assert event["crtc"] == head.crtc
    assert (machine.card.projected() == 255).all()
    assert not machine.card.flip_pending(Output.PROJECTOR)


def test_sequence_and_time_stamps_count_every_blank(machine: Machine) -> None:
    head = machine.head()
    first = head.buffer(grey(head, 10))
    events = []
    for waiting in (1, 1, 3, 1):
        machine.bench.blanks(waiting - 1)
        head.flip(first)
        machine.bench.blanks(1)
        events.append(head.wait_flip())
    pairs = list(itertools.pairwise(events))
    assert [b["sequence"] - a["sequence"] for a, b in pairs] == [1, 3, 1]
    for a, b in pairs:
        blanks = b["sequence"] - a["sequence"]
        assert b["time_ns"] - a["time_ns"] == pytest.approx(blanks * BLANK_NS, abs=2000)


def test_a_second_flip_is_busy_until_the_first_is_done(machine: Machine) -> None:
    head = machine.head()
    head.flip(0, 1)
    with fails(errno.EBUSY):
        head.flip(0, 2)
    machine.bench.blanks(1)
    head.flip(0, 3)
    machine.bench.blanks(1)
    assert [event[2] for event in struct.iter_unpack("<IIQIIII", head.node.read(1024))] == [1, 3]


def test_both_heads_share_the_blank(machine: Machine) -> None:
    node = machine.open()
    heads = [machine.head(kind, node) for kind in (HDMI, DISPLAY_PORT)]
    for head in heads:
        head.flip(0, head.crtc)
    machine.bench.blanks(1)
    data = node.read(1024)
    events = list(struct.iter_unpack("<IIQIIII", data))
    assert [e[2] for e in events] == [e[6] for e in events] == [h.crtc for h in heads]
    assert events[0][3:5] == events[1][3:5]


def test_a_late_flip_completes_one_blank_later(machine: Machine) -> None:
    head = machine.head()
    head.flip(0)
    machine.bench.blanks(1)
    before = head.wait_flip()
    head.flip(0)
    machine.late = Output.PROJECTOR
    machine.bench.blanks(1)
    assert machine.card.flip_pending(Output.PROJECTOR)
    machine.late = None
    machine.bench.blanks(1)
    assert head.wait_flip()["sequence"] == before["sequence"] + 2


def test_a_short_read_leaves_the_event(machine: Machine) -> None:
    head = machine.head()
    head.flip(0, 5)
    machine.bench.blanks(1)
    assert head.node.read(31) == b""
    assert head.wait_flip()["user"] == 5


def test_events_that_nobody_reads_are_bounded(machine: Machine) -> None:
    head = machine.head()
    with fails(errno.ENOMEM):
        for _ in range(200):
            head.flip(0)
            machine.bench.blanks(1)
    read = 0
    while head.node.wait_readable(0.0):
        read += len(head.node.read(4096)) // 32
    assert read == 128, "the kernel keeps 4096 bytes"
    head.flip(0)


def test_flags_and_framebuffers_of_a_flip_are_checked(machine: Machine) -> None:
    head = machine.head()
    fb = head.fbs[0][0]
    for flags, reserved in ((2, 0), (1, 1), (0x100, 0)):
        with fails(errno.EINVAL):
            head.call(0xB0, "<IIIIQ", head.crtc, fb, flags, reserved, 0)
    with fails(errno.ENOENT):
        head.call(0xB0, "<IIIIQ", head.crtc, 9999, 1, 0, 0)
    small = head.buffer(np.zeros((480, 640), np.uint8))
    with fails(errno.ENOSPC):
        head.flip(small)


# ---------------------------------------------------------------------------------------------- light


def test_until_full_range_is_chosen_codes_are_compressed(machine: Machine) -> None:
    """CTA-861: limited range maps 0..255 to 16..235."""
    head = machine.head()
    ramp = head.buffer(RAMP)
    head.flip(ramp)
    machine.bench.blanks(1)
    limited = machine.card.projected()
    assert (int(limited[0, 0]), int(limited[0, 1023])) == (16, 235)
    assert np.abs(limited - (16 + RAMP * (219 / 255))).max() <= 0.5
    head.set_property("Broadcast RGB", "Full")
    assert np.array_equal(machine.card.projected(), RAMP)
    head.set_property("Broadcast RGB", "Limited 16:235")
    assert np.array_equal(machine.card.projected(), limited)


def test_only_green_leaves_the_projector_and_the_display_keeps_its_colours(machine: Machine) -> None:
    node = machine.open()
    beam, display = machine.head(HDMI, node), machine.head(DISPLAY_PORT, node)
    beam.set_property("Broadcast RGB", "Full")
    for head in (beam, display):
        pixels = head.fbs[0][1]
        pixels[..., 0], pixels[..., 1], pixels[..., 2] = 11, 22, 33  # XRGB8888: blue, green, red
    assert (machine.card.projected() == 22).all(), "what is drawn into the front buffer is scanned out"
    shown = machine.card.displayed()
    assert shown.shape == (480, 800, 3)
    assert (shown == (33, 22, 11)).all()
    shown[:] = 0
    assert machine.card.displayed().any(), "a copy"


def test_a_dark_head_gives_no_light(machine: Machine) -> None:
    head = machine.head()
    head.set_property("Broadcast RGB", "Full")
    head.fbs[0][1][:] = 200
    head.set_property("DPMS", "Off")
    assert machine.card.projected().shape == (768, 1024)
    assert not machine.card.projected().any()
    assert machine.card.crtc(Output.PROJECTOR) is None
    with fails(errno.EINVAL):
        head.flip(0)
    head.set_property("DPMS", "On")
    assert (machine.card.projected() == 200).all()
    head.call(0xAF, "<I", head.fbs[0][0])
    assert machine.card.crtc(Output.PROJECTOR) is None, "without its framebuffer a head goes dark"
    with fails(errno.EBUSY):
        head.call(0xB0, "<IIIIQ", head.crtc, head.fbs[0][0], 1, 0, 0)


def test_a_pending_flip_is_answered_when_its_monitor_is_sent_to_sleep(machine: Machine) -> None:
    head = machine.head()
    head.flip(0, 8)
    head.set_property("DPMS", "Off")
    assert head.wait_flip(0.0)["user"] == 8


def test_an_engine_that_loses_its_monitor_is_switched_off(machine: Machine) -> None:
    node = machine.open()
    beam, display = machine.head(HDMI, node), machine.head(DISPLAY_PORT, node)
    beam.flip(0, 9)
    display.crtc, display.mode, display.connector, display.fbs = beam.crtc, beam.mode, beam.connector, beam.fbs
    beam.crtc = next(c for c in beam.resources()[0] if c != beam.crtc)
    beam.set_mode(0)
    assert display.wait_flip(0.0)["user"] == 9
    with fails(errno.EBUSY):
        display.flip(0)
    beam.flip(0, 10)
    machine.bench.blanks(1)
    assert beam.wait_flip()["user"] == 10


def gamma(head: CardHost, number: int, tables: NDArray[np.uint16], size: int = 256) -> None:
    pointers = [row.ctypes.data for row in tables]
    head.call(number, "<IIQQQ", head.crtc, size, *pointers)


def test_the_gamma_table_is_linear_until_set_and_acts_before_the_range(machine: Machine) -> None:
    head = machine.head()
    head.buffer(RAMP)
    head.flip(1)
    machine.bench.blanks(1)
    got = np.zeros((3, 256), np.uint16)
    gamma(head, 0xA4, got)
    assert np.array_equal(got >> 8, np.tile(np.arange(256), (3, 1)))
    tables = np.zeros((3, 256), np.uint16)
    tables[1] = np.arange(255, -1, -1) * 257
    gamma(head, 0xA5, tables)
    got[:] = 0
    gamma(head, 0xA4, got)
    assert np.array_equal(got, tables)
    assert (machine.card.projected()[0, [0, 1023]] == (235, 16)).all()
    head.set_property("Broadcast RGB", "Full")
    assert np.array_equal(machine.card.projected(), 255 - RAMP)
    with fails(errno.EINVAL):
        gamma(head, 0xA5, tables, 255)


# ---------------------------------------------------------------------------------------------- rights, lifetimes


def test_only_the_master_changes_what_is_shown(machine: Machine) -> None:
    first, second = machine.head(), CardHost(machine.open(), HDMI)
    index = second.buffer(grey(second, 0))
    with fails(errno.EACCES):
        second.flip(index)
    with fails(errno.EACCES):
        second.set_mode(index)
    with fails(errno.EACCES):
        second.set_property("Broadcast RGB", "Full")
    with fails(errno.EACCES):
        gamma(second, 0xA5, np.zeros((3, 256), np.uint16))
    with fails(errno.EBUSY):
        second.node.ioctl(0x641E, bytearray())
    first.node.ioctl(0x641F, bytearray())
    second.node.ioctl(0x641E, bytearray())
    second.set_mode(index)
    with fails(errno.EINVAL):
        first.node.ioctl(0x641F, bytearray())


def test_nobody_removes_anothers_framebuffer(machine: Machine) -> None:
    head, other = machine.head(), CardHost(machine.open(), HDMI)
    with fails(errno.ENOENT):
        other.call(0xAF, "<I", head.fbs[0][0])


def test_the_console_returns_when_the_last_node_closes(machine: Machine) -> None:
    head = machine.head()
    head.fbs[0][1][:] = 255
    assert machine.card.projected().any()
    head.flip(0)
    head.node.close()
    assert not machine.card.flip_pending(Output.PROJECTOR)
    assert machine.card.crtc(Output.PROJECTOR) is not None, "black, with video running"
    assert (machine.card.projected() == 16).all()
    machine.head(HDMI)  # the next opener is master


def test_a_set_mode_the_monitor_does_not_list_is_refused(machine: Machine) -> None:
    head = machine.head()
    right = head.mode
    head.mode = struct.pack("<IH", 65_000, 1000) + right[6:]
    with fails(errno.EINVAL):
        head.set_mode(0)
    head.mode = right
    connectors = (ctypes.c_uint32 * 1)(4711)
    call = struct.pack("<Q7I", ctypes.addressof(connectors), 1, head.crtc, head.fbs[0][0], 0, 0, 0, 1) + right
    with fails(errno.ENOENT):
        head.node.ioctl(iowr(0xA2, len(call)), bytearray(call))


@pytest.mark.parametrize(
    ("width", "height", "bpp", "depth", "pitch"),
    [(1024, 768, 32, 24, 4095), (1024, 769, 32, 24, 4096), (1024, 768, 16, 16, 4096), (0, 768, 32, 24, 4096)],
    ids=["pitch", "too high", "16 bit", "no width"],
)
def test_a_framebuffer_must_fit_its_memory(
    machine: Machine, width: int, height: int, bpp: int, depth: int, pitch: int
) -> None:
    head = CardHost(machine.open(), HDMI)
    handle = head.call(0xB2, "<6IQ", 768, 1024, 32, 0, 0, 0, 0)[4]
    with fails(errno.EINVAL):
        head.call(0xAE, "<7I", 0, width, height, pitch, bpp, depth, handle)
    with fails(errno.ENOENT):
        head.call(0xAE, "<7I", 0, 1024, 768, 4096, 32, 24, handle + 1)


def test_memory_is_mapped_once_asked_for_and_outlives_its_handle_on_screen(machine: Machine) -> None:
    head = machine.head()
    node = head.node
    with fails(errno.EINVAL):
        node.map(4096, 0x1234000)
    handle, _, size = head.call(0xB2, "<6IQ", 768, 1024, 32, 0, 0, 0, 0)[4:]
    offset = head.call(0xB3, "<IIQ", handle, 0, 0)[2]
    with fails(errno.EINVAL):
        node.map(size + 1, offset)
    memory = node.map(size, offset)
    memory[:] = b"\xff" * size
    assert not memory.readonly
    fb = head.call(0xAE, "<7I", 0, 1024, 768, 4096, 32, 24, handle)[0]
    head.call(0xB4, "<I", handle)
    with fails(errno.ENOENT):
        head.call(0xB4, "<I", handle)
    head.call(0xB0, "<IIIIQ", head.crtc, fb, 0, 0, 0)
    machine.bench.blanks(1)
    assert (machine.card.projected() == 235).all()
    assert not node.wait_readable(0.0), "no event was asked for"


def test_a_card_that_goes_is_dead_to_who_had_it_and_new_to_who_opens_it_again(machine: Machine) -> None:
    node = machine.open()
    head = machine.head(node=node)
    head.set_mode(head.buffer(RAMP))
    assert machine.card.projected().any()
    machine.card.plug(False)
    assert not machine.card.projected().any()
    with fails(errno.ENODEV):
        head.resources()
    with fails(errno.ENODEV):
        machine.open()
    machine.card.plug(True)
    with fails(errno.ENODEV):
        head.resources()
    again = machine.head()  # master, though the dead node is still open
    again.set_mode(again.buffer(RAMP))
    node.close()
    assert machine.card.projected().any(), "closing the dead node took nothing from the living one"
