"""Owns what a piece of work asks of the kernel about durability: its fsync and rename calls, in their order, with paths.

Two witnesses. The kernel itself: a seccomp filter of one thread hands each of these calls to a listener before it is carried out
(seccomp_unotify(2), Linux 5.5 or later; no rights are needed). Where a sandbox forbids that, the functions of Python's ``os``
module, counted on their way to the kernel.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import platform
import select
import struct
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

NUMBERS = {
    "x86_64": {"seccomp": 317, "fsync": 74, "fdatasync": 75, "rename": 82, "renameat": 264, "renameat2": 316},
    "aarch64": {"seccomp": 277, "fsync": 82, "fdatasync": 83, "renameat": 38, "renameat2": 276},
}
"""Of arch/x86/entry/syscalls/syscall_64.tbl and include/uapi/asm-generic/unistd.h."""
PR_SET_NO_NEW_PRIVS = 38
SECCOMP_SET_MODE_FILTER, SECCOMP_FILTER_FLAG_NEW_LISTENER = 1, 8
SECCOMP_RET_ALLOW, SECCOMP_RET_USER_NOTIF = 0x7FFF0000, 0x7FC00000
SECCOMP_IOCTL_NOTIF_RECV, SECCOMP_IOCTL_NOTIF_SEND = 0xC0502100, 0xC0182101
SECCOMP_USER_NOTIF_FLAG_CONTINUE = 1
BPF_LOAD_WORD, BPF_JUMP_IF_EQUAL, BPF_RETURN = 0x20, 0x15, 0x06
NOTIFICATION = struct.Struct("<QIIiIQ6Q")
ANSWER = struct.Struct("<QqiI")


@dataclass(frozen=True)
class Call:
    """One call. ``path`` is that of the descriptor, or the old name; ``target`` the new one of a rename."""

    name: str
    path: Path
    target: Path | None = None


def seen_by_the_kernel(work: Callable[[], None]) -> list[Call]:
    """Run ``work`` in a thread of its own and return its calls as they reached the kernel. Skips the test where the kernel
    does not allow to listen; raises what ``work`` raised."""
    numbers = NUMBERS.get(platform.machine())
    if numbers is None:
        pytest.skip(f"the numbers of system calls are not known for {platform.machine()}")
    watched = {number: name for name, number in numbers.items() if name != "seccomp"}
    listener: list[int] = []
    raised: list[BaseException] = []
    ready, done = threading.Event(), threading.Event()

    def watched_work() -> None:
        try:
            listener.append(_listen(numbers["seccomp"], [*watched]))
            ready.set()
            work()
        except BaseException as error:
            raised.append(error)
        finally:
            ready.set()
            done.set()

    thread = threading.Thread(target=watched_work, daemon=True)
    thread.start()
    assert ready.wait(10.0)
    calls: list[Call] = []
    if listener:
        poll = select.poll()
        poll.register(listener[0], select.POLLIN)
        while not done.is_set():
            if any(event & select.POLLIN for _, event in poll.poll(50)):
                calls.append(_answered(listener[0], watched))
        os.close(listener[0])
    thread.join(10.0)
    if raised and isinstance(raised[0], NotAllowed):
        pytest.skip(str(raised[0]))
    if raised:
        raise raised[0]
    return calls


class NotAllowed(Exception):
    """The kernel does not let this process listen."""


def _listen(seccomp: int, watched: list[int]) -> int:
    """From here on the calling thread's ``watched`` calls wait for an answer at the descriptor that is returned."""
    libc = ctypes.CDLL(None, use_errno=True)
    program = [struct.pack("<HBBI", BPF_LOAD_WORD, 0, 0, 0)]  # the number of the call
    program += [
        struct.pack("<HBBI", BPF_JUMP_IF_EQUAL, len(watched) - k, 0, number) for k, number in enumerate(watched)
    ]
    program += [struct.pack("<HBBI", BPF_RETURN, 0, 0, what) for what in (SECCOMP_RET_ALLOW, SECCOMP_RET_USER_NOTIF)]
    code = ctypes.create_string_buffer(b"".join(program))
    filter_ = ctypes.create_string_buffer(struct.pack("<HxxxxxxQ", len(program), ctypes.addressof(code)))
    if libc.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0:
        raise NotAllowed(f"prctl: {os.strerror(ctypes.get_errno())}")
    descriptor = int(libc.syscall(seccomp, SECCOMP_SET_MODE_FILTER, SECCOMP_FILTER_FLAG_NEW_LISTENER, filter_))
    if descriptor < 0:
        raise NotAllowed(f"seccomp: {os.strerror(ctypes.get_errno())}")
    return descriptor


def _answered(listener: int, watched: dict[int, str]) -> Call:
    """The call that waits, read while it waits; then the kernel carries it out."""
    buffer = bytearray(NOTIFICATION.size)
    fcntl.ioctl(listener, SECCOMP_IOCTL_NOTIF_RECV, buffer)
    identity, _, _, number, _, _, *given = NOTIFICATION.unpack(buffer)
    match watched[number]:
        case "fsync" | "fdatasync" as name:
            call = Call(name, Path(f"/proc/self/fd/{given[0]}").readlink())
        case "rename":
            call = Call("rename", _path_at(given[0]), _path_at(given[1]))
        case _:
            call = Call("rename", _path_at(given[1]), _path_at(given[3]))
    fcntl.ioctl(listener, SECCOMP_IOCTL_NOTIF_SEND, ANSWER.pack(identity, 0, 0, SECCOMP_USER_NOTIF_FLAG_CONTINUE))
    return call


def _path_at(address: int) -> Path:
    return Path(os.fsdecode(ctypes.string_at(address)))


def seen_by_python(work: Callable[[], None]) -> list[Call]:
    """Run ``work`` and return what it asked of the ``os`` module, each call carried out."""
    calls: list[Call] = []
    fsync, fdatasync, rename, replace = os.fsync, os.fdatasync, os.rename, os.replace

    def noted_fsync(descriptor: int) -> None:
        calls.append(Call("fsync", Path(f"/proc/self/fd/{descriptor}").readlink()))
        fsync(descriptor)

    def noted_fdatasync(descriptor: int) -> None:
        calls.append(Call("fdatasync", Path(f"/proc/self/fd/{descriptor}").readlink()))
        fdatasync(descriptor)

    def noted_rename(source: Path, target: Path) -> None:
        calls.append(Call("rename", Path(source), Path(target)))
        rename(source, target)

    def noted_replace(source: Path, target: Path) -> None:
        calls.append(Call("rename", Path(source), Path(target)))
        replace(source, target)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", noted_fsync)
        patch.setattr(os, "fdatasync", noted_fdatasync)
        patch.setattr(os, "rename", noted_rename)
        patch.setattr(os, "replace", noted_replace)
        work()
    return calls
