"""The folder of a guided bring-up: records of its steps, their inputs, the page, and its pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from appliance.base import ContentError, SealedFile
from appliance.store import LocalFileSystem, StorageError
from appliance.workshop.finding import BringupError, Finding
from appliance.workshop.step import StepOutcome

STATE, PAGE = "bringup.json", "bringup.html"


@dataclass(frozen=True, slots=True)
class StepRecord:
    """The record of one finished step."""

    good: bool
    when: str
    """Date and time, ISO 8601, by the computer's calendar: for people only."""
    duration_s: float
    findings: tuple[Finding, ...]
    inputs: Mapping[str, Any]
    """Keys of the rig file that it rests on, by dotted name."""
    written: Mapping[str, Any] = field(default_factory=dict)
    """Keys that it wrote into the rig file, by dotted name."""
    tables: Mapping[str, tuple[Mapping[str, Any], ...]] = field(default_factory=dict)
    pictures: Mapping[str, str] = field(default_factory=dict)
    """Captions of its pictures, by the name of the file beside the state."""

    @classmethod
    def of(cls, outcome: StepOutcome, when: str, duration_s: float, inputs: Mapping[str, Any]) -> StepRecord:
        """Return the record of an outcome."""
        pictures = {name: caption for name, (caption, _) in outcome.pictures.items()}
        written = {".".join(place): value for place, value in outcome.keys.items()}
        findings, duration_s = outcome.findings, round(duration_s, 3)
        return cls(outcome.good, when, duration_s, findings, inputs, written, outcome.tables, pictures)


@dataclass(frozen=True, slots=True)
class GuideState:
    """The state of the guide that is stored."""

    rig_file: str
    rig_sha256: str
    """Checksum of the rig file as it was after the last step."""
    about: Mapping[str, tuple[str, ...]]
    """Versions, and the devices on the buses at the last call: lines by title."""
    steps: Mapping[str, StepRecord]


NOTHING_YET = GuideState("", "", {}, {})
STATE_FILE = SealedFile(
    GuideState,
    schema=1,
    max_bytes=16_000_000,
    remedy="move it away to begin anew, or give another folder with --out",
    indent=1,
    checksum=False,
)


class GuideFolder:
    """Reads and writes the folder.

    Every file is replaced atomically, so that an interrupted call leaves the old one or the new one.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._fs = LocalFileSystem()

    def prepare(self) -> None:
        """Make the folder if it is not there. Raises StorageError."""
        self._fs.make_folders(self.folder)

    def read(self) -> GuideState:
        """Return the state, or an empty one if there is none. Raises BringupError for one that cannot be read."""
        try:
            return STATE_FILE.load(self.folder / STATE) or NOTHING_YET
        except ContentError as error:
            raise BringupError(str(error)) from error

    def write(self, files: Mapping[str, bytes]) -> Sequence[Path]:
        """Write files in their order, by name, and return them. Raises StorageError."""
        for name, data in files.items():
            self._fs.replace_file(self.folder / name, data)
        return [self.folder / name for name in files]

    def pictures(self, state: GuideState) -> dict[str, bytes]:
        """Return the pictures that the state names; missing ones are left out. Raises StorageError."""
        contents = {}
        for record in state.steps.values():
            # Only plain names, which do not lead out of this folder.
            for file_name in (file for file in record.pictures if Path(file).name == file):
                path = self.folder / file_name
                if path.is_file():
                    with StorageError.naming("cannot read", path):
                        contents[file_name] = path.read_bytes()
        return contents
