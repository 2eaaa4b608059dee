"""The instrument's date, and whether it is reliable, which the kernel knows."""

from __future__ import annotations

import ctypes
import datetime
import logging
import struct
from dataclasses import dataclass

log = logging.getLogger("kingfisher")

STATUS_OFFSET, TIMEX_BYTES = 40, 208
"""Layout of ``struct timex`` on 64-bit Linux (adjtimex(2)): modes, then offset, freq, maxerror, esterror (8 bytes
each), status."""
STA_UNSYNC = 0x0040
TIME_ERROR = 5
"""Value that adjtimex returns while no source keeps the clock."""


@dataclass(frozen=True, slots=True)
class KernelDate:
    """``drivers.api.Date``: the time of CLOCK_REALTIME, and whether an external source keeps it."""

    utc: datetime.datetime
    kept: bool


class KernelCalendar:
    """``drivers.api.Calendar`` over CLOCK_REALTIME."""

    def today(self) -> KernelDate:
        """Return the date in UTC."""
        return KernelDate(datetime.datetime.now(datetime.UTC), set_from_outside())


def set_from_outside() -> bool:
    """Return True if a time server or the like keeps the clock.

    Under water there is none: a date of the battery's clock alone, or of 1970, is stored and marked. Numbers of scans
    do not depend on it.
    """
    timex = ctypes.create_string_buffer(TIMEX_BYTES)  # modes 0: only asks
    try:
        state = ctypes.CDLL(None).adjtimex(timex)
    except (OSError, AttributeError) as error:
        log.warning("it is not known whether the clock is synchronised: %s", error)
        return False
    return is_reliable(state, struct.unpack_from("=i", timex.raw, STATUS_OFFSET)[0])


def is_reliable(state: int, status: int) -> bool:
    """Interpret adjtimex's answer: return True if the clock is reliable."""
    return 0 <= state != TIME_ERROR and not status & STA_UNSYNC
