"""Owns a folder of views of a board while it is being filled: each view durable and whole, or not there.

board.json      which board, which instrument
01/left.png     a view; its folder gets its name when both pictures are on the disk
01/right.png
"""

from __future__ import annotations

import re
import shutil
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.base import ContentError, SealedFile
from appliance.calibrate.air.board import BoardDesign, parse_board
from appliance.store import LocalFileSystem, make_folders, move_folder, refused, replace_file, write_new

Image = NDArray[np.uint8]

SESSION = "board.json"
LEFT, RIGHT = "left.png", "right.png"


@dataclass(frozen=True, slots=True)
class _Begun:
    """Content of ``board.json``."""

    rig_serial: str
    board: str


BEGUN = SealedFile(
    _Begun, schema=1, max_bytes=64 * 1024, indent=1, checksum=False, check=lambda begun: parse_board(begun.board),
    remedy="restore it, or remove it and give --board",
)  # fmt: skip


class ViewFolder:
    """A folder for views of one board by one instrument."""

    def __init__(self, folder: Path, rig_serial: str, design: BoardDesign | None) -> None:
        """Make the folder, or go on with one. ``design`` ``None``: the folder's, else the usual board.

        Raises ContentError for a folder of another board or instrument, StorageError.
        """
        self.folder = folder
        self._fs = LocalFileSystem()
        make_folders(self._fs, folder)
        begun = read_session(folder)
        if begun is None:
            self.design = design or BoardDesign()
            replace_file(self._fs, folder / SESSION, BEGUN.encode(_Begun(rig_serial, str(self.design))))
        else:
            serial, self.design = begun
            if serial != rig_serial:
                raise ContentError(
                    f"FOLDER {folder}", f"views of instrument {serial}; this one is {rig_serial}", remedy="give another"
                )
            if design is not None and design != self.design:
                raise ContentError(
                    f"FOLDER {folder}", f"views of board {self.design}, not {design}", remedy="give another folder"
                )
        self._tidy()

    def next_name(self) -> str:
        """Return the number of the next view: numbers only grow."""
        # The number after the largest, not the first free one: a view that somebody took away must not come back as
        # another.
        numbers = [int(path.name) for path in self.folder.iterdir() if re.fullmatch(r"\d{2,6}", path.name)]
        return f"{max(numbers, default=0) + 1:02}"

    def save(self, name: str, left: Image, right: Image) -> None:
        """Write a view; durable on return. Raises StorageError, and nothing of it is then there under ``name``."""
        # Both pictures in a hidden folder first: a folder with a number has them both.
        draft = self.folder / f".{name}"
        with refused("cannot make", draft):
            self._fs.make_folder(draft)
        for file, image in ((LEFT, left), (RIGHT, right)):
            done, data = cv2.imencode(".png", image)
            if not done:
                raise ValueError(f"a picture of {image.shape} could not be encoded as PNG")
            write_new(self._fs, draft / file, [bytes(data)])
        move_folder(self._fs, draft, self.folder / name)

    def _tidy(self) -> None:
        """Take away what a loss of power left of a view that was never there."""
        for path in self.folder.iterdir():
            if re.fullmatch(r"\.\d{2,6}", path.name) and path.is_dir():
                with refused("cannot remove the unfinished", path):
                    shutil.rmtree(path)


def read_session(folder: Path) -> tuple[str, BoardDesign] | None:
    """Return instrument and board of a folder that ``--live`` filled; ``None`` for any other. Raises ContentError."""
    path = folder / SESSION
    begun = BEGUN.load(path, name=str(path))
    return None if begun is None else (begun.rig_serial, parse_board(begun.board))
