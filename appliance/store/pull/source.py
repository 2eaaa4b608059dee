"""Owns what is asked of the place that scans are taken from, and how it is answered: by a mounted folder or a USB disk,
and by an instrument over SSH (asyncssh does keys, host keys, encryption and SFTP).

Paths are relative to the storage root there, with ``/`` between names. Nothing is ever changed there: the protocol has
no way to.
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
"""Port of the instrument's server; not 22, which a Debian with a login of its own may use."""
SERVED = "data"
"""Folder in which the instrument's server shows its storage root; beside it lies ``instrument`` with the rig file."""
MOST_NAMES = 200_000
"""Most names in a folder that are believed."""
KNOWN_HOSTS = "~/.ssh/known_hosts"
T = TypeVar("T")
_GONE = (errno.ENOENT, errno.ENOTDIR)
_LINK = (errno.EIO, errno.ENODEV, errno.ENXIO, errno.ESTALE, errno.ENOTCONN, errno.EHOSTDOWN, errno.ETIMEDOUT)
"""Errors of a network folder or a stick whose cable moved; a disk that fails gives the first of them, too."""


class PullError(Exception):
    """Scans cannot be taken from there at all; the text says why and what to do."""


class LinkLost(Exception):
    """The link broke or fell silent; what was taken is kept, and the next attempt goes on behind it."""


class NotThere(Exception):
    """A file or a folder is not there, or not any more."""


class Unreadable(Exception):
    """A file or a folder is there and is not given; the text names it."""


@dataclass(frozen=True, slots=True)
class RemoteEntry:
    """One name in a folder there."""

    name: str
    size_bytes: int
    folder: bool


class Source(Protocol):
    """A storage root that is read. Each call may raise LinkLost, and Unreadable for what is not given."""

    def listing(self, folder: str) -> list[RemoteEntry]:
        """Return the ordinary files and folders in a folder, by name. Raises NotThere."""

    def read(self, path: str, start: int, end: int) -> Iterator[bytes]:
        """Give a file's bytes from ``start`` to ``end``, in order; fewer where it ends before. Raises NotThere."""


class FolderSource:
    """A storage root on this computer: a mounted share, the instrument's disk, a USB disk."""

    def __init__(self, root: Path) -> None:
        self._root = root

    def listing(self, folder: str) -> list[RemoteEntry]:
        with self._told(folder) as path:
            found = [(one.name, one.lstat()) for one in sorted(path.iterdir())]
        return [entry for name, about in found if (entry := entry_of(name, about.st_mode, about.st_size)) is not None]

    def read(self, path: str, start: int, end: int) -> Iterator[bytes]:
        with self._told(path) as here, here.open("rb") as file:
            file.seek(start)
            while start < end and (block := file.read(min(BLOCK_BYTES, end - start))):
                start += len(block)
                yield block

    @contextmanager
    def _told(self, path: str) -> Iterator[Path]:
        """Give where ``path`` lies, and turn OSError into what the protocol promises."""
        here = self._root / path
        if is_linked(self._root, path):
            raise Unreadable(f"{here}: leads over a link, which could lead anywhere on this computer; not followed")
        try:
            yield here
        except OSError as error:
            kind = NotThere if error.errno in _GONE else LinkLost if error.errno in _LINK else Unreadable
            raise kind(f"{here}: {error.strerror or error}") from error


def entry_of(name: str, mode: int, size_bytes: int) -> RemoteEntry | None:
    """Return an entry of a listing; ``None`` for what is neither file nor folder: a link could lead anywhere."""
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        return None
    return RemoteEntry(name, size_bytes, stat.S_ISDIR(mode))


def is_linked(root: Path, path: str) -> bool:
    """Return True if a component of ``path`` below ``root`` is a link: on a strange disk it may lead to the desk's own
    files."""
    parts = Path(path).parts
    return any(root.joinpath(*parts[: k + 1]).is_symlink() for k in range(len(parts)))


def text_of(source: Source, path: str, most_bytes: int) -> bytes:
    """Return a whole small file. Raises NotThere, LinkLost, Unreadable where it is larger than ``most_bytes``."""
    data = b"".join(source.read(path, 0, most_bytes + 1))
    if len(data) > most_bytes:
        raise Unreadable(f"{path}: more than {most_bytes} bytes")
    return data


# -------------------------------------------------- an instrument on the network


@dataclass(slots=True)
class SshLink:
    """Opens links to one instrument, one after the other; inside, it is what the instrument serves.

    After LinkLost the link is of no more use.
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
    """True once there was a link: what is wrong later may pass."""
    _library: Any = None
    _loop: asyncio.AbstractEventLoop | None = None
    _sftp: Any = None

    @contextmanager
    def __call__(self) -> Iterator[SshLink]:
        """Open a link, which ends with the block.

        Raises LinkLost, PullError where trying again is of no use, MissingLibraryError.
        """
        self._library = library = needed(LIBRARY, LIBRARY, NEEDS_IT)
        # The loop runs only while something is waited for, so that Ctrl-C ends that wait, and the runner all that is
        # left then.
        with asyncio.Runner() as runner:
            self._loop = loop = runner.get_loop()
            try:
                connecting = asyncio.wait_for(self._connected(library), self.limit_s)
                connection, self._sftp = loop.run_until_complete(connecting)
            except (library.Error, OSError) as error:
                raise self._meant(library, error) from error
            self._linked = True
            try:
                yield self
            finally:
                connection.abort()

    async def _connected(self, library: ModuleType) -> tuple[Any, Any]:
        """Return a connection to a host whose key is known, and its SFTP; only keys are tried, and nothing is asked."""
        user, _, address = self.host.rpartition("@")
        try:
            options = library.SSHClientConnectionOptions(
                config=(),
                host=address,
                port=self.port,
                username=user or USER,
                preferred_auth="publickey",
                # The instrument has one host key; asked only for kinds that are known already, it would not show
                # another one.
                server_host_key_algs="default",
                # Done by the processor itself, and so twice as fast as the library's first choice.
                encryption_algs="^aes128-gcm@openssh.com",
                **self._keys(),
            )
            files = options.known_hosts if self.known_hosts is None else [str(self.known_hosts)]
            files = [str(Path(one).expanduser()) for one in files or [KNOWN_HOSTS]]
            known = library.read_known_hosts([one for one in files if Path(one).exists()])
        except (ValueError, OSError) as error:
            raise self._final(f"the private key, or ssh's own files, cannot be read: {error}") from error
        try:
            connection = await library.connect(address, self.port, options=options, known_hosts=known)
        except library.HostKeyNotVerifiable as error:
            key = await library.get_server_host_key(address, self.port)
            host, port = options.host_key_alias or options.host, options.port
            place = host if port == library.DEFAULT_PORT else f"[{host}]:{port}"
            if any(library.match_known_hosts(known, host, "", port)[0]):
                raise self._final(
                    f"its host key is another one than before ({key.get_fingerprint()}). If the instrument's disk was "
                    "made anew, "
                    f"forget the old one with `ssh-keygen -R '{place}' -f {files[0]}`; if not, this is another computer"
                ) from error
            raise self._final(
                f"its host key is not known here ({key.get_fingerprint()}). If it is the instrument that answers "
                "there, add this "
                f"line to {files[0]} and call again: {place} {key.export_public_key().decode().strip()}"
            ) from error
        return connection, await connection.start_sftp_client(path_errors="surrogateescape")

    def _keys(self) -> dict[str, Any]:
        """Return which private keys are tried; one that is given is the only one, and the agent may hold it by its
        public half."""
        if self.identity is None:
            return {}
        public = Path(f"{self.identity}.pub")
        agent = {"agent_identities": [str(public)]} if public.exists() else {"agent_path": None}
        return {"client_keys": [str(self.identity)], "ignore_encrypted": True, **agent}

    def _final(self, meaning: str) -> PullError:
        return PullError(f"{self.host}: {meaning}")

    def _meant(self, library: ModuleType, error: Exception) -> LinkLost | PullError:
        """Return what to tell of a link that was not to be had; what may pass by itself once there was one is a link
        that is lost."""
        said = str(error) or "nothing came"
        if isinstance(error, library.PermissionDenied):
            return self._final(
                "it does not take this key. Enrol the public one (a stick with kingfisher-keys.pub while TRANSFER is "
                "on), or give "
                f"the right private one with --identity; one with a passphrase has to be in ssh-agent ({said})"
            )
        if isinstance(error, library.ChannelOpenError):
            return self._final(f"it has no SFTP; is this the instrument? ({said})")
        if isinstance(error, socket.gaierror) and not self._linked:
            return self._final(
                "no computer of that name is known; give the address that the instrument's menu shows under TRANSFER "
                f"({said})"
            )
        # With several addresses of one name, asyncio tells all their errors in one text.
        refused = isinstance(error, ConnectionRefusedError) or f"[Errno {errno.ECONNREFUSED}]" in said
        if refused and not self._linked:
            return self._final(
                f"nobody listens at port {self.port}; switch TRANSFER on in the instrument's menu (it is off "
                "after each "
                f"power-on) ({said})"
            )
        return LinkLost(f"{self.host}: {said}")

    def listing(self, folder: str) -> list[RemoteEntry]:
        """See ``Source``."""
        return self._answer(self._listed(f"{SERVED}/{folder}"), folder)

    def read(self, path: str, start: int, end: int) -> Iterator[bytes]:
        """See ``Source``."""
        file = self._answer(self._sftp.open(f"{SERVED}/{path}", "rb"), path)
        # The library asks for the parts of a block at once: else each of them would cost a journey there and back.
        while start < end and (block := self._answer(file.read(min(BLOCK_BYTES, end - start), start), path)):
            start += len(block)
            yield block
        # Where reading ended early the link ends, too, and the handle with it.
        self._answer(file.close(), path)

    async def _listed(self, path: str) -> list[RemoteEntry]:
        found: list[RemoteEntry] = []
        async for one in self._sftp.scandir(path):
            about = one.attrs
            entry = entry_of(one.filename, about.permissions or 0, about.size or 0)
            if entry is not None and entry.name not in (".", ".."):
                found.append(entry)
            if len(found) > MOST_NAMES:
                raise Unreadable(f"{path}: more than {MOST_NAMES} names")
        return sorted(found, key=lambda entry: entry.name)

    def _answer(self, asked: Coroutine[Any, Any, T], path: str) -> T:
        """Wait for an answer about ``path``. Raises LinkLost, NotThere, Unreadable."""
        library, loop = self._library, self._loop
        assert loop is not None  # there is one while the link is open
        try:
            return loop.run_until_complete(asyncio.wait_for(asked, self.limit_s))
        except TimeoutError:
            raise LinkLost(f"nothing came for {self.limit_s:g} s") from None
        except (library.SFTPNoSuchFile, library.SFTPNoSuchPath) as error:
            raise NotThere(f"{path}: not there") from error
        except (library.SFTPConnectionLost, library.SFTPNoConnection, library.SFTPBadMessage) as error:
            raise LinkLost(f"the link broke ({error})") from error
        except library.SFTPError as error:
            raise Unreadable(f"{path}: not given by the server ({error})") from error
        except (library.Error, OSError) as error:
            raise LinkLost(f"the link broke ({error})") from error
