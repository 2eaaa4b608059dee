"""Owns how the worker's process keeps its own memory small, and what it may take at most."""

from __future__ import annotations

import ctypes
import re
import resource
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

M_ARENA_MAX = -8
"""glibc's number of that option (malloc.h)."""
MADV_DONTNEED = 4
"""Linux's number of that advice (madvise(2)): of a private mapping of a file, what was not written to is read from the file again."""
COMPILER = "libllvmlite.so"
_PART = re.compile(r"(?P<first>[0-9a-f]+)-(?P<stop>[0-9a-f]+) (?P<may>\S{4}) \S+ \S+ \d+ *(?P<file>/.*)?$")


def share_freed_memory() -> None:
    """Let all threads of this process take memory from one heap, so that what one of them has freed serves the other.

    glibc gives each thread a heap of its own, which keeps 10 MB and more of what judges needed in passing. Elsewhere than with glibc nothing
    happens.
    """
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).mallopt(M_ARENA_MAX, 1)


def give_back_memory() -> None:
    """Give pages that were needed to make tables and to load kernels, and that nothing lies in any more, back to the machine.

    glibc keeps what was freed between two things that stay: 40 MB after the start. Of the compiler's library 65 MB were read to load kernels that
    were compiled before; nobody reads them again. Elsewhere than with glibc and Linux nothing happens.
    """
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).malloc_trim(0)
    with suppress(AttributeError, OSError):
        _forget_pages(COMPILER)


def _forget_pages(library: str) -> None:
    """Take the pages of a library out of this process that nobody has written to. Whoever reads one gets it again from the file."""
    advise = ctypes.CDLL(None, use_errno=True).madvise
    advise.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
    for first, stop in unwritten(Path("/proc/self/smaps").read_text(encoding="utf-8", errors="replace"), library):
        advise(first, stop - first, MADV_DONTNEED)


def unwritten(smaps: str, library: str) -> Iterator[tuple[int, int]]:
    """Yield first and last address of each part of a file of that name, as proc(5) lists them, that is as the file has it."""
    # A page that the loader has written an address into would come back without it.
    part: re.Match[str] | None = None
    for line in smaps.splitlines():
        part = _PART.match(line) or part
        if part is None or (part["file"] or "").rpartition("/")[2] != library or "w" in part["may"]:
            continue
        if line.split() == ["Anonymous:", "0", "kB"]:
            yield int(part["first"], 16), int(part["stop"], 16)


def limit_memory(headroom_mb: float) -> None:
    """Let the kernel refuse private memory beyond what this process has now; what it shares with others does not count.

    Faster than the parent's own measure: an allocation out of proportion fails here, before the machine runs out.
    """
    status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    held = next((int(line.split()[1]) * 1024 for line in status.splitlines() if line.startswith("VmData:")), None)
    if held is None:
        return
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    wanted = held + int(headroom_mb * 1e6)
    if hard == resource.RLIM_INFINITY or wanted < hard:
        resource.setrlimit(resource.RLIMIT_DATA, (wanted, hard))
