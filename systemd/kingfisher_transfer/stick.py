"""Owns what a USB stick may do: give a file of keys to enrol, or one of keys to forget, while the transfer is on.

    kingfisher-keys.pub      keys that are enrolled
    kingfisher-forget.pub    keys that are forgotten

The stick is mounted for reading only, in the mount namespace of this process alone, and for as long as two small files take.
"""

from __future__ import annotations

import os
import stat
import subprocess
import tempfile
from pathlib import Path

from kingfisher_transfer import keys
from kingfisher_transfer.keys import KeysError

ENROL, FORGET = "kingfisher-keys.pub", "kingfisher-forget.pub"
KINDS = "vfat,exfat,ext4"
"""File systems that sticks come with. Others are not tried: each is a parser of foreign bytes in the kernel."""
MOUNT_S = 20.0


def of_device(device: Path, authorized: Path) -> str:
    """Do what the stick at ``device`` asks for; returns a line to tell, empty where it asks for nothing. Raises KeysError."""
    with tempfile.TemporaryDirectory(prefix="kingfisher-stick-") as folder:
        _run(["mount", "-t", KINDS, "-o", "ro,nosuid,nodev,noexec", "--", str(device), folder])
        try:
            return of_folder(Path(folder), authorized)
        finally:
            _run(["umount", "--", folder])


def of_folder(folder: Path, authorized: Path) -> str:
    """Do what a mounted stick asks for; returns a line to tell, empty where it asks for nothing. Raises KeysError."""
    said = []
    wanted = _file(folder / ENROL)
    if wanted is not None:
        new = keys.enrol(authorized, wanted)
        said.append(f"{len(new)} keys enrolled{_named(new)}" if new else "all its keys are enrolled already")
    unwanted = _file(folder / FORGET)
    if unwanted is not None:
        gone = keys.forget(authorized, {key.fingerprint for key in keys.parsed(unwanted)})
        said.append(f"{len(gone)} keys forgotten{_named(gone)}")
    return "; ".join(said)


def _named(changed: list[keys.Key]) -> str:
    return "".join(f", {key.fingerprint} {key.comment}".rstrip() for key in changed)


def _file(path: Path) -> bytes | None:
    """Return what is in an ordinary file; ``None`` where there is none. Raises KeysError."""
    try:
        # No link is followed: a stick must not make this process read the instrument's own files.
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise KeysError(f"{path.name}: {error.strerror}") from error
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise KeysError(f"{path.name}: no ordinary file")
        return os.read(descriptor, keys.MOST_BYTES + 1)
    except OSError as error:
        raise KeysError(f"{path.name}: {error.strerror}") from error
    finally:
        os.close(descriptor)


def _run(command: list[str]) -> None:
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=MOUNT_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise KeysError(f"{command[0]}: {error}") from error
    if done.returncode != 0:
        raise KeysError(f"{command[0]}: {done.stderr.strip()[-200:]}")
