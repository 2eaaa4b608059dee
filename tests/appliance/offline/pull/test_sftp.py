"""The reading half of SFTP against the bytes that a server sends: the draft's own layout, and everything that is wrong about it."""

from __future__ import annotations

import os
import random
import struct
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import pytest

from appliance.offline.pull import sftp
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
def server(*said: bytes, ends: bool = True, heard: list[int] | None = None) -> Iterator[SftpSource]:
    """A link over which a server says just that, whatever it is asked; ``heard``: gets where its questions can be read."""
    (silent, theirs), (ours, writing) = os.pipe(), os.pipe()
    with tempfile.TemporaryFile() as file:  # a pipe would be full after 64 KiB, and nobody reads meanwhile
        file.write(b"".join(said))
        file.seek(0)
        os.write(theirs, b"".join(said) if not ends else b"")
        if heard is not None:
            heard.append(ours)
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


def questions(heard: list[int]) -> list[tuple[int, bytes]]:
    """Kind and content of each message that the server has got by now."""
    data, found = os.read(heard[0], 1 << 16), []
    while data:
        (length,) = struct.unpack_from(">I", data)
        found.append((data[4], data[5 : 4 + length]))
        data = data[4 + length :]
    return found


def test_a_folder_is_asked_for_until_it_ends_and_given_back() -> None:
    heard: list[int] = []
    with server(
        VERSION, message(102, 0, b"h"), names(1, name(b"a", FILE, 1)), names(2), end(3), end(4, 0), heard=heard
    ) as source:
        assert [one.name for one in source.listing("scans")] == ["a"]
        readdir = [(12, message(12, k, b"h")[5:]) for k in (1, 2, 3)]
        assert questions(heard) == [
            *((1, struct.pack(">I", 3)), (11, message(11, 0, b"./scans")[5:])),
            *(*readdir, (4, message(4, 4, b"h")[5:])),
        ]


def test_a_file_is_opened_to_read_and_asked_for_in_32_pieces_of_64_kib_at_once() -> None:
    heard: list[int] = []
    pieces = [message(103, 1 + k, b"x" * 65_536) for k in range(3)]
    with server(VERSION, message(102, 0, b"h"), *pieces, ends=True, heard=heard) as source:
        reading = source.read("f", 7, 40 * 65_536)
        assert len(next(reading)) == 65_536
        asked = questions(heard)
        assert asked[1] == (3, message(3, 0, b"./f", 1, 0)[5:])
        assert [one[0] for one in asked[2:]] == [5] * 32
        assert [struct.unpack(">II1sQI", one) for _, one in asked[2:]] == [
            (1 + k, 1, b"h", 7 + 65_536 * k, 65_536) for k in range(32)
        ]
        next(reading)
        reading.close()  # type: ignore[attr-defined]
        assert [struct.unpack(">II1sQI", one) for _, one in questions(heard)[:1]] == [
            (33, 1, b"h", 7 + 65_536 * 32, 65_536)
        ]


def test_the_last_piece_is_as_long_as_what_is_left_and_the_root_is_a_folder_too() -> None:
    heard: list[int] = []
    with server(VERSION, message(102, 0, b"h"), message(103, 1, b"abcde"), end(2, 0), heard=heard) as source:
        assert b"".join(source.read("", 10, 15)) == b"abcde"
        _, opened, read, closed = questions(heard)
        assert opened[1] == message(3, 0, b".", 1, 0)[5:]
        assert struct.unpack(">II1sQI", read[1]) == (1, 1, b"h", 10, 5)
        assert closed == (4, message(4, 2, b"h")[5:])


def test_answers_to_what_nobody_waits_for_any_more_are_dropped() -> None:
    """Two files that were left after their first piece: more late answers than may wait."""
    late = [message(103, number, b"x" * 65_536) for number in range(2, 33)]
    late += [end(33, 0), message(102, 34, b"i"), message(103, 35, b"x" * 65_536)]
    late += [message(103, number, b"x" * 65_536) for number in range(36, 67)]
    late += [end(67, 0), message(102, 68, b"j"), end(69), end(70, 0)]
    with server(VERSION, message(102, 0, b"h"), message(103, 1, b"x" * 65_536), *late) as source:
        for _ in range(2):
            reading = source.read("f", 0, 1 << 26)
            next(reading)
            reading.close()  # type: ignore[attr-defined]
        assert source.listing("scans") == []
        assert (source._answers, source._unwanted) == ({}, {70})


@pytest.mark.parametrize(("strange", "fine"), [(32, True), (33, False)])
def test_only_so_many_answers_may_wait_that_were_not_asked_for(strange: int, fine: bool) -> None:
    others = [message(103, 1000 + k, b"?") for k in range(strange)]
    with server(VERSION, *others, message(102, 0, b"h"), end(1), end(2, 0)) as source:
        if fine:
            assert source.listing("scans") == []
        else:
            with pytest.raises(LinkLost, match="answers what it was not asked"):
                source.listing("scans")


@pytest.mark.parametrize(("length", "fine"), [(0, False), (1, True), (1 << 20, True), ((1 << 20) + 1, False)])
def test_a_message_of_up_to_a_mebibyte_is_believed(length: int, fine: bool) -> None:
    said = struct.pack(">I", length) + b"\x68" + bytes(max(0, length - 1))
    with server(VERSION, said) as source:
        if fine:
            assert source._message() == (104, bytes(length - 1))
        else:
            with pytest.raises(LinkLost, match=f"a message of {length} bytes; this is not SFTP"):
                source._message()


def test_a_folder_of_too_many_names_is_not_believed_to_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    assert sftp.MOST_NAMES == 200_000
    monkeypatch.setattr(sftp, "MOST_NAMES", 3)
    one = name(b"a", FILE, 1)
    heard: list[int] = []
    with server(VERSION, message(102, 0, b"h"), names(1, one, one, one), names(2, one), end(3), heard=heard) as source:
        with pytest.raises(Unreadable, match=r"\./scans: more than 3 names"):
            source.listing("scans")
        assert [kind for kind, _ in questions(heard)] == [1, 11, 12, 12, 4]


def test_a_number_of_32_bits_goes_round() -> None:
    with server(VERSION, message(102, 0xFFFFFFFF, b"h"), end(0), end(1, 0)) as source:
        source._next = 0xFFFFFFFF
        assert source.listing("scans") == []


@pytest.mark.parametrize(
    ("flags", "rest", "entry"),
    [
        (0x1 | 0x4, struct.pack(">QI", 5, FILE), RemoteEntry("a", 5, False, 0)),
        (0x1 | 0x2 | 0x4, struct.pack(">QIII", 5, 1000, 1000, FILE), RemoteEntry("a", 5, False, 0)),
        (0x1 | 0x4 | 0x8, struct.pack(">QIII", 5, FOLDER, 7, 9), RemoteEntry("a", 5, True, 9)),
        (0x80000005, struct.pack(">QIII1sI1sI1sI1s", 5, FILE, 2, 1, b"k", 1, b"v", 1, b"k", 1, b"v"), RemoteEntry("a", 5, False, 0)),
        (0x4, struct.pack(">I", FILE), None),
        (0x1, struct.pack(">Q", 5), None),
        (0x1 | 0x4, struct.pack(">QI", 5, 0o010644), None),
    ],
)  # fmt: skip
def test_attributes_are_taken_as_their_flags_say_and_what_follows_is_read_right(
    flags: int, rest: bytes, entry: RemoteEntry | None
) -> None:
    """Section 5 of the draft; a second name stands behind the first."""
    first = struct.pack(">I1sI1sI", 1, b"a", 1, b"x", flags) + rest
    with server(VERSION, message(102, 0, b"h"), names(1, first, name(b"z", FILE, 7)), end(2), end(3, 0)) as source:
        wanted = [RemoteEntry("z", 7, False, 9)]
        assert source.listing("s") == ([entry, *wanted] if entry is not None else wanted)


def test_names_beyond_ascii_and_the_folder_itself_are_left_out() -> None:
    some = names(1, name("ä".encode(), FILE, 1), name(b"..", FOLDER, 1), name(b".", FOLDER, 1), name(b"a", FILE, 1))
    with server(VERSION, message(102, 0, b"h"), some, end(2), end(3, 0)) as source:
        assert [one.name for one in source.listing("s")] == ["a"]


@pytest.mark.parametrize(("version", "fine"), [(2, False), (3, True), (4, True)])
def test_version_3_or_a_later_one_is_spoken(version: int, fine: bool) -> None:
    greeting = struct.pack(">IBI", 5, 2, version)
    if fine:
        with server(greeting):
            pass
    else:
        with pytest.raises(PullError, match="speaks SFTP version 2; version 3 is needed"), server(greeting):
            pass


def test_a_greeting_of_another_kind_has_no_version() -> None:
    with pytest.raises(PullError, match="version None"), server(message(101, 3)):
        pass


@pytest.mark.parametrize(
    ("code", "said"), [(2, "./f: not there"), (3, "./f: not given by the server"), (4, r"./f: full \(SFTP status 4\)")]
)
def test_a_refusal_is_told_in_words_or_by_its_code(code: int, said: str) -> None:
    with server(VERSION, end(0, code, b"full")) as source, pytest.raises((NotThere, Unreadable), match=f"^{said}$"):
        list(source.read("f", 0, 1))


def test_a_folder_that_is_no_longer_given_on_its_way_is_told() -> None:
    some = names(1, name(b"a", FILE, 1))
    denied = pytest.raises(Unreadable, match=r"^\./s: not given by the server$")
    with server(VERSION, message(102, 0, b"h"), some, end(2, 3), end(3, 0)) as source, denied:
        source.listing("s")


def test_a_link_that_takes_nothing_any_more_or_breaks_is_lost() -> None:
    ours, writing = os.pipe()
    with server(VERSION) as source:
        source._out = writing
        os.set_blocking(writing, False)
        with suppress(BlockingIOError):
            while True:
                os.write(writing, bytes(4096))
        with pytest.raises(LinkLost, match=r"the link took nothing for 0\.05 s"):
            source.listing("scans")
        os.close(ours)
        with pytest.raises(LinkLost, match="the link broke"):
            source.listing("scans")
        source._in = writing
        with pytest.raises(LinkLost, match="the link broke"):
            source._exactly(1)
    os.close(writing)


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
