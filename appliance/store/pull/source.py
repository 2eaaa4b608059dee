"""Sources of a scan transfer: a mounted folder or USB disk, and an instrument over SSH.

Paths are relative to the storage root there, with ``/`` between names. The protocol cannot change files there.
``asyncssh`` does keys, host keys, encryption and SFTP.
"""

from __future__ import annotations

import asyncio
import errno
import socket
import stat
from collections.abc import Coroutine, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol, TypeVar

from appliance.base import needed

BLOCK_BYTES = 1024 * 1024
LIBRARY = "asyncssh"
NEEDS_IT = "an instrument on the network"
USER = "kingfisher-pull"
PORT = 2222
"""Port of the instrument's server; not 22, which a Debian with its own login may use."""
SERVED = "data"
"""Folder in which the instrument's server shows its storage root; beside it lies ``instrument`` with the rig file."""
MOST_NAMES = 200_000
"""Largest number of names that is accepted in a folder."""
KNOWN_HOSTS = "~/.ssh/known_hosts"
T = TypeVar("T")
_GONE = (errno.ENOENT, errno.ENOTDIR)
_LINK = (errno.EIO, errno.ENODEV, errno.ENXIO, errno.ESTALE, errno.ENOTCONN, errno.EHOSTDOWN, errno.ETIMEDOUT)
"""Errors of a network folder or a USB disk whose cable moved; a failing disk gives the first of them, too."""


class PullError(Exception):
    """Error of a source that gives no scans at all; the text has the reason and the remedy."""


class LinkLost(Exception):
    """Error of a link that broke or fell silent.

    Partial files are kept, and the next attempt continues them.
    """


class NotThere(Exception):
    """Error of a file or a folder that does not exist there, or no longer."""


class Unreadable(Exception):
    """Error of a file or a folder that exists but cannot be read; the text names it."""


@dataclass(frozen=True, slots=True)
class RemoteEntry:
    """One name in a folder there."""

    name: str
    size_bytes: int
    folder: bool


class Source(Protocol):
    """A storage root that is read. Each call may raise LinkLost and Unreadable."""

    def listing(self, folder: str) -> list[RemoteEntry]:
        """Return the ordinary files and folders in a folder, by name. Raises NotThere."""

    def read(self, path: str, start: int, end: int) -> Iterator[bytes]:
        """Yield a file's bytes from ``start`` to ``end``, in order; fewer where it ends before.

        Raises NotThere.
        """


class FolderSource:
    """A storage root on this computer: a mounted share, the instrument's disk, a USB disk."""

    def __init__(self, root: Path) -> None:
        self._root = root

    def listing(self, folder: str) -> list[RemoteEntry]:
        with self._path_of(folder) as path:
            stats = [(child.name, child.lstat()) for child in sorted(path.iterdir())]
        return [
            entry
            for name, stat_result in stats
            if (entry := entry_of(name, stat_result.st_mode, stat_result.st_size)) is not None
        ]

    def read(self, path: str, start: int, end: int) -> Iterator[bytes]:
        with self._path_of(path) as full_path, full_path.open("rb") as file:
            file.seek(start)
            while start < end and (block := file.read(min(BLOCK_BYTES, end - start))):
                start += len(block)
                yield block

    @contextmanager
    def _path_of(self, path: str) -> Iterator[Path]:
        """Yield the full path of ``path``, and turn OSError into the errors of ``Source``."""
        full_path = self._root / path
        if is_linked(self._root, path):
            raise Unreadable(f"{full_path}: is a symbolic link, which is not followed; replace it by its target")
        try:
            yield full_path
        except OSError as error:
            kind = NotThere if error.errno in _GONE else LinkLost if error.errno in _LINK else Unreadable
            raise kind(f"{full_path}: {error.strerror or error}") from error


def entry_of(name: str, mode: int, size_bytes: int) -> RemoteEntry | None:
    """Return an entry of a listing; ``None`` for a name that is neither file nor folder, such as a link."""
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        return None
    return RemoteEntry(name, size_bytes, stat.S_ISDIR(mode))


def is_linked(root: Path, path: str) -> bool:
    """Return True if a component of ``path`` below ``root`` is a link.

    On a strange disk a link may lead to the desk's own files.
    """
    parts = Path(path).parts
    return any(root.joinpath(*parts[: k + 1]).is_symlink() for k in range(len(parts)))


def text_of(source: Source, path: str, most_bytes: int) -> bytes:
    """Return a whole small file.

    Raises NotThere, LinkLost, Unreadable where it is larger than ``most_bytes``.
    """
    data = b"".join(source.read(path, 0, most_bytes + 1))
    if len(data) > most_bytes:
        raise Unreadable(f"{path}: more than {most_bytes} bytes")
    return data


# -------------------------------------------------- an instrument on the network


@dataclass(slots=True)
class SshLink:
    """Links to one instrument, one after the other; inside a ``with`` block it is a ``Source``.

    After LinkLost the link cannot be used any more.
    """

    host: str
    """``[user@]host``, or a name of the user's ssh configuration."""
    port: int
    identity: Path | None
    known_hosts: Path | None
    """File of the host keys that are trusted; ``None``: the user's own."""
    limit_s: float
    """Longest silence before a link counts as broken."""
    _linked: bool = False
    """True after the first link: a later fault may pass."""
    _library: Any = None
    _loop: asyncio.AbstractEventLoop | None = None
    _sftp: Any = None

    @contextmanager
    def __call__(self) -> Iterator[SshLink]:
        """Open a link, which ends with the block.

        Raises LinkLost, PullError where trying again is of no use, MissingLibraryError.
        """
        self._library = library = needed(LIBRARY, LIBRARY, NEEDS_IT)
        # The loop runs only during a wait, so that Ctrl-C ends that wait; the runner then cancels the remaining tasks.
        with asyncio.Runner() as runner:
            self._loop = loop = runner.get_loop()
            try:
                connecting = asyncio.wait_for(self._connect(library), self.limit_s)
                connection, self._sftp = loop.run_until_complete(connecting)
            except (library.Error, OSError) as error:
                raise self._error_of(library, error) from error
            self._linked = True
            try:
                yield self
            finally:
                connection.abort()

    async def _connect(self, library: ModuleType) -> tuple[Any, Any]:
        """Return a connection to a host with a known key, and its SFTP client.

        Keys are the only authentication.
        """
        user, _, address = self.host.rpartition("@")
        try:
            options = library.SSHClientConnectionOptions(
                config=(),
                host=address,
                port=self.port,
                username=user or USER,
                preferred_auth="publickey",
                # All kinds of host keys: with the known kinds alone, a changed key of another kind would not be seen.
                server_host_key_algs="default",
                # The processor has instructions for it: twice as fast as the library's first choice.
                encryption_algs="^aes128-gcm@openssh.com",
                **self._keys(),
            )
            files = options.known_hosts if self.known_hosts is None else [str(self.known_hosts)]
            files = [str(Path(file).expanduser()) for file in files or [KNOWN_HOSTS]]
            known_keys = library.read_known_hosts([file for file in files if Path(file).exists()])
        except (ValueError, OSError) as error:
            raise self._final(f"the private key, or ssh's own files, cannot be read: {error}") from error
        try:
            connection = await library.connect(address, self.port, options=options, known_hosts=known_keys)
        except library.HostKeyNotVerifiable as error:
            key = await library.get_server_host_key(address, self.port)
            host, port = options.host_key_alias or options.host, options.port
            place = host if port == library.DEFAULT_PORT else f"[{host}]:{port}"
            if any(library.match_known_hosts(known_keys, host, "", port)[0]):
                raise self._final(
                    f"its host key has changed ({key.get_fingerprint()}). If the instrument's disk was "
                    f"newly installed, remove the old one with `ssh-keygen -R '{place}' -f {files[0]}`; "
                    "otherwise this is another computer"
                ) from error
            raise self._final(
                f"its host key is unknown ({key.get_fingerprint()}). If this is the instrument, add this "
                f"line to {files[0]} and call again: {place} {key.export_public_key().decode().strip()}"
            ) from error
        return connection, await connection.start_sftp_client(path_errors="surrogateescape")

    def _keys(self) -> dict[str, Any]:
        """Return the options for private keys.

        A given key is the only one; the agent may hold it by its public half.
        """
        if self.identity is None:
            return {}
        public = Path(f"{self.identity}.pub")
        agent = {"agent_identities": [str(public)]} if public.exists() else {"agent_path": None}
        return {"client_keys": [str(self.identity)], "ignore_encrypted": True, **agent}

    def _final(self, meaning: str) -> PullError:
        return PullError(f"{self.host}: {meaning}")

    def _error_of(self, library: ModuleType, error: Exception) -> LinkLost | PullError:
        """Return the error of a link that failed: LinkLost where a later attempt may succeed, else PullError.

        After a first link, causes that may pass count as LinkLost.
        """
        text = str(error) or "no data"
        if isinstance(error, library.PermissionDenied):
            return self._final(
                "it does not accept this key; enrol the public key (a stick with kingfisher-keys.pub while "
                "TRANSFER is on), or give the right private key with --identity; a key with a passphrase "
                f"must be in ssh-agent ({text})"
            )
        if isinstance(error, library.ChannelOpenError):
            return self._final(f"it has no SFTP; give the address of the instrument ({text})")
        if isinstance(error, socket.gaierror) and not self._linked:
            return self._final(
                f"the name is unknown; give the address that the instrument's menu shows under TRANSFER ({text})"
            )
        # With several addresses of one name, asyncio puts all their errors into one text.
        refused = isinstance(error, ConnectionRefusedError) or f"[Errno {errno.ECONNREFUSED}]" in text
        if refused and not self._linked:
            return self._final(
                f"no service at port {self.port}; switch TRANSFER on in the instrument's menu (it is off "
                f"after each power-on) ({text})"
            )
        return LinkLost(f"{self.host}: {text}")

    def listing(self, folder: str) -> list[RemoteEntry]:
        """See ``Source``."""
        return self._answer(self._list(f"{SERVED}/{folder}"), folder)

    def read(self, path: str, start: int, end: int) -> Iterator[bytes]:
        """See ``Source``."""
        file = self._answer(self._sftp.open(f"{SERVED}/{path}", "rb"), path)
        # The library requests the parts of a block at once: else each of them would cost a round trip.
        while start < end and (block := self._answer(file.read(min(BLOCK_BYTES, end - start), start), path)):
            start += len(block)
            yield block
        # Where reading ends early the link ends, too, and the handle with it.
        self._answer(file.close(), path)

    async def _list(self, path: str) -> list[RemoteEntry]:
        entries: list[RemoteEntry] = []
        async for name in self._sftp.scandir(path):
            attributes = name.attrs
            entry = entry_of(name.filename, attributes.permissions or 0, attributes.size or 0)
            if entry is not None and entry.name not in (".", ".."):
                entries.append(entry)
            if len(entries) > MOST_NAMES:
                raise Unreadable(f"{path}: more than {MOST_NAMES} names")
        return sorted(entries, key=lambda entry: entry.name)

    def _answer(self, request: Coroutine[Any, Any, T], path: str) -> T:
        """Wait for an answer about ``path``. Raises LinkLost, NotThere, Unreadable."""
        library, loop = self._library, self._loop
        assert loop is not None  # there is one while the link is open
        try:
            return loop.run_until_complete(asyncio.wait_for(request, self.limit_s))
        except TimeoutError:
            raise LinkLost(f"no data for {self.limit_s:g} s") from None
        except (library.SFTPNoSuchFile, library.SFTPNoSuchPath) as error:
            raise NotThere(f"{path}: not there") from error
        except (library.SFTPConnectionLost, library.SFTPNoConnection, library.SFTPBadMessage) as error:
            raise LinkLost(f"the connection broke ({error})") from error
        except library.SFTPError as error:
            raise Unreadable(f"{path}: cannot be read ({error})") from error
        except (library.Error, OSError) as error:
            raise LinkLost(f"the connection broke ({error})") from error
