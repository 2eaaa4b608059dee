"""Owns the service's side of the transfer of scans to a desk: it switches the server on, and reads the server's status.

    /run/kingfisher/transfer-on                  flag file: the transfer is wanted; written here
    /run/kingfisher-transfer/status.json         status of the server; written by ``systemd/kingfisher_transfer``

The service may not start other programs. A systemd unit waits for the flag file and starts the server. Where the
process has no ``RUNTIME_DIRECTORY`` (at a desk), there are no such files: switching does nothing.
"""

from __future__ import annotations

import ipaddress
import json
import logging
from collections.abc import Mapping
from pathlib import Path

from appliance.instrument.machine import events as on
from appliance.instrument.machine.states import TRANSFER_UNKNOWN, Serving, Transfer

log = logging.getLogger("kingfisher")

NOTE, STATUS = "transfer-on", Path("kingfisher-transfer", "status.json")
MAX_BYTES = 65_536
LOOK_NS = 1_000_000_000
"""Time between two looks at what is told."""
LONGEST = 26
"""Greatest length of an address in characters that is shown: a longer one would be cut, and half of one is of no use.

An instrument with a cable always has a short one.
"""
MOST_KEYS = 1000
"""Largest number of keys that is believed."""


class TransferSwitch:
    """The switch, and the latest word of the program that serves. One thread."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        """``environment``: that of the process, with the folder of notes in ``RUNTIME_DIRECTORY``; without it, all this
        is nothing."""
        folder = environment.get("RUNTIME_DIRECTORY")
        notes = None if not folder else Path(folder.split(":")[0])
        self._note = None if notes is None else notes / NOTE
        self._status = None if notes is None else notes.parent / STATUS
        self._next_ns: int | None = None
        self._told: Transfer | None = None

    @property
    def wanted(self) -> bool:
        """True if the note is there: also one of a run of this service that ended since power-on."""
        return self._note is not None and self._note.exists()

    def switch(self, to_on: bool) -> None:
        """Leave the note, or take it away."""
        if self._note is None:
            return
        try:
            if to_on:
                self._note.touch()
            else:
                self._note.unlink(missing_ok=True)
        except OSError as error:
            log.warning("the transfer cannot be switched: %s: %s", self._note, error.strerror or error)

    def poll(self, now_ns: int, *, wanted: bool) -> list[on.Event]:
        """Return it where something new is known; looks once a second, and only while it is ``wanted``."""
        if not wanted:
            self._told = self._next_ns = None
            return []
        if self._next_ns is not None and now_ns < self._next_ns:
            return []
        self._next_ns = now_ns + LOOK_NS
        told = Transfer(Serving.FAILED) if self._status is None else read_status(self._status)
        if told == self._told:
            return []
        self._told = told
        return [told]


def read_status(path: Path) -> Transfer:
    """Return what is told in a file; ``NOT_TOLD`` for none, and for one that cannot be understood."""
    try:
        with path.open("rb") as file:
            content = json.loads(file.read(MAX_BYTES))
        addresses = [str(ipaddress.ip_address(one)) for one in content["addresses"]]
        keys = content["keys"]
        if keys is not None and (isinstance(keys, bool) or not isinstance(keys, int) or not 0 <= keys <= MOST_KEYS):
            raise ValueError(f"{keys!r:.40} keys")
        shown = next((one for one in addresses if len(one) <= LONGEST), None)
        return Transfer(Serving(content["state"]), shown, keys)
    except FileNotFoundError:
        return TRANSFER_UNKNOWN
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        log.warning("%s: %s; what it tells is not shown", path, error)
        return TRANSFER_UNKNOWN
