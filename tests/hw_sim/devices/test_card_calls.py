"""The graphics card's system calls, judged by the kernel's rules, and the light that they cause."""

from __future__ import annotations

import ctypes
import errno
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from numpy.typing import NDArray

from hw_sim.devices import drm_abi as abi
from hw_sim.devices.card import Card
from hw_sim.devices.head import Output
from hw_sim.timing.world_time import BLANK_NS
from hw_sim.wires.card_node import SimCardNode
from tests.hw_sim.devices.bench import Bench, bench
from tests.hw_sim.devices.host import CardHost

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

    def head(self, kind: int = HDMI, node: SimCardNode | None = None, shown: int | NDArray[np.uint8] = 0) -> CardHost:
        """A head that shows a grey or a picture, the projector's in full range."""
        head = CardHost(node or self.open(), kind)
        width, height = head.size
        head.buffer(np.ascontiguousarray(np.broadcast_to(np.uint8(shown), (height, width))))
        head.set_mode(0)
        if kind == HDMI:
            head.set_property("Broadcast RGB", "Full")
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


def test_the_two_monitors_and_their_native_modes(machine: Machine) -> None:
    """Structures have the sizes that a C compiler gives them on x86-64 with linux/drm_mode.h."""
    sizes = {
        abi.Version: 64, abi.Cap: 16, abi.Modeinfo: 68, abi.Resources: 64, abi.ModeCrtc: 104, abi.CrtcLut: 32, abi.Encoder: 20,
        abi.ModeGetConnector: 80, abi.PropertyEnum: 40, abi.Property: 64, abi.ConnectorSetProperty: 16, abi.ObjectProperties: 32,
        abi.ObjectSetProperty: 24, abi.Fb: 28, abi.PageFlip: 24, abi.CreateDumb: 32, abi.MapDumb: 16,
    }  # fmt: skip
    assert {structure: ctypes.sizeof(structure) for structure in sizes} == sizes
    node = machine.open()
    for kind, size in ((HDMI, (1024, 768)), (DISPLAY_PORT, (800, 480))):
        head = CardHost(node, kind)
        info = head.connector_info(head.connector)
        assert (info["connected"], head.size) == (True, size)
        assert len(info["modes"]) > 1
        for index, mode in enumerate(info["modes"]):
            clock_khz, width, hs, he, htotal, _, height, vs, ve, vtotal, _, hz, _, kinds = struct.unpack_from(
                "<I10H3I", mode
            )
            assert width < hs < he < htotal
            assert height < vs < ve < vtotal
            assert clock_khz * 1000 / (htotal * vtotal) == pytest.approx(60, abs=0.6)
            assert (hz, bool(kinds & 8)) == (60, index == 0), "only the native mode is the preferred one"
            assert mode[36:].rstrip(b"\0") == f"{width}x{height}".encode()
    for cap, value in ((0x1, 1), (0x6, 1), (0x12, 1), (0x7, 0)):  # dumb buffers, monotonic stamps, engines, tearing
        assert CardHost(node, HDMI).call(0x0C, "<QQ", cap, 99) == [cap, value]


def test_a_flip_happens_at_the_next_blank_and_says_so(machine: Machine) -> None:
    head = machine.head()
    white = head.buffer(np.full((768, 1024), 255, np.uint8))
    head.flip(white, 0xFEEDFACECAFE)
    assert machine.card.flip_pending(Output.PROJECTOR)
    assert not machine.card.projected().any(), "not before the blank"
    with fails(errno.EBUSY):
        head.flip(0, 2)
    with pytest.raises(BlockingIOError):
        head.node.read(1024)
    machine.bench.blanks(1)
    event = head.wait_flip()
    assert (event["user"], event["crtc"]) == (0xFEEDFACECAFE, head.crtc)
    assert event["time_ns"] == machine.bench.time.blank_ns // 1000 * 1000
    assert (machine.card.projected() == 255).all()
    machine.bench.blanks(2)
    head.flip(white)
    machine.late = Output.PROJECTOR
    machine.bench.blanks(1)
    assert machine.card.flip_pending(Output.PROJECTOR), "it is late"
    machine.late = None
    machine.bench.blanks(1)
    later = head.wait_flip()
    assert later["sequence"] - event["sequence"] == 4, "every blank counts"
    assert later["time_ns"] - event["time_ns"] == pytest.approx(4 * BLANK_NS, abs=2000)


def test_only_green_leaves_the_projector_and_the_display_keeps_its_colours(machine: Machine) -> None:
    node = machine.open()
    for head in (machine.head(HDMI, node), machine.head(DISPLAY_PORT, node)):
        pixels = head.fbs[0][1]
        pixels[..., 0], pixels[..., 1], pixels[..., 2] = 11, 22, 33  # XRGB8888: blue, green, red
    assert (machine.card.projected() == 22).all(), "what is drawn into the front buffer is scanned out"
    shown = machine.card.displayed()
    assert shown.shape == (480, 800, 3)
    assert (shown == (33, 22, 11)).all()


def test_a_dark_head_gives_no_light_and_answers_what_is_pending(machine: Machine) -> None:
    head = machine.head(shown=200)
    head.flip(0, 8)
    head.set_property("DPMS", "Off")
    assert head.wait_flip(0.0)["user"] == 8
    assert machine.card.projected().shape == (768, 1024)
    assert not machine.card.projected().any()
    with fails(errno.EINVAL):
        head.flip(0)
    head.set_property("DPMS", "On")
    assert (machine.card.projected() == 200).all()
    head.call(0xAF, "<I", head.fbs[0][0])
    assert machine.card.crtc(Output.PROJECTOR) is None, "without its framebuffer a head goes dark"
    with fails(errno.EBUSY):
        head.call(0xB0, "<IIIIQ", head.crtc, head.fbs[0][0], 1, 0, 0)


def gamma(head: CardHost, number: int, tables: NDArray[np.uint16], size: int = 256) -> None:
    head.call(number, "<IIQQQ", head.crtc, size, *(row.ctypes.data for row in tables))


def test_gamma_is_linear_until_set_and_acts_before_the_range_which_is_limited_until_it_is_full(
    machine: Machine,
) -> None:
    """CTA-861: limited range maps 0..255 to 16..235."""
    head = CardHost(machine.open(), HDMI)
    head.set_mode(head.buffer(RAMP))
    limited = machine.card.projected()
    assert np.abs(limited - (16 + RAMP * (219 / 255))).max() <= 0.5
    for name, shown in (("Full", RAMP), ("Limited 16:235", limited)):
        head.set_property("Broadcast RGB", name)
        assert np.array_equal(machine.card.projected(), shown)
    got, tables = np.zeros((3, 256), np.uint16), np.zeros((3, 256), np.uint16)
    gamma(head, 0xA4, got)
    assert np.array_equal(got >> 8, np.tile(np.arange(256), (3, 1)))
    tables[1] = np.arange(255, -1, -1) * 257
    gamma(head, 0xA5, tables)
    gamma(head, 0xA4, got)
    assert np.array_equal(got, tables)
    assert (machine.card.projected()[0, [0, 1023]] == (235, 16)).all()
    head.set_property("Broadcast RGB", "Full")
    assert np.array_equal(machine.card.projected(), 255 - RAMP)
    with fails(errno.EINVAL):
        gamma(head, 0xA5, tables, 255)


def test_only_the_master_changes_what_is_shown(machine: Machine) -> None:
    first, second = machine.head(), CardHost(machine.open(), HDMI)
    index = second.buffer(np.zeros((768, 1024), np.uint8))
    tables = np.zeros((3, 256), np.uint16)
    refused: list[tuple[int, Callable[[], object]]] = [
        (errno.EACCES, lambda: second.flip(index)),
        (errno.EACCES, lambda: second.set_mode(index)),
        (errno.EACCES, lambda: second.set_property("Broadcast RGB", "Full")),
        (errno.EACCES, lambda: gamma(second, 0xA5, tables)),
        (errno.EBUSY, lambda: second.node.ioctl(0x641E, bytearray())),
        (errno.ENOENT, lambda: second.call(0xAF, "<I", first.fbs[0][0])),
    ]
    for number, act in refused:
        with fails(number):
            act()
    first.node.ioctl(0x641F, bytearray())
    second.node.ioctl(0x641E, bytearray())
    second.set_mode(index)
    with fails(errno.EINVAL):
        first.node.ioctl(0x641F, bytearray())


def test_a_card_that_goes_is_dead_to_who_had_it_and_new_to_who_opens_it_again(machine: Machine) -> None:
    node = machine.open()
    head = machine.head(node=node, shown=RAMP)
    machine.card.plug(False)
    assert not machine.card.projected().any()
    for act in (head.resources, machine.open):
        with fails(errno.ENODEV):
            act()
    machine.card.plug(True)
    with fails(errno.ENODEV):
        head.resources()
    machine.head(shown=RAMP)  # master, though the dead node is still open
    node.close()
    assert machine.card.projected().any(), "closing the dead node took nothing from the living one"
