"""Owns the folder of a guided bring-up: its state, its page, and the pictures of its steps."""

from __future__ import annotations

import hashlib
from pathlib import Path

from appliance.bringup.finding import BringupError
from appliance.bringup.guide import StepOutcome
from appliance.bringup.guide_page import PAGE, guide_page
from appliance.bringup.guide_state import STATE, GuideState, read_state
from appliance.storage.atomic import make_folders, refused, replace_file
from appliance.storage.filesystem import LocalFileSystem

MOST_BYTES = 16_000_000
"""Length of a state that is read: what is longer is no state."""


class GuideFolder:
    """Reads and writes the folder. Every file is replaced whole, so that a cut-off call leaves the old one or the new one."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._fs = LocalFileSystem()

    def prepare(self) -> None:
        """Make the folder if it is not there. Raises StorageError."""
        make_folders(self._fs, self.folder)

    def read(self) -> GuideState:
        """Return the state; an empty one where there is none. Raises BringupError for a damaged one, StorageError."""
        path = self.folder / STATE
        if not path.exists():
            return GuideState()
        with refused("cannot read", path), path.open("rb") as file:
            data = file.read(MOST_BYTES + 1)
        # One byte more than allowed was read: so it is known without reading it all.
        if len(data) > MOST_BYTES:
            raise BringupError(f"{path}: is no state of a bring-up ({len(data)} bytes); move it away to begin anew")
        return read_state(data, str(path))

    def write(self, state: GuideState, rig_text: str) -> list[Path]:
        """Write state and page, the state first: it is what the next call goes by. Returns both. Raises StorageError."""
        replace_file(self._fs, self.folder / STATE, state.as_bytes())
        replace_file(self._fs, self.folder / PAGE, guide_page(state, rig_text, self._pictures(state)).encode())
        return [self.folder / STATE, self.folder / PAGE]

    def keep(self, outcome: StepOutcome) -> list[Path]:
        """Write the pictures of a step, before the state that names them, and return them. Raises StorageError."""
        for name, (_, png) in outcome.pictures.items():
            replace_file(self._fs, self.folder / name, png)
        return [self.folder / name for name in outcome.pictures]

    def _pictures(self, state: GuideState) -> dict[str, bytes]:
        """Return the pictures that the state names; one that somebody took away is left out."""
        found = {}
        for record in state.steps.values():
            # A name as the state has it leads nowhere but into this folder.
            for name in (one for one in record.pictures if Path(one).name == one):
                path = self.folder / name
                if path.is_file():
                    with refused("cannot read", path):
                        found[name] = path.read_bytes()
        return found


def checksum(text: str) -> str:
    """Return the checksum of a rig file's text."""
    return hashlib.sha256(text.encode()).hexdigest()
