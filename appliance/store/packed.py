"""The packed form of a file of frames: every frame is a JPEG-LS stream of its own.

Each stream is found and decoded without the others. ``frames_left.npy`` becomes ``frames_left.npy.jls``, from which its
bytes can be restored exactly:

    8 bytes     KFPACK1 and a line end
    4 bytes     length of the index, little-endian
    index       JSON: length and sha256 of the unpacked file, height, width, and of each frame the stream's length, its
                CRC-32 and that of the pixels
    header      the unpacked file's own first bytes
    streams     one after another, each a whole JPEG-LS file (ISO/IEC 14495-1), lossless
    32 bytes    sha256 of everything before

Checksums are those of the decoded pixels, so that equal frames provably give equal points with any encoder. The codec
``imagecodecs`` belongs to the desk. An instrument loads this module but has no codec: it neither packs nor decodes.
"""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from appliance.base import needed
from appliance.store.atomic import Bytes, Stamp, checked_stamp

if TYPE_CHECKING:  # NumPy is loaded where pixels are: a list of scans touches none
    import numpy as np
    from numpy.typing import NDArray

SUFFIX = ".jls"
_MAGIC = b"KFPACK1\n"
_DIGEST_BYTES = 32
_MOST_INDEX_BYTES = 1024 * 1024
_MOST_FRAMES, _MOST_SIDE_PX, _MOST_HEADER_BYTES = 10_000, 65_535, 4096
_BLOCK = 4 * 1024 * 1024
THREADS = 4
"""Largest number of threads that encode and decode; the codec releases the interpreter lock."""


class PackedError(Exception):
    """Error of a packed file that cannot be used; the text says why, without its path."""


@dataclass(frozen=True, slots=True)
class PackedFile:
    """The index of one packed file. Reading pixels raises PackedError, OSError, MissingLibraryError."""

    path: Path
    stamp: Stamp
    """Length and checksum of the unpacked file."""
    header: bytes
    """The unpacked file's first bytes, with the size of its frames."""
    height_px: int
    width_px: int
    offsets: tuple[int, ...]
    """Offsets at which each stream begins, and the last one ends, in bytes from the file's beginning."""
    crc32: tuple[str, ...]
    """CRC-32 of each frame's pixels, 8 hexadecimal digits."""
    stream_crc32: tuple[str, ...]
    """CRC-32 of each stream."""

    @property
    def count(self) -> int:
        """Number of frames."""
        return len(self.crc32)

    @property
    def length_bytes(self) -> int:
        """Length that the packed file must have."""
        return self.offsets[-1] + _DIGEST_BYTES

    def frame(self, k: int) -> NDArray[np.uint8]:
        """Return frame ``k`` as (h, w) uint8; no other pixels of the file are read."""
        with self.path.open("rb") as file:
            return self._decoded(k, self._stream(file, k))

    def frames(self) -> NDArray[np.uint8]:
        """Return all frames as (n, h, w) uint8, in memory of their own, each compared with its CRC-32."""
        import numpy as np

        pixels = np.empty((self.count, self.height_px, self.width_px), np.uint8)

        def decode(k: int) -> None:
            pixels[k] = self.frame(k)

        with ThreadPoolExecutor(THREADS) as pool:
            list(pool.map(decode, range(self.count)))
        return pixels

    def parts(self) -> Iterator[Bytes]:
        """Yield the unpacked file's bytes, a frame at a time."""
        yield self.header
        for k in range(self.count):
            yield self.frame(k).reshape(-1).data

    def decoded_stamp(self) -> Stamp:
        """Return length and sha256 of the decoded bytes; those in the index are not used."""
        digest, length = hashlib.sha256(), 0
        for part in self.parts():
            digest.update(part)
            length += len(memoryview(part).cast("B"))
        return Stamp(length, digest.hexdigest())

    def is_undamaged(self) -> bool:
        """Return True if the packed file's own checksum fits; no frame is decoded."""
        digest, unread = hashlib.sha256(), self.offsets[-1]
        with self.path.open("rb") as file:
            while unread and (block := file.read(min(unread, _BLOCK))):
                digest.update(block)
                unread -= len(block)
            return unread == 0 and file.read(_DIGEST_BYTES + 1) == digest.digest()

    def _stream(self, file: BinaryIO, k: int) -> bytes:
        file.seek(self.offsets[k])
        return file.read(self.offsets[k + 1] - self.offsets[k])

    def _decoded(self, k: int, stream: bytes) -> NDArray[np.uint8]:
        codec = _codec(self.path.name)
        # The codec trusts a stream's own header, and would take gigabytes and minutes for a damaged one.
        if _crc32(stream) != self.stream_crc32[k]:
            raise PackedError(f"frame {k} is damaged (its checksum does not fit)")
        try:
            pixels: NDArray[np.uint8] = codec.jpegls_decode(stream)
        except (
            Exception
        ) as error:  # the codec has its own error type, and raises others for streams that it cannot begin
            raise PackedError(f"frame {k} cannot be decoded ({error})") from error
        # A damaged stream may decode to an image of another size, or to other pixels.
        if pixels.dtype != "uint8" or pixels.shape != (self.height_px, self.width_px):
            raise PackedError(f"frame {k} is {pixels.dtype} {pixels.shape}")
        if _crc32(pixels.reshape(-1).data) != self.crc32[k]:
            raise PackedError(f"frame {k} decodes to different pixels")
        return pixels


def packed_path(path: Path) -> Path:
    """Return the path of the packed form of a file of frames."""
    return path.with_name(path.name + SUFFIX)


def pack(header: bytes, frames: NDArray[np.uint8], stamp: Stamp, name: str) -> Sequence[Bytes]:
    """Return the parts of the packed file of ``frames`` (n, h, w) uint8.

    ``header``: the unpacked file's first bytes; ``stamp``: its length and checksum; ``name``: for messages. Takes
    memory for the packed frames. Raises MissingLibraryError.
    """
    codec = _codec(name)
    with ThreadPoolExecutor(THREADS) as pool:
        streams = list(pool.map(codec.jpegls_encode, frames))
        sums = list(pool.map(lambda frame: _crc32(frame.reshape(-1).data), frames))
    index = {
        "length": stamp.length,
        "sha256": stamp.sha256,
        "header_bytes": len(header),
        "height_px": frames.shape[1],
        "width_px": frames.shape[2],
        "streams": [len(stream) for stream in streams],
        "crc32": sums,
        "stream_crc32": [_crc32(stream) for stream in streams],
    }
    text = json.dumps(index, sort_keys=True).encode()
    head = _MAGIC + len(text).to_bytes(4, "little") + text + header
    digest = hashlib.sha256(head)
    for stream in streams:
        digest.update(stream)
    return head, *streams, digest.digest()


def read_index(path: Path) -> PackedFile:
    """Return the index of a packed file, every number of it checked. Raises PackedError, OSError."""
    with path.open("rb") as file:
        start = file.read(len(_MAGIC) + 4)
        if len(start) != len(_MAGIC) + 4 or not start.startswith(_MAGIC):
            raise PackedError("is no file of packed frames")
        length = int.from_bytes(start[len(_MAGIC) :], "little")
        if length > _MOST_INDEX_BYTES:
            raise PackedError("its index is damaged")
        text = file.read(length)
        try:
            content = json.loads(text)
            return _index(path, content, len(start) + length, file)
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise PackedError("its index is damaged") from error


def _index(path: Path, content: dict[str, Any], start: int, file: BinaryIO) -> PackedFile:
    streams, sums, stream_sums = content["streams"], content["crc32"], content["stream_crc32"]
    height, width = _whole(content["height_px"], _MOST_SIDE_PX), _whole(content["width_px"], _MOST_SIDE_PX)
    header = file.read(_whole(content["header_bytes"], _MOST_HEADER_BYTES))
    length = content["length"]
    if (
        not 0 < len(streams) <= _MOST_FRAMES
        or not len(sums) == len(stream_sums) == len(streams)
        or not isinstance(content["sha256"], str)
    ):
        raise ValueError("the numbers of streams and checksums differ")
    # The unpacked length must fit header and frames, so that no memory is allocated because of a damaged index.
    if length != len(header) + len(streams) * height * width or not all(
        isinstance(checksum, str) for checksum in (*sums, *stream_sums)
    ):
        raise ValueError("the lengths contradict each other")
    offsets = [start + len(header)]
    for checksum in streams:
        offsets.append(offsets[-1] + _whole(checksum, 2 * height * width + 4096))
    return PackedFile(
        path, Stamp(length, content["sha256"]), header, height, width, tuple(offsets), tuple(sums), tuple(stream_sums)
    )


def _whole(value: object, limit: int) -> int:
    if not isinstance(value, int) or not 0 < value <= limit:
        raise ValueError(f"{value!r:.20} is not a number from 1 to {limit}")
    return value


def stamp_of(path: Path) -> Stamp:
    """Return length and sha256 of the frames at ``path`` as they decode now, packed or not.

    Raises PackedError, OSError, MissingLibraryError.
    """
    if path.exists() or not packed_path(path).exists():
        return checked_stamp(path)
    return read_index(packed_path(path)).decoded_stamp()


def _crc32(data: Bytes) -> str:
    return f"{zlib.crc32(data):08x}"


def _codec(name: str) -> Any:
    return needed("imagecodecs", "imagecodecs", f"{name} (packed frames)")
