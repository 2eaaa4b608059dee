"""A picture's size is known before it is decoded: a file of a kilobyte cannot make the desk run out of memory."""

from __future__ import annotations

import resource
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from appliance.calibrate.pictures import Pair, PicturesError, read_pair
from appliance.store.picture_size import picture_head


def size_px(data: bytes) -> tuple[int, int] | None:
    head = picture_head(data)
    return None if head is None else head[:2]


@pytest.mark.parametrize("kind", [".png", ".tif", ".bmp", ".pgm", ".jpg", ".ppm"])
def test_size_and_depth_are_those_of_the_picture_and_never_another_of_a_part_of_it(kind: str) -> None:
    for shape in ((30, 41), (1, 300), (600, 7, 3)):
        for bits in (8,) if kind in (".bmp", ".jpg") else (8, 16):
            drawn = (*shape[:2], 3) if kind == ".ppm" else shape[:2] if kind == ".pgm" else shape
            data = cv2.imencode(kind, np.zeros(drawn, f"uint{bits}"))[1].tobytes()
            assert picture_head(data) == (shape[1], shape[0], bits)
    data = cv2.imencode(kind, np.zeros((30, 41, 3 if kind == ".ppm" else 1), np.uint8))[1].tobytes()
    for length in range(len(data)):
        assert size_px(data[:length]) in (None, (41, 30), (41, 3), (4, 30))  # a number in letters may be cut
    head = b"BM" + bytes(12)  # a bitmap of the first kind, and one that begins with its upper row
    for rest, size in (
        (struct.pack("<IHH", 12, 640, 480), (640, 480)),
        (struct.pack("<Iii", 40, 640, -480), (640, 480)),
    ):
        assert size_px(head + rest) == size
    assert size_px(head + struct.pack("<I", 40)) is None


def tiff(order: str, *entries: tuple[int, int, int]) -> bytes:
    """A TIFF's head and its first directory, which begins at byte 20: (tag, kind, value) each, kind 3 short and 4 long."""
    mark = b"II*\0" if order == "<" else b"MM\0*"
    body = mark + struct.pack(order + "I", 20) + bytes(12) + struct.pack(order + "H", len(entries))
    for tag, kind, value in entries:
        short = struct.pack(order + "H", value & 0xFFFF) + b"\0\0" if kind == 3 else struct.pack(order + "I", value)
        body += struct.pack(order + "HHI", tag, kind, 1) + short
    return body


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("kind", [3, 4])
def test_a_tiff_of_either_byte_order_says_its_size_in_short_or_long_numbers(order: str, kind: int) -> None:
    entries = (254, 4, 0), (256, kind, 1600), (257, kind, 1200), (258, 3, 8)
    assert size_px(tiff(order, *entries)) == (1600, 1200)
    assert size_px(tiff(order, *entries[1:])) == (1600, 1200)
    assert size_px(tiff(order, (257, kind, 1200), (256, kind, 1600))) == (1600, 1200)
    assert size_px(tiff(order, *entries[:2])) is None, "without a height"
    assert size_px(tiff(order, (256, 5, 1600), (257, kind, 1200))) is None, "a width that is no whole number"
    # A directory may say that it has 65,535 entries: those of a picture are among the first.
    assert size_px(tiff(order, *((300, 3, 0) for _ in range(30)), *entries)) == (1600, 1200)


def jpeg(*segments: bytes) -> bytes:
    return b"\xff\xd8" + b"".join(segments)


FRAME = struct.pack(">HBHHB", 8, 8, 480, 640, 1)
"""A frame header: its length, bits, height, width."""


@pytest.mark.parametrize("marker", [0xC0, 0xC3, 0xCF])
def test_a_jpeg_says_its_size_where_its_frame_starts_whatever_comes_before(marker: int) -> None:
    frame = bytes([0xFF, marker]) + FRAME
    comment = b"\xff\xfe" + struct.pack(">H", 7) + b"\xff\xc0abc"
    table = b"\xff\xc4" + struct.pack(">H", 6) + bytes(4)
    assert size_px(jpeg(frame)) == (640, 480)
    assert size_px(jpeg(comment, table, frame)) == (640, 480), (
        "a table of codes and what looks like a frame in a comment"
    )
    assert size_px(jpeg(comment, b"\xff\xff\xff", frame)) == (640, 480), "filling"
    assert size_px(jpeg(b"\xff\x01", b"\xff\xd0", frame)) == (640, 480), "markers that have no length"
    assert size_px(jpeg(b"\xff\xfe\0\0", frame)) == (640, 480), "a length that does not count itself"
    assert size_px(jpeg(comment)) is None
    assert size_px(jpeg(b"\xff\xfe\0\x03", frame)) is None, "a segment that ends where no other begins"


def promised(width_px: int, height_px: int) -> bytes:
    """A PNG of grey zeros, a thousandth of the memory it asks for."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    packer = zlib.compressobj(9)
    row = bytes(width_px + 1)
    rows = b"".join([*(packer.compress(row) for _ in range(height_px)), packer.flush()])
    head = struct.pack(">IIBBBBB", width_px, height_px, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


def test_files_that_promise_many_pixels_or_bytes_are_refused_before_they_are_read(tmp_path: Path) -> None:
    bomb, good, endless = tmp_path / "00_left.png", tmp_path / "00_right.png", tmp_path / "endless.png"
    bomb.write_bytes(promised(20_000, 20_000))
    cv2.imwrite(str(good), np.zeros((60, 80), np.uint8))
    assert bomb.stat().st_size < 1_000_000
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(PicturesError, match="20000x20000 px; the rig file has 80x60 px"):
        read_pair(Pair("00", bomb, good), 80, 60)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 100_000  # 400 MB unpacked
    with endless.open("wb") as file:
        file.truncate(1 << 34)  # 16 GB that take no room
    with pytest.raises(PicturesError, match="larger than 1076800 bytes"):
        read_pair(Pair("00", endless, good), 80, 60)


@pytest.mark.parametrize("kind", [".png", ".tif", ".bmp", ".pgm"])
def test_a_picture_that_was_cut_off_is_refused_in_our_words_alone(
    kind: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    image = np.random.default_rng(1).integers(0, 256, (60, 80), np.uint8)
    left, right = tmp_path / f"00_left{kind}", tmp_path / "00_right.png"
    data = cv2.imencode(kind, image)[1].tobytes()
    left.write_bytes(data[: len(data) * 2 // 3] if kind != ".tif" else data[:8] + data[len(data) // 2 :])
    cv2.imwrite(str(right), image)
    with pytest.raises(PicturesError, match=r"00_left\.\w+: (is no image|\d+x\d+ px)"):
        read_pair(Pair("00", left, right), 80, 60)
    assert capfd.readouterr().err == ""
