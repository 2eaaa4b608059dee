"""Owns the reading half of SFTP version 3 (draft-ietf-secsh-filexfer-02) over two pipes: what the instrument's server is asked.

Only messages that read are known here. Every answer has to come within a limit, and lengths are believed only up to a limit.
"""

from __future__ import annotations

import os
import select
import stat
import struct
import time
from collections import deque
from collections.abc import Iterator

from appliance.offline.pull.source import LinkLost, NotThere, PullError, RemoteEntry, Unreadable

INIT, VERSION, OPEN, CLOSE, READ, OPENDIR, READDIR = 1, 2, 3, 4, 5, 11, 12
STATUS, HANDLE, DATA, NAMES = 101, 102, 103, 104
END, NO_SUCH_FILE, DENIED = 1, 2, 3
OPEN_TO_READ = 1
HAS_SIZE, HAS_OWNER, HAS_MODE, HAS_TIMES, HAS_MORE = 0x1, 0x2, 0x4, 0x8, 0x80000000
SPOKEN = 3

ASKED_BYTES = 64 * 1024
ASKED_AT_ONCE = 32
"""2 MB on the way: a link of 100 Mbit/s is full up to 0.16 s away."""
MOST_BYTES = 1024 * 1024
"""Longest message that is believed; OpenSSH sends up to 256 KiB."""
MOST_NAMES = 200_000
"""Most names in a folder that are believed."""
_NUMBER, _LONG = struct.Struct(">I"), struct.Struct(">Q")


class SftpSource:
    """A storage root on an SFTP server. Not thread-safe; after LinkLost it is of no more use."""

    def __init__(self, reading: int, writing: int, limit_s: float, root: str = ".") -> None:
        """Greet the server over the file descriptors ``reading`` and ``writing``; ``limit_s``: longest silence.

        Raises LinkLost, PullError for a server that speaks another version.
        """
        self._in, self._out, self._limit_s = reading, writing, limit_s
        self._root = root
        self._rest = bytearray()
        self._next = 0
        self._answers: dict[int, tuple[int, bytes]] = {}
        self._unwanted: set[int] = set()
        """Numbers of requests whose answers nobody waits for any more."""
        self._send(INIT, _NUMBER.pack(SPOKEN))
        kind, body = self._message()
        version = _Fields(body).number() if kind == VERSION else None
        if version is None or version < SPOKEN:
            raise PullError(f"the server there speaks SFTP version {version}; version {SPOKEN} is needed")

    def listing(self, folder: str) -> list[RemoteEntry]:
        """See ``Source``."""
        path = self._path(folder)
        handle = self._handle(self._ask(OPENDIR, _text(path)), path)
        found: list[RemoteEntry] = []
        try:
            while True:
                kind, body = self._answer(self._ask(READDIR, _bytes(handle)))
                if kind == STATUS and body.number() == END:
                    return sorted(found, key=lambda entry: entry.name)
                if kind != NAMES:
                    raise self._refusal(kind, body, path)
                for _ in range(body.number()):
                    entry = _entry(body)
                    if entry is not None:
                        found.append(entry)
                if len(found) > MOST_NAMES:
                    raise Unreadable(f"{path}: more than {MOST_NAMES} names")
        finally:
            self._dismiss(self._ask(CLOSE, _bytes(handle)))

    def read(self, path: str, start: int, end: int) -> Iterator[bytes]:
        """See ``Source``."""
        path = self._path(path)
        handle = self._handle(self._ask(OPEN, _text(path) + _NUMBER.pack(OPEN_TO_READ) + _NUMBER.pack(0)), path)
        waiting: deque[tuple[int, int, int]] = deque()
        try:
            asked = start
            while True:
                # Many requests are on the way at once: else each block would cost a journey there and back.
                while asked < end and len(waiting) < ASKED_AT_ONCE:
                    length = min(ASKED_BYTES, end - asked)
                    waiting.append((self._ask_block(handle, asked, length), asked, length))
                    asked += length
                if not waiting:
                    return
                number, at, length = waiting.popleft()
                kind, body = self._answer(number)
                if kind == STATUS and body.number() == END:
                    return
                data = body.text() if kind == DATA else b""
                if kind != DATA or not 0 < len(data) <= length:
                    raise self._refusal(kind, body, path)
                if len(data) < length:
                    # A server may give less than was asked; the rest is wanted before what was asked behind it.
                    at, length = at + len(data), length - len(data)
                    waiting.appendleft((self._ask_block(handle, at, length), at, length))
                yield data
        finally:
            for number, _, _ in waiting:
                self._dismiss(number)
            self._dismiss(self._ask(CLOSE, _bytes(handle)))

    # ---------------------------------------------------------------------------------- messages

    def _path(self, path: str) -> str:
        return f"{self._root}/{path}" if path else self._root

    def _ask_block(self, handle: bytes, at: int, length: int) -> int:
        return self._ask(READ, _bytes(handle) + _LONG.pack(at) + _NUMBER.pack(length))

    def _ask(self, kind: int, body: bytes) -> int:
        number = self._next
        self._next = (self._next + 1) & 0xFFFFFFFF
        self._send(kind, _NUMBER.pack(number) + body)
        return number

    def _send(self, kind: int, body: bytes) -> None:
        data = memoryview(_NUMBER.pack(len(body) + 1) + bytes((kind,)) + body)
        deadline_s = time.monotonic() + self._limit_s
        while data:
            if not select.select([], [self._out], [], max(0.0, deadline_s - time.monotonic()))[1]:
                raise LinkLost(f"the link took nothing for {self._limit_s:g} s")
            try:
                data = data[os.write(self._out, data) :]
            except OSError as error:
                raise LinkLost("the link broke") from error

    def _dismiss(self, number: int) -> None:
        if self._answers.pop(number, None) is None:
            self._unwanted.add(number)

    def _answer(self, number: int) -> tuple[int, _Fields]:
        while number not in self._answers:
            kind, body = self._message()
            fields = _Fields(body)
            answered = fields.number()
            if answered in self._unwanted:
                self._unwanted.discard(answered)
            elif len(self._answers) > ASKED_AT_ONCE:
                raise LinkLost("the server answers what it was not asked")
            else:
                self._answers[answered] = kind, fields.rest()
        kind, body = self._answers.pop(number)
        return kind, _Fields(body)

    def _message(self) -> tuple[int, bytes]:
        (length,) = _NUMBER.unpack(self._exactly(4))
        if not 1 <= length <= MOST_BYTES:
            raise LinkLost(f"the server sent a message of {length} bytes; this is not SFTP, or it was damaged")
        data = self._exactly(length)
        return data[0], data[1:]

    def _exactly(self, length: int) -> bytes:
        while len(self._rest) < length:
            # Any byte is a sign of life: a slow link is waited for, a silent one is not.
            if not select.select([self._in], [], [], self._limit_s)[0]:
                raise LinkLost(f"nothing came for {self._limit_s:g} s")
            try:
                data = os.read(self._in, 1 << 18)
            except OSError as error:
                raise LinkLost("the link broke") from error
            if not data:
                raise LinkLost("the link broke")
            self._rest += data
        taken = bytes(self._rest[:length])
        del self._rest[:length]
        return taken

    def _handle(self, number: int, path: str) -> bytes:
        kind, body = self._answer(number)
        if kind != HANDLE:
            raise self._refusal(kind, body, path)
        return body.text()

    def _refusal(self, kind: int, body: _Fields, path: str) -> Exception:
        """Return the error for an answer that is not the wanted one."""
        if kind != STATUS:
            return LinkLost(f"the server answered {path} with a message of kind {kind} that does not fit")
        body.again()
        code, text = body.number(), body.text().decode("utf-8", "replace")
        if code == NO_SUCH_FILE:
            return NotThere(f"{path}: not there")
        return Unreadable(
            f"{path}: " + ("not given by the server" if code == DENIED else f"{text} (SFTP status {code})")
        )


class _Fields:
    """The fields of one message, from its beginning on. Raises LinkLost where it ends too early."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def number(self) -> int:
        (value,) = _NUMBER.unpack(self._take(4))
        return int(value)

    def long(self) -> int:
        (value,) = _LONG.unpack(self._take(8))
        return int(value)

    def text(self) -> bytes:
        return self._take(self.number())

    def rest(self) -> bytes:
        return self._data[self._at :]

    def again(self) -> None:
        self._at = 0

    def _take(self, length: int) -> bytes:
        part = self._data[self._at : self._at + length]
        if len(part) != length:
            raise LinkLost("the server sent a message that ends too early")
        self._at += length
        return part


def _entry(body: _Fields) -> RemoteEntry | None:
    """Return the next name with its attributes (section 5 of the draft); ``None`` for what is neither file nor folder."""
    raw = body.text()
    body.text()  # the same for people, in a form of the server's own
    flags = body.number()
    size = body.long() if flags & HAS_SIZE else None
    if flags & HAS_OWNER:
        body.long()
    mode = body.number() if flags & HAS_MODE else 0
    changed_s = body.long() & 0xFFFFFFFF if flags & HAS_TIMES else 0
    if flags & HAS_MORE:
        for _ in range(body.number()):
            body.text()
            body.text()
    try:
        name = raw.decode("ascii")
    except UnicodeDecodeError:
        return None
    folder = stat.S_ISDIR(mode)
    if name in (".", "..") or size is None or not (folder or stat.S_ISREG(mode)):
        return None
    return RemoteEntry(name, size, folder, changed_s)


def _text(text: str) -> bytes:
    return _bytes(text.encode())


def _bytes(data: bytes) -> bytes:
    return _NUMBER.pack(len(data)) + data
