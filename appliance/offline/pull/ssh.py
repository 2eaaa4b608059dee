"""Owns the link to an instrument: Debian's own `ssh`, which does keys, host keys and encryption, and what its complaints mean."""

from __future__ import annotations

import re
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from appliance.offline.pull.sftp import SftpSource
from appliance.offline.pull.source import LinkLost, PullError

USER = "kingfisher-pull"
PORT = 2222
"""Port of the instrument's server; not 22, which a Debian with a login of its own may use."""
SERVED = "data"
"""Folder in which the instrument's server shows its storage root; beside it lies ``instrument`` with the rig file."""
ANSWER_S = 30.0
"""Longest silence before a link counts as broken."""
END_S = 5.0
_COMPLAINTS = {
    r"remote host identification has changed|host key verification failed|host key .* has changed": (
        "its host key is another one than before. If the instrument's disk was made anew, forget the old one with "
        "`ssh-keygen -R '[{host}]:{port}'`; if not, this is another computer"
    ),
    r"permission denied|no supported authentication|too many authentication failures": (
        "it does not take this key. Enrol the public one (a stick with kingfisher-keys.pub while TRANSFER is on), or give "
        "the right private one with --identity"
    ),
    r"could not resolve hostname|name or service not known": (
        "no computer of that name is known; give the address that the instrument's menu shows under TRANSFER"
    ),
    r"connection refused": (
        "nobody listens at port {port}; switch TRANSFER on in the instrument's menu (it is off after each power-on)"
    ),
    r"unprotected private key file|bad permissions": "the file of the private key may be read by others: chmod 600 it",
    r"identity file .* not accessible|invalid format|error in libcrypto": (
        "the private key cannot be read; give its file with --identity"
    ),
    r"subsystem request failed": "it has no SFTP; is this the instrument?",
    r"bad configuration option|extra arguments": "ssh does not understand its settings",
}
"""Complaints of `ssh` where trying again is of no use, and what to do."""
_NOT_YET = ("could not resolve", "connection refused")
"""Complaints that may pass by itself once there has been a link: the instrument starts again, a network comes back."""


@dataclass(frozen=True, slots=True)
class Host:
    """An instrument on the network."""

    name: str
    """``[user@]host``, or a name of the user's ssh configuration."""
    port: int | None = None
    identity: Path | None = None
    known_hosts: Path | None = None
    """File of the host keys that were seen; ``None``: the user's own."""

    @property
    def user_and_host(self) -> str:
        """Host as `ssh` is given it, with the user of the instrument's server where none is said."""
        return self.name if "@" in self.name else f"{USER}@{self.name}"

    def command(self, limit_s: float) -> list[str]:
        """Return the command that gives an SFTP server on its two pipes, and never asks anything."""
        alive_s = max(1, round(limit_s / 6))
        settings = {
            "BatchMode": "yes",
            # The first key is believed and remembered, any other one afterwards is refused.
            "StrictHostKeyChecking": "accept-new",
            "ConnectTimeout": f"{max(1, round(limit_s / 2))}",
            "ServerAliveInterval": f"{alive_s}",
            "ServerAliveCountMax": "3",
            "ClearAllForwardings": "yes",
            "ForwardAgent": "no",
            "ForwardX11": "no",
            "RequestTTY": "no",
            # A connection that another ssh shares would not end with this one.
            "ControlPath": "none",
        }
        if self.known_hosts is not None:
            settings["UserKnownHostsFile"] = str(self.known_hosts)
        command = ["ssh", *(word for name, value in settings.items() for word in ("-o", f"{name}={value}"))]
        command += ["-p", str(PORT if self.port is None else self.port)]
        if self.identity is not None:
            command += ["-o", "IdentitiesOnly=yes", "-i", str(self.identity)]
        return [*command, "-s", "--", self.user_and_host, "sftp"]


class SshLink:
    """Opens links to one instrument, one after the other."""

    def __init__(self, host: Host, limit_s: float = ANSWER_S) -> None:
        self._host, self._limit_s = host, limit_s
        self._linked = False
        """True once there was a link: what is wrong later may pass."""

    @contextmanager
    def __call__(self) -> Iterator[SftpSource]:
        """Open a link, which ends with the block. Raises LinkLost, PullError where trying again is of no use."""
        with tempfile.TemporaryFile() as complaints:
            try:
                process = subprocess.Popen(
                    self._host.command(self._limit_s), stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=complaints
                )
            except FileNotFoundError:
                raise PullError(
                    "`ssh` is not on this computer; install openssh-client (Debian: apt install it)"
                ) from None
            assert process.stdin is not None
            assert process.stdout is not None
            try:
                source = SftpSource(process.stdout.fileno(), process.stdin.fileno(), self._limit_s, SERVED)
                self._linked = True
                yield source
            except LinkLost as lost:
                _end(process)
                complaints.seek(0)
                raise self._meant(complaints.read(65_536).decode("utf-8", "replace"), lost) from lost
            finally:
                _end(process)

    def _meant(self, said: str, lost: LinkLost) -> LinkLost | PullError:
        """Return what to tell of a link that ended, by what `ssh` said of it."""
        host, port = self._host.name.rpartition("@")[2], self._host.port or PORT
        passes = self._linked and any(word in said.lower() for word in _NOT_YET)
        for pattern, meaning in () if passes else _COMPLAINTS.items():
            if re.search(pattern, said, re.IGNORECASE):
                return PullError(f"{self._host.name}: {meaning.format(host=host, port=port)} (ssh: {_last(said)})")
        return LinkLost(f"{self._host.name}: {_last(said) or lost}")


def _end(process: subprocess.Popen[bytes]) -> None:
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with suppress(OSError):
                pipe.close()
    for stop in (process.terminate, process.kill):
        try:
            process.wait(END_S)
            return
        except subprocess.TimeoutExpired:
            stop()
    with suppress(subprocess.TimeoutExpired):
        process.wait(END_S)


def _last(said: str) -> str:
    """Return the last line that tells something."""
    lines = [line.strip() for line in said.splitlines() if line.strip() and not line.startswith(("@", "Warning: Perm"))]
    return lines[-1][:200] if lines else ""
