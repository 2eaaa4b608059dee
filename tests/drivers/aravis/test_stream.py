"""Frames of one acquisition: what becomes of each buffer that comes back, and how long is waited for one."""

from __future__ import annotations

from functools import partial
from threading import Event
from typing import Any

import numpy as np
import pytest

from drivers.api import DeviceGone, DeviceRefused, Frame, FrameStatus
from drivers.aravis import library
from drivers.aravis.buses import bus_of
from drivers.aravis.camera import find_device
from drivers.aravis.device import AravisDevice
from drivers.aravis.stream import LEAST_BUFFERS, LOOK_S, ROOM, STALE_LIMIT, AravisStream
from drivers.camera.pixels import FORMATS
from tests.drivers.aravis.foreign import ForeignLibrary, OnABus, SentImage

WIDTH_PX, HEIGHT_PX = SIZE_PX = (64, 48)
IMAGE = bytes(k % 251 for k in range(WIDTH_PX * HEIGHT_PX))


CORRUPT = {-1: "unknown", 1: "cleared", 4: "wrong packet id", 6: "filling"}
CUT_OFF = {2: "timeout", 3: "missing packets", 5: "size mismatch", 7: "aborted"}
"""Codes of bad buffers (``arvbuffer.h``)."""


def streaming(
    foreign: ForeignLibrary,
    protocol: str = "GigEVision",
    pixels: str = "Mono8",
    size_px: tuple[int, int] = SIZE_PX,
    **more: Any,
) -> tuple[OnABus, AravisStream]:
    there = foreign.add(protocol, **more)
    aravis = library.library("camera.left")
    device = AravisDevice("camera.left", aravis, aravis.cameras()[0])
    payload_bytes = FORMATS[pixels].payload_size(size_px[0] * size_px[1])
    assert payload_bytes is not None
    return there, AravisStream(device, bus_of(device), foreign.clock, size_px, FORMATS[pixels], payload_bytes)


def slot() -> Any:
    return np.zeros((HEIGHT_PX, WIDTH_PX), np.uint8)


def taken(there: OnABus, stream: AravisStream, *sent: SentImage, timeout_s: float = 1.0) -> Frame:
    there.coming.extend(sent)
    return stream.next_frame(slot(), timeout_s)


def test_a_whole_frame_is_in_the_slot_with_its_number_and_its_time(foreign: ForeignLibrary) -> None:
    there, stream = streaming(foreign)
    there.coming.append(SentImage(IMAGE, number=5, stamp_ns=77, after_s=0.125))
    image, begun_ns, free = slot(), foreign.clock.now_ns(), len(there.free)
    assert stream.next_frame(image, 1.0) == Frame(FrameStatus.COMPLETE, 5, 77, begun_ns + 125_000_000, "")
    assert image.tobytes() == IMAGE
    assert len(there.free) == free, "its buffer waits for another image"
    assert taken(there, stream, SentImage(IMAGE, stamp_ns=0)).camera_time_ns is None, "a camera without time"
    assert taken(there, stream, SentImage(IMAGE, after_s=0.6), timeout_s=0.7).status is FrameStatus.COMPLETE
    assert taken(there, stream, SentImage(IMAGE, after_s=0.8), timeout_s=0.7).status is FrameStatus.TIMEOUT


def test_more_than_eight_bits_are_reduced_and_an_array_that_cannot_take_a_frame_is_refused(
    foreign: ForeignLibrary,
) -> None:
    there, stream = streaming(foreign, pixels="Mono12")
    raw = np.arange(WIDTH_PX * HEIGHT_PX, dtype="<u2") % 4096
    there.coming.append(SentImage(raw.tobytes(), pixel_format=0x01100005))
    image = slot()
    assert stream.next_frame(image, 1.0).status is FrameStatus.COMPLETE
    np.testing.assert_array_equal(image, (raw >> 4).reshape(image.shape))
    turned = np.zeros((WIDTH_PX, HEIGHT_PX), np.uint8)
    for bad, said in ((turned, r"\(64, 48\), .* camera.left are 48 x 64"), (turned.T, "C-contiguous")):
        with pytest.raises(ValueError, match=said):
            stream.next_frame(bad, 1.0)


@pytest.mark.parametrize(
    ("size_px", "buffers"),
    [((1600, 1200), 16), ((1024, 768), 16), ((1024, 736), 17), ((640, 480), 41), ((1024, 2), 6144)],
    ids=["large", "just 12 MiB", "the last one in part", "small", "tiny"],
)
def test_buffers_are_enough_for_a_late_reader_and_for_the_librarys_thread(
    foreign: ForeignLibrary, size_px: tuple[int, int], buffers: int
) -> None:
    there, _ = streaming(foreign, size_px=size_px)
    assert (LEAST_BUFFERS, ROOM) == (16, 12 << 20)
    assert len(there.free) == buffers
    assert {len(memory) for memory, _ in foreign.buffers.values()} == {size_px[0] * size_px[1]}


@pytest.mark.parametrize(("code", "error"), [(3, DeviceRefused), (2, DeviceGone)])
def test_a_stream_that_is_not_made_is_refused_or_gone_and_one_that_is_made_is_released_once(
    foreign: ForeignLibrary, code: int, error: type[Exception]
) -> None:
    with pytest.raises(error, match="request for its images"):
        streaming(foreign, fails={"stream": code})
    foreign.devices.clear()
    _, stream = streaming(foreign)
    left_open = len(foreign.open)
    stream.close()
    stream.close()
    assert len(foreign.open) == left_open - 1


@pytest.mark.parametrize(
    ("sent", "status", "detail"),
    [
        (SentImage(IMAGE, size_px=(48, 64)), FrameStatus.CORRUPT, "image of 48 x 64, expected 64 x 48"),
        (SentImage(IMAGE, size_px=(64, 47)), FrameStatus.CORRUPT, "image of 64 x 47, expected 64 x 48"),
        (SentImage(IMAGE, pixel_format=0x01100003), FrameStatus.CORRUPT, "pixel format 0x01100003, expected Mono8"),
        (SentImage(IMAGE[:-1]), FrameStatus.TRUNCATED, "payload of 3071 of 3072 bytes"),
        (SentImage(IMAGE, claimed_bytes=3073), FrameStatus.COMPLETE, ""),
        *((SentImage(IMAGE, code), FrameStatus.CORRUPT, said) for code, said in CORRUPT.items()),
        *((SentImage(IMAGE, code), FrameStatus.TRUNCATED, said) for code, said in CUT_OFF.items()),
    ],
)
def test_a_frame_that_is_not_what_was_asked_for_keeps_its_number_unless_the_buffer_is_bad(
    foreign: ForeignLibrary, sent: SentImage, status: FrameStatus, detail: str
) -> None:
    """A bad buffer's numbers may be those of the frame before."""
    there, stream = streaming(foreign)
    number, time_ns = (None, None) if sent.status else (1, 7_000_000_000)
    assert taken(there, stream, sent) == Frame(status, number, time_ns, foreign.clock.now_ns(), detail)


@pytest.mark.parametrize(
    ("timeout_s", "waits_us", "asked"),
    [
        (0.0, [0], 1),
        (0.1, [100_000], 1),
        (LOOK_S, [250_000], 1),
        (0.6, [250_000, 250_000, 100_000], 3),
        (-1.0, [0], 1),
    ],
)
def test_a_wait_ends_when_it_was_to_end_and_the_camera_is_asked_each_quarter_of_a_second(
    foreign: ForeignLibrary, timeout_s: float, waits_us: list[int], asked: int
) -> None:
    there, stream = streaming(foreign, "USB3Vision")
    begun_ns = foreign.clock.now_ns()
    frame = taken(there, stream, timeout_s=timeout_s)
    assert frame == Frame(FrameStatus.TIMEOUT, None, None, begun_ns + round(max(0.0, timeout_s) * 1e9), "no frame")
    assert there.waits_us == waits_us
    assert there.asked == [("read", 0, 4)] * asked


def test_a_reader_is_let_go_at_the_end_and_told_of_a_camera_that_is_lost(foreign: ForeignLibrary) -> None:
    there, stream = streaming(foreign)
    there.controlled = False
    assert taken(there, stream, SentImage(IMAGE)).status is FrameStatus.COMPLETE, "what came is not asked about"
    for sent in ([], [SentImage(IMAGE, 3)]):
        with pytest.raises(DeviceGone):
            taken(there, stream, *sent)
    there.waits_us.clear()
    stream.end()
    assert taken(there, stream).status is FrameStatus.TIMEOUT, "whoever ended it does not ask any more"
    assert there.waits_us == [250_000]


@pytest.mark.parametrize(
    ("stamps_ns", "taken_first"),
    [([99, 100, 50], 2), ([0, 99, 101], 1)],
    ids=["the clock was set anew since", "a frame without time is taken and the next still judged"],
)
def test_what_was_exposed_before_the_start_is_dropped_until_the_first_that_was_not(
    foreign: ForeignLibrary, stamps_ns: list[int], taken_first: int
) -> None:
    there, stream = streaming(foreign)
    stream.expect_since(100)
    sent = [SentImage(IMAGE, number=k, stamp_ns=ns) for k, ns in enumerate(stamps_ns, 1)]
    assert taken(there, stream, *sent).block_id == taken_first
    assert stream.next_frame(slot(), 1.0).block_id == 3


@pytest.mark.parametrize(("early", "block_id"), [(STALE_LIMIT - 1, STALE_LIMIT), (STALE_LIMIT, STALE_LIMIT)])
def test_not_more_than_32_frames_or_test_packets_are_dropped(
    foreign: ForeignLibrary, early: int, block_id: int
) -> None:
    there, stream = streaming(foreign)
    stream.expect_since(100)
    sent = [SentImage(IMAGE, number=1 + k, stamp_ns=99 if k < early else 100) for k in range(early + 1)]
    assert taken(there, stream, *sent).block_id == block_id
    stream.expect_since(None)
    there.coming.clear()
    assert taken(there, stream, SentImage(IMAGE, stamp_ns=1)).status is FrameStatus.COMPLETE
    begun_ns = foreign.clock.now_ns()
    nothing = [SentImage(IMAGE, number=0) for _ in range(early)]  # packets that test the way
    frame = taken(there, stream, *nothing, SentImage(IMAGE, number=7))
    assert (frame.block_id == 7) is (early < STALE_LIMIT == 32)
    assert frame.block_id == 7 or frame == Frame(FrameStatus.TIMEOUT, None, None, begun_ns, "no frame")


def test_a_library_that_hangs_at_the_end_of_a_stream_is_told_and_is_not_asked_again(
    foreign: ForeignLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, stream = streaming(foreign)
    hangs = Event()
    monkeypatch.setattr(library, "END_S", 0.05)
    monkeypatch.setattr(foreign, "g_object_unref", partial(lambda handle: hangs.wait(20.0)))
    try:
        with pytest.raises(DeviceRefused, match="Aravis does not end a stream"):
            stream.close()
        stream.close()
        with pytest.raises(DeviceRefused, match="off and on"):
            find_device("camera.left", "S0", library.library("camera.left"))
        with pytest.raises(DeviceGone, match="S9 not found"):  # the other camera is looked for all the same
            find_device("camera.right", "S9", library.library("camera.right"))
    finally:
        hangs.set()
