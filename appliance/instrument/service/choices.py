"""Owns what the diver chose, as it is remembered on the disk over a restart: one small checksummed file.

    <root>/choices.json

Only what differs from the rig file is written, so that a corrected rig file still counts for the rest.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from appliance.base import Among, ContentError, SealedFile, Within, shaped
from appliance.instrument.machine.choices import COLDEST_C, LANGUAGES, WARMEST_C, Choices
from appliance.measure import PERIODS_PX, Exposure, Fault, FaultCode
from appliance.store import FileSystem, LocalFileSystem

log = logging.getLogger("kingfisher")

FILE = "choices.json"
MOST_OBJECTS = 999_999
"""Largest number of an object that is believed."""


@dataclass(frozen=True, slots=True)
class _Chosen:
    """All that is remembered."""

    exposure_us: Annotated[int, Within(50, 16_600)]
    gain_db: Annotated[float, Within(0.0, 48.0)]
    period_px: Annotated[int, Among(PERIODS_PX)]
    salinity_psu: Annotated[float, Within(0.0, 45.0)]
    water_c: Annotated[float, Within(COLDEST_C, WARMEST_C)]
    language: Annotated[str, Among(LANGUAGES)]
    object: Annotated[int, Within(1, MOST_OBJECTS, whole=True)] | None
    objects: Annotated[int, Within(0, MOST_OBJECTS, whole=True)]


@dataclass(frozen=True, slots=True)
class _Differing:
    """Content of the file: what differs from the rig file."""

    chosen: Mapping[str, Any]


CHOICES = SealedFile(_Differing, schema=1, max_bytes=10_000)


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
            found = CHOICES.load(self.path, name="")
            if found is None:
                return self._standard, None
            chosen = shaped(_Chosen, {**asdict(_spelled(self._standard)), **found.chosen})
            if chosen.object is not None and chosen.object > chosen.objects:
                raise ContentError("", f"object is {chosen.object}", f"1..{chosen.objects}, the largest number of one")
        except ContentError as error:
            log.warning("%s: %s; the rig file's values hold until something is chosen anew", self.path, error)
            return self._standard, Fault(FaultCode.SETTINGS_LOST, f"{self.path.name}: {error}")
        known = {name: value for name, value in asdict(chosen).items() if name not in ("exposure_us", "gain_db")}
        return replace(self._standard, exposure=Exposure(chosen.exposure_us, chosen.gain_db), **known), None

    def write(self, choices: Choices) -> None:
        """Write it all down; it is durable on return. Raises StorageError."""
        standard, chosen = asdict(_spelled(self._standard)), asdict(_spelled(choices))
        content = {name: value for name, value in chosen.items() if value != standard[name]}
        self._fs.replace_file(self.path, CHOICES.encode(_Differing(content)))


def _spelled(choices: Choices) -> _Chosen:
    return _Chosen(
        choices.exposure.time_us,
        choices.exposure.gain_db,
        choices.period_px,
        choices.salinity_psu,
        choices.water_c,
        choices.language,
        choices.object,
        choices.objects,
    )
