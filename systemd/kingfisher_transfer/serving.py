"""Owns the transfer while it is on: the host key, the server, and what the diver's screen is told, until the note is gone.

/run/kingfisher/transfer-on                 the appliance's note; the unit is started by it and ends when it goes
/run/kingfisher-transfer/status.json        what the screen is told
/run/kingfisher-transfer/root               what the server shows, and nothing else
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from kingfisher_setup import durable
from kingfisher_transfer import addresses, keys
from kingfisher_transfer.keys import KeysError

LOOK_S = 1.0
"""Between two looks at the note, the addresses and the keys."""
SSHD = "/usr/sbin/sshd"
KEYGEN_S = 30.0
TRIES = 3
"""How often a server that ends by itself is started, before the unit fails."""
END_S = 5.0


@dataclass(frozen=True, slots=True)
class Places:
    """Where everything lies; a test has places of its own."""

    note: Path = Path("/run/kingfisher/transfer-on")
    status: Path = Path("/run/kingfisher-transfer/status.json")
    config: Path = Path(__file__).parents[1] / "kingfisher-sshd.conf"
    host_key: Path = Path("/var/lib/kingfisher-transfer/host_ed25519")
    authorized: Path = Path("/var/lib/kingfisher-transfer/authorized_keys")
    news: Path = Path("/var/lib/kingfisher-transfer/news")
    """The latest line about a stick."""


def serve(places: Places, ready: Callable[[], None], stopping: threading.Event) -> int:
    """Serve until the note is gone or ``stopping`` is set; returns the exit code.

    ``ready`` is called once the status says how it stands: that the server runs, or why it cannot.
    """
    try:
        make_host_key(places.host_key)
    except KeysError as error:
        return _failed(places, str(error), ready, stopping)
    for _ in range(TRIES):
        # -D: stays in this unit, so that it ends with it. -e: says what it has to say to the journal.
        try:
            server = subprocess.Popen(
                [SSHD, "-D", "-e", "-f", str(places.config)], stdin=subprocess.DEVNULL, env={"PATH": os.defpath}
            )
        except OSError as error:
            return _failed(places, f"{SSHD}: {error.strerror}; install openssh-server", ready, stopping)
        try:
            if _watch(places, server, ready, stopping):
                return 0
        finally:
            _end(server)
    return _failed(places, "sshd ends by itself; `journalctl -u kingfisher-transfer` says why", ready, stopping)


def make_host_key(path: Path) -> None:
    """Make the instrument's host key where there is none: each instrument has its own, made on it. Raises KeysError."""
    if path.exists() and path.stat().st_size and _public(path).exists():
        return
    draft = path.with_name(f".{path.name}.draft")
    durable.make_folder(path.parent)
    for half in (draft, _public(draft)):  # after a loss of power; ssh-keygen would ask whether to replace it
        half.unlink(missing_ok=True)
    try:
        subprocess.run(
            ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", "kingfisher", "-f", str(draft)],
            stdin=subprocess.DEVNULL, capture_output=True, timeout=KEYGEN_S, check=True,
        )  # fmt: skip
        # The key that decides comes last: whoever finds it finds both.
        durable.publish(_public(draft), _public(path))
        durable.publish(draft, path)
    except (OSError, subprocess.SubprocessError) as error:
        raise KeysError(f"no host key: {error}; is openssh-server installed?") from error


def _public(key: Path) -> Path:
    """Return the file of the public half, as ssh-keygen names it."""
    return key.with_name(f"{key.name}.pub")


def _failed(places: Places, reason: str, ready: Callable[[], None], stopping: threading.Event) -> int:
    """Tell that it cannot be served, until the note is gone; returns the exit code."""
    # Ended, the note would start the unit again at once, and the screen would flicker between two words.
    _tell(places, "failed", reason)
    ready()
    while places.note.exists() and not stopping.wait(LOOK_S):
        _tell(places, "failed", reason)
    return 1


def _watch(
    places: Places, server: subprocess.Popen[bytes], ready: Callable[[], None], stopping: threading.Event
) -> bool:
    """Return True when the end is wanted, False when the server ended by itself."""
    since_s = time.monotonic()
    told = False
    while True:
        if stopping.wait(LOOK_S) or not places.note.exists():
            return True
        if server.poll() is not None:
            return False
        _tell(places, "on", "")
        if not told and time.monotonic() - since_s > LOOK_S / 2:
            ready()
            told = True


def _tell(places: Places, state: str, reason: str) -> None:
    """Write what the screen is told; a file that is the same already is not written again."""
    try:
        count: int | None = len(keys.enrolled(places.authorized))
    except KeysError as error:
        count, reason = None, str(error)
    news = places.news.read_text("utf-8") if places.news.exists() else ""
    there = addresses.of_this_machine()
    content = {
        "state": state, "reason": reason[:500], "addresses": there, "keys": count, "news": news[:500],
    }  # fmt: skip
    data = json.dumps(content, indent=1).encode()
    if places.status.exists() and places.status.read_bytes() == data:
        return
    draft = places.status.with_name(f".{places.status.name}.draft")
    draft.write_bytes(data)
    draft.chmod(0o644)
    draft.replace(places.status)
    sys.stderr.write(f"transfer: {state} {reason} at {', '.join(there) or 'no address'}, keys: {count}\n")


def _end(server: subprocess.Popen[bytes]) -> None:
    """End the server; the links it serves end with the unit."""
    server.terminate()
    try:
        server.wait(END_S)
    except subprocess.TimeoutExpired:
        server.kill()
        server.wait(END_S)


def on_signals(stopping: threading.Event) -> None:
    """SIGTERM and SIGINT end the serving."""
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stopping.set())
