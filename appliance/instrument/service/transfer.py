"""The service's side of the scan transfer: it switches the server on, and reads the server's status.

    /run/kingfisher/transfer-on                  flag file: the transfer is switched on; written here
    /run/kingfisher-transfer/status.json         status of the server; written by ``systemd/kingfisher_transfer``

The service may not start other programs. A systemd unit waits for the flag file and starts the server. If the process
has no ``RUNTIME_DIRECTORY`` (at a desk), there are no such files: switching has no effect.
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

FLAG_FILE, STATUS = "transfer-on", Path("kingfisher-transfer", "status.json")
MAX_BYTES = 65_536
LOOK_NS = 1_000_000_000
"""Time between two readings of the status."""
LONGEST = 26
"""Largest number of characters of an address that fits on the screen.

An instrument with a cable always has a short one.
"""
MOST_KEYS = 1000
"""Largest number of keys that is accepted."""


class TransferSwitch:
    """The switch of the scan transfer, and the latest status of its server. One thread."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        """Find the files by the process's ``environment``.

        Its ``RUNTIME_DIRECTORY`` is the folder of the flag file; without it, the switch has no effect.
        """
        folder = environment.get("RUNTIME_DIRECTORY")
        notes = None if not folder else Path(folder.split(":")[0])
        self._note = None if notes is None else notes / FLAG_FILE
        self._status = None if notes is None else notes.parent / STATUS
        self._next_ns: int | None = None
        self._latest: Transfer | None = None

    @property
    def is_on(self) -> bool:
        """True if the flag file exists, also from an earlier run of the service since power-on."""
        return self._note is not None and self._note.exists()

    def switch(self, to_on: bool) -> None:
        """Create or remove the flag file."""
        if self._note is None:
            return
        try:
            if to_on:
                self._note.touch()
            else:
                self._note.unlink(missing_ok=True)
        except OSError as error:
            log.warning("the transfer cannot be switched: %s: %s", self._note, error.strerror or error)

    def poll(self, now_ns: int, *, is_on: bool) -> list[on.Event]:
        """Return the status if it has changed; reads once a second, and only while switched on."""
        if not is_on:
            self._latest = self._next_ns = None
            return []
        if self._next_ns is not None and now_ns < self._next_ns:
            return []
        self._next_ns = now_ns + LOOK_NS
        latest = Transfer(Serving.FAILED) if self._status is None else read_status(self._status)
        if latest == self._latest:
            return []
        self._latest = latest
        return [latest]


def read_status(path: Path) -> Transfer:
    """Return the status in a file; ``TRANSFER_UNKNOWN`` if it is missing or cannot be understood."""
    try:
        with path.open("rb") as file:
            content = json.loads(file.read(MAX_BYTES))
        addresses = [str(ipaddress.ip_address(address)) for address in content["addresses"]]
        keys = content["keys"]
        if keys is not None and (isinstance(keys, bool) or not isinstance(keys, int) or not 0 <= keys <= MOST_KEYS):
            raise ValueError(f"{keys!r:.40} keys")
        shown = next((address for address in addresses if len(address) <= LONGEST), None)
        return Transfer(Serving(content["state"]), shown, keys)
    except FileNotFoundError:
        return TRANSFER_UNKNOWN
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        log.warning("%s: %s; its content is not shown", path, error)
        return TRANSFER_UNKNOWN
