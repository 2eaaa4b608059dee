"""A date is believed only where something from outside keeps the clock."""

from __future__ import annotations

import ctypes
import datetime
from typing import Any

import pytest

from drivers.wall_clock import KernelCalendar, set_from_outside


class Timex(ctypes.Structure):
    """``struct timex`` of 64-bit Linux, field by field as in adjtimex(2)."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        *((name, ctypes.c_long) for name in ("offset", "freq", "maxerror", "esterror")),
        ("status", ctypes.c_int),
        *((name, ctypes.c_long) for name in ("constant", "precision", "tolerance", "tv_sec", "tv_usec", "tick")),
        *((name, ctypes.c_long) for name in ("ppsfreq", "jitter")),
        ("shift", ctypes.c_int),
        *((name, ctypes.c_long) for name in ("stabil", "jitcnt", "calcnt", "errcnt", "stbcnt")),
        ("tai", ctypes.c_int),
        ("more", ctypes.c_int * 11),
    )


class Kernel:
    """Answers as the system's library does, and sees to it that it is only asked."""

    def __init__(self, state: int, status: int) -> None:
        self._state, self._status = state, status

    def adjtimex(self, buffer: Any) -> int:
        assert ctypes.sizeof(buffer) == ctypes.sizeof(Timex)
        timex = Timex.from_buffer(buffer)
        assert timex.modes == 0, "nothing may be set"
        timex.status = self._status
        return self._state


@pytest.mark.parametrize(
    ("state", "status", "kept"),
    [(0, 0x2001, True), (4, 0x0001, True), (5, 0x0041, False), (5, 0, False), (0, 0x0040, False), (-1, 0, False)],
)
def test_the_kernels_answer_is_read_where_the_kernel_writes_it(
    state: int, status: int, kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of adjtimex(2): TIME_ERROR is 5, STA_UNSYNC is 0x40."""
    monkeypatch.setattr(ctypes, "CDLL", lambda name: Kernel(state, status))
    assert set_from_outside() is kept
    assert KernelCalendar().today().kept is kept


@pytest.mark.parametrize("error", [OSError("no such library"), AttributeError("no such function")])
def test_where_nobody_can_be_asked_no_date_is_believed_and_the_date_is_in_utc(
    error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    def without(name: object) -> object:
        raise error

    monkeypatch.setattr(ctypes, "CDLL", without)
    today = KernelCalendar().today()
    assert today.kept is set_from_outside() is False
    assert today.utc.utcoffset() == datetime.timedelta(0)
    assert abs(today.utc - datetime.datetime.now(datetime.UTC)) < datetime.timedelta(hours=1)
