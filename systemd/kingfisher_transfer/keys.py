"""Owns the enrolled keys: which lines are taken for one, and that the file holds nothing else.

    /var/lib/kingfisher-transfer/authorized_keys    one `type base64 comment` a line; replaced as a whole

A line is judged by `ssh-keygen`, and only type, key and comment of it are kept: what else may stand in such a file (a command, an
environment) is not the business of whoever plugs in a stick.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

from kingfisher_setup import durable

MOST_BYTES = 65_536
"""Largest file of keys that is read from a stick."""
MOST_KEYS = 32
"""Most keys that are enrolled at a time: a lost stick is found in a list that a person can read."""
LEAST_RSA_BITS = 3072
TYPES = ("ssh-ed25519", "sk-ssh-ed25519@openssh.com", "ecdsa-sha2-nistp256", "ecdsa-sha2-nistp384",
         "ecdsa-sha2-nistp521", "sk-ecdsa-sha2-nistp256@openssh.com", "ssh-rsa")  # fmt: skip
_LINE = re.compile(r"(\S+) ([A-Za-z0-9+/=]{60,20000})(?: (.*))?")
KEYGEN_S = 10.0


class KeysError(Exception):
    """Keys cannot be taken; the text says which and why."""


@dataclass(frozen=True, slots=True)
class Key:
    """One public key."""

    kind: str
    base64: str
    comment: str
    fingerprint: str
    """As `ssh-keygen -l` says it: ``SHA256:…``."""

    @property
    def line(self) -> str:
        """The key as it stands in the file."""
        return f"{self.kind} {self.base64} {self.comment}".rstrip()


def parsed(data: bytes) -> list[Key]:
    """Return the keys in a file, one a line; empty lines and those with a # are left out. Raises KeysError, which names the line."""
    if len(data) > MOST_BYTES:
        raise KeysError(f"{len(data)} bytes; at most {MOST_BYTES} are read: give a file of public keys, one a line")
    found = []
    for number, raw in enumerate(data.split(b"\n"), 1):
        line = raw.decode("ascii", "replace").strip()
        if line and not line.startswith("#"):
            found.append(_key(line, f"line {number}"))
    return found


def enrolled(path: Path) -> list[Key]:
    """Return the keys that are enrolled. Raises KeysError for a file that somebody else wrote wrong."""
    try:
        return parsed(path.read_bytes())
    except FileNotFoundError:
        return []
    except OSError as error:
        raise KeysError(f"{path}: {error.strerror}") from error


def enrol(path: Path, data: bytes) -> list[Key]:
    """Add the keys in ``data`` that are not there yet, durably, and return them. Raises KeysError; then none of them was added."""
    there = enrolled(path)
    known = {key.base64 for key in there}
    new: list[Key] = []
    for key in parsed(data):
        if key.base64 not in known:
            known.add(key.base64)
            new.append(key)
    if len(known) > MOST_KEYS:
        raise KeysError(f"{len(known)} keys; at most {MOST_KEYS} are enrolled: forget some")
    if new:
        _write(path, [*there, *new])
    return new


def forget(path: Path, wanted: set[str]) -> list[Key]:
    """Take the keys of these fingerprints out, durably, and return them. Raises KeysError."""
    there = enrolled(path)
    gone = [key for key in there if key.fingerprint in wanted]
    if gone:
        _write(path, [key for key in there if key not in gone])
    return gone


def _write(path: Path, keys: list[Key]) -> None:
    # Readable for everybody: sshd reads it as the user who wants to come in. Nothing in it is secret.
    durable.write(path, "".join(f"{key.line}\n" for key in keys).encode())


def _key(line: str, where: str) -> Key:
    found = _LINE.fullmatch(line)
    if "PRIVATE KEY" in line:
        raise KeysError(f"{where}: a private key; never give it away. The public one is the file that ends in .pub")
    if found is None or found[1] not in TYPES:
        raise KeysError(f"{where}: no public key; allowed is `type key comment`, of {', '.join(TYPES)}")
    kind, base64 = found[1], found[2]
    comment = re.sub(r"[^A-Za-z0-9@._+-]+", "-", found[3] or "").strip("-")[:60]
    with tempfile.NamedTemporaryFile("w", suffix=".pub") as file:
        file.write(f"{kind} {base64}\n")
        file.flush()
        try:
            done = subprocess.run(
                ["ssh-keygen", "-l", "-E", "sha256", "-f", file.name],
                stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=KEYGEN_S, check=False,
            )  # fmt: skip
        except (OSError, subprocess.TimeoutExpired) as error:
            raise KeysError(f"ssh-keygen: {error}; install openssh-client") from error
    said = re.match(r"(\d+) (SHA256:\S+) ", done.stdout)
    if done.returncode != 0 or said is None:
        raise KeysError(f"{where}: ssh-keygen takes it for no key; copy the .pub file anew")
    if kind == "ssh-rsa" and int(said[1]) < LEAST_RSA_BITS:
        raise KeysError(f"{where}: RSA with {said[1]} bits; at least {LEAST_RSA_BITS}, or better ed25519")
    return Key(kind, base64, comment, said[2])
