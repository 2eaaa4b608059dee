"""The reading half of SFTP against the bytes that a server sends: the draft's own layout, and everything that is wrong about it."""

from __future__ import annotations

import os
import random
import struct
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from appliance.offline.pull.sftp import SftpSource
from appliance.offline.pull.source import LinkLost, NotThere, PullError, RemoteEntry, Unreadable

LIMIT_S = 0.05


def message(kind: int, *fields: int | bytes) -> bytes:
    """A message after section 3 of the draft: strings carry their length, numbers are four bytes."""
    body = b"".join(
        struct.pack(">I", field) if isinstance(field, int) else struct.pack(">I", len(field)) + field
        for field in fields
    )
    return struct.pack(">IB", len(body) + 1, kind) + body


VERSION = struct.pack(">IBI", 5, 2, 3)
FOLDER, FILE = 0o040755, 0o100644


def name(text: bytes, mode: int, size: int) -> bytes:
    attributes = struct.pack(">IQIII", 0x1 | 0x4 | 0x8, size, mode, 7, 9)
    return struct.pack(">I", len(text)) + text + struct.pack(">I", 1) + b"x" + attributes


def names(number: int, *some: bytes) -> bytes:
    body = struct.pack(">II", number, len(some)) + b"".join(some)
    return struct.pack(">IB", len(body) + 1, 104) + body


@contextmanager
def server(*said: bytes, ends: bool = True) -> Iterator[SftpSource]:
    """A link over which a server says just that, whatever it is asked."""
    (silent, theirs), (ours, writing) = os.pipe(), os.pipe()
    with tempfile.TemporaryFile() as file:  # a pipe would be full after 64 KiB, and nobody reads meanwhile
        file.write(b"".join(said))
        file.seek(0)
        os.write(theirs, b"".join(said) if not ends else b"")
        try:
            yield SftpSource(file.fileno() if ends else silent, writing, LIMIT_S)
        finally:
            for one in (silent, theirs, ours, writing):
                os.close(one)


def end(number: int, code: int = 1, text: bytes = b"") -> bytes:
    return message(101, number, code, text, b"en")


def test_a_folder_is_listed_without_what_is_neither_file_nor_folder() -> None:
    some = names(
        1, name(b"b.npy", FILE, 7), name(b"a", FOLDER, 4096), name(b"link", 0o120777, 3), name(b".", FOLDER, 1)
    )
    with server(VERSION, message(102, 0, b"h"), some, end(2), end(3, 0)) as source:
        assert source.listing("scans") == [RemoteEntry("a", 4096, True, 9), RemoteEntry("b.npy", 7, False, 9)]


def test_short_answers_and_answers_in_another_order_are_put_together() -> None:
    with server(
        VERSION,
        message(102, 0, b"h"),
        message(103, 2, b"Z" * 10),
        message(103, 1, b"A" * 65_000),
        message(103, 3, b"B" * 536),
    ) as source:
        assert b"".join(source.read("f", 0, 65_546)) == b"A" * 65_000 + b"B" * 536 + b"Z" * 10


def test_a_file_that_ends_early_gives_what_there_is() -> None:
    with server(VERSION, message(102, 0, b"h"), message(103, 1, b"abc"), end(2), end(3), end(4, 0)) as source:
        assert b"".join(source.read("f", 0, 100_000)) == b"abc"


@pytest.mark.parametrize(
    ("said", "error"),
    [
        ((struct.pack(">IBI", 5, 2, 2),), PullError),
        ((b"Welcome to this computer\r\n",), LinkLost),
        ((VERSION,), LinkLost),
        ((VERSION, message(101, 0, 2, b"", b"")), NotThere),
        ((VERSION, message(101, 0, 3, b"", b"")), Unreadable),
        ((VERSION, message(101, 0, 4, b"broken", b"")), Unreadable),
        ((VERSION, message(101, 0)), LinkLost),
        ((VERSION, message(103, 0, b"data")), LinkLost),
        ((VERSION, message(102, 0, b"h"), message(103, 1, b"x" * 101)), LinkLost),
        ((VERSION, message(102, 0, b"h"), message(103, 1, b"")), LinkLost),
        ((VERSION, struct.pack(">IB", 0xFFFFFFFF, 102)), LinkLost),
    ],
)  # fmt: skip
def test_each_wrong_answer_is_one_of_the_promised_errors(said: tuple[bytes, ...], error: type[Exception]) -> None:
    with pytest.raises(error), server(*said) as source:
        list(source.read("f", 0, 100))


def test_a_length_that_cannot_be_is_not_waited_for() -> None:
    endless = server(VERSION, struct.pack(">IB", 0xFFFFFFFF, 102), ends=False)
    with pytest.raises(LinkLost, match="a message of 4294967295 bytes"), endless as source:
        source.listing("scans")


def test_a_silent_server_is_given_up() -> None:
    with pytest.raises(LinkLost, match=r"nothing came for 0.05 s"), server(VERSION, ends=False) as source:
        source.listing("scans")


def test_damaged_bytes_end_in_the_promised_errors() -> None:
    chance = random.Random(5)
    listing = (
        VERSION + message(102, 0, b"h") + names(1, name(b"a", FILE, 1), name(b"b", FOLDER, 1)) + end(2) + end(3, 0)
    )
    reading = VERSION + message(102, 0, b"h") + message(103, 1, b"abc") + end(2) + end(3, 0)
    fine = 0
    for k in range(600):
        data = bytearray((listing, reading)[k % 2])
        for _ in range(chance.randint(1, 3)):
            data[chance.randrange(len(data))] = chance.randrange(256)
        try:
            with server(bytes(data[: chance.randint(1, len(data))] if k % 3 == 0 else data)) as source:
                found = source.listing("s") if k % 2 == 0 else list(source.read("f", 0, 3))
                fine += bool(found)
        except (LinkLost, NotThere, Unreadable, PullError):
            continue
    assert 0 < fine < 600, "some damage is only in the content"
