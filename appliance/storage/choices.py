"""Owns what the diver chose, as it is remembered on the disk over a restart: one small checksummed file.

    <root>/choices.json

Only what differs from the rig file is written, so that a corrected rig file still counts for the rest.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

from appliance.checksummed_file import checked_content, with_checksum
from appliance.machine.choices import COLDEST_C, LANGUAGES, WARMEST_C, Choices
from appliance.patterns.sequence import PERIODS_PX
from appliance.scan.exposure import Exposure
from appliance.scan.fault import Fault, FaultCode
from appliance.storage.atomic import replace_file
from appliance.storage.filesystem import FileSystem, LocalFileSystem

log = logging.getLogger("kingfisher")

FILE = "choices.json"
SCHEMA = 1
MAX_BYTES = 10_000
_RANGES: dict[str, tuple[float, float]] = {
    "exposure_us": (50, 16_600),
    "gain_db": (0.0, 48.0),
    "salinity_psu": (0.0, 45.0),
    "water_c": (COLDEST_C, WARMEST_C),
}
MOST_OBJECTS = 999_999
"""Largest number of an object that is believed."""


class ChoicesFile:
    """The memory of one instrument. One thread at a time."""

    def __init__(self, root: Path, standard: Choices, fs: FileSystem | None = None) -> None:
        """Remember where to store; ``standard`` is what the rig file states."""
        self.path = root / FILE
        self._standard = standard
        self._fs: FileSystem = fs or LocalFileSystem()

    def read(self) -> tuple[Choices, Fault | None]:
        """Read the diver's choices; the rig file's values, with a condition, where the file cannot be used."""
        try:
            with self.path.open("rb") as file:
                data = file.read(MAX_BYTES + 1)
        except FileNotFoundError:
            return self._standard, None
        except OSError as error:
            return self._lost(error.strerror or str(error))
        try:
            return self._decoded(data), None
        except ValueError as error:
            return self._lost(str(error))

    def write(self, choices: Choices) -> None:
        """Write it all down; it is durable on return. Raises StorageError."""
        standard, chosen = _spelled(self._standard), _spelled(choices)
        content = {name: value for name, value in chosen.items() if value != standard[name]}
        replace_file(self._fs, self.path, with_checksum({"schema": SCHEMA, "chosen": content}))

    def _lost(self, why: str) -> tuple[Choices, Fault]:
        log.warning("%s: %s; the rig file's values hold until something is chosen anew", self.path, why)
        return self._standard, Fault(FaultCode.SETTINGS_LOST, f"{self.path.name}: {why}")

    def _decoded(self, data: bytes) -> Choices:
        """Raises ValueError."""
        content = checked_content(data, MAX_BYTES)
        chosen = content.get("chosen")
        if content.get("schema") != SCHEMA or not isinstance(chosen, dict):
            raise ValueError(f"schema {content.get('schema')!r}; {SCHEMA} is known here")
        values = {**_spelled(self._standard), **chosen}
        for name, (low, high) in _RANGES.items():
            value = values[name]
            if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
                raise ValueError(f"{name} {value!r}; allowed are {low:g}..{high:g}")
        if values["period_px"] not in PERIODS_PX or values["language"] not in LANGUAGES:
            raise ValueError(
                f"period_px {values['period_px']!r}, language {values['language']!r}; they are not offered"
            )
        number, numbers = values["object"], values["objects"]
        whole = all(
            isinstance(one, int) and not isinstance(one, bool) for one in (numbers, 0 if number is None else number)
        )
        if not whole or not 0 <= numbers <= MOST_OBJECTS or (number is not None and not 1 <= number <= numbers):
            raise ValueError(
                f"object {number!r} of objects {numbers!r}; allowed are 1..{MOST_OBJECTS}, and none above the second"
            )
        return replace(
            self._standard,
            exposure=Exposure(int(values["exposure_us"]), float(values["gain_db"])),
            period_px=int(values["period_px"]),
            salinity_psu=float(values["salinity_psu"]),
            water_c=float(values["water_c"]),
            language=str(values["language"]),
            object=number,
            objects=numbers,
        )


def _spelled(choices: Choices) -> dict[str, Any]:
    return {
        "exposure_us": choices.exposure.time_us,
        "gain_db": choices.exposure.gain_db,
        "period_px": choices.period_px,
        "salinity_psu": choices.salinity_psu,
        "water_c": choices.water_c,
        "language": choices.language,
        "object": choices.object,
        "objects": choices.objects,
    }
