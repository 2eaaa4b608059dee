"""Owns ``<root>/calibration``: the file in use, those of before, and the session of the calibration under way.

    current.json                in use
    air.json                    of the calibration in air, with covariance, where there is one
    beams.json                  what the laser dots have taught, for the calibration in use (``appliance.instrument.service.remembered``)
    kept/0001-2026-11-21.json   what was in use before, byte for byte; numbers only grow, the date may be wrong
    session/session.json        which scans the steps recorded, and what came of them
    session/solved.json         the calibration that was solved from them, and report.html and .json about it
    sessions/0001/              sessions put away, the oldest first

Whether the solved calibration is in use is not written down: the files say so, also after a loss of power between two
of them. Nothing in here deletes anything. One process writes, from one thread at a time.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from appliance.base import ContentError, SealedFile
from appliance.calibrate.guide import Session
from appliance.measure import Calibration, CalibrationError, encode_calibration
from appliance.store import (
    AIR_FILE,
    CALIBRATION_FILE,
    FileSystem,
    LocalFileSystem,
    StorageError,
    is_kept_calibration,
    load_calibration,
)

SOLVED, SESSION = "solved.json", "session.json"
SESSIONS = SealedFile(Session, schema=1, max_bytes=1024 * 1024)


class SessionError(Exception):
    """A request does not go with the session as it is; the text says why and what to do."""


class Calibrations:
    """The calibrations of one instrument. Raises StorageError for whatever the disk refuses."""

    def __init__(self, root: Path, rig_serial: str, fs: FileSystem | None = None) -> None:
        """Remember where to store; nothing is touched until a method is called."""
        self.folder = (root / CALIBRATION_FILE).parent
        self._of: Mapping[str, str] = {"rig_serial": rig_serial}
        self._fs: FileSystem = fs or LocalFileSystem()

    @property
    def current(self) -> Path:
        """The file in use."""
        return self.folder / CALIBRATION_FILE.name

    @property
    def air(self) -> Path:
        """The calibration in air, from which every adjustment in water starts; there may be none."""
        return self.folder / AIR_FILE.name

    @property
    def solved(self) -> Path:
        """The calibration that the session's recordings gave."""
        return self.folder / "session" / SOLVED

    @property
    def in_use(self) -> str | None:
        """Hash of the calibration in use; ``None`` where the drawing is."""
        return _hash_of(self.current)

    # ------------------------------------------------------------------------------------- reading

    def session(self) -> Session:
        """Return the session as it lies on the disk; a new one where there is none of this instrument that can be
        read.

        A damaged one stays where it is until the next is begun or written.
        """
        session = self._read()
        solved = _hash_of(self.solved)
        if session.solved is not None and session.solved.calibration_hash != solved:
            session = replace(session, solved=None, verified=None)  # power was lost between the two files
        # Compared, not remembered: a flag could be lost between the two files, and would be wrong after a file was
        # copied in by hand.
        in_use = session.solved is not None and _bytes(self.current) == _bytes(self.solved)
        named = session.kept is not None and is_kept_calibration(session.kept)
        checked = session.verified
        if checked is not None and not in_use and checked.checked != self.in_use:
            # Another calibration was put in use since: what is known of the one of then says nothing.
            session = replace(session, verified=None if checked.after is None else replace(checked, before=None))
        kept = session.kept if named and (self.folder / "kept" / str(session.kept)).is_file() else None
        return replace(session, in_use=in_use, kept=kept)

    def _read(self) -> Session:
        try:
            return SESSIONS.load(self.folder / "session" / SESSION, self._of) or Session()
        except ContentError:
            return Session()

    def kept(self, session: Session) -> Calibration | None:
        """Return the calibration that was in use before; ``None`` where none is kept that can be read."""
        if session.kept is None:
            return None
        try:
            return load_calibration(self.folder / "kept" / session.kept)
        except CalibrationError:
            return None

    # ------------------------------------------------------------------------------------- writing

    def write(self, session: Session) -> Session:
        """Make the session durable; answers it as it lies on the disk now."""
        self._fs.make_folders(self.folder / "session")
        kept = replace(session, in_use=False)  # never written down
        self._fs.replace_file(self.folder / "session" / SESSION, SESSIONS.encode(kept, self._of))
        return self.session()

    def write_solved(
        self, calibration: Calibration, session: Session, report: Mapping[str, bytes] = MappingProxyType({})
    ) -> Session:
        """Make a solved calibration durable with its ``report``'s files (by name), then the session that speaks of it."""
        self._fs.make_folders(self.folder / "session")
        for name, data in report.items():
            self._fs.replace_file(self.folder / "session" / name, data)
        # The session comes last: until it speaks of them, these files mean nothing, whenever the power goes.
        self._fs.replace_file(self.solved, encode_calibration(calibration))
        return self.write(session)

    def use_solved(self, date: str) -> Session:
        """Put the solved calibration in use; the file of before is kept first, under ``date`` (ISO 8601, a day).

        Raises SessionError.
        """
        session = self.session()
        data = _bytes(self.solved)
        if session.solved is None or data is None:
            raise SessionError("nothing is solved; solve first")
        if session.in_use:
            return session
        before = _bytes(self.current)
        if before is not None:
            # Kept, and named, before it is replaced: after a loss of power at any point there is a way back (ADR 0020).
            session = self.write(replace(session, kept=self._keep(before, date)))
        self._fs.make_folders(self.folder)
        self._fs.replace_file(self.current, data)
        return self.session()

    def restore(self) -> Session:
        """Put the kept file in use again, byte for byte. Raises SessionError, CalibrationError if it is damaged."""
        session = self.session()
        if session.kept is None:
            raise SessionError("no calibration of before is kept; calibrate")
        path = self.folder / "kept" / session.kept
        load_calibration(path)
        data = _bytes(path)
        if data is None:
            raise SessionError(f"{path} cannot be read; copy the instrument's calibration to {self.current}")
        self._fs.replace_file(self.current, data)
        return self.session()

    def install(self, calibration: Calibration, date: str) -> Path | None:
        """Put a calibration in use that no session made; answers where the file of before is kept, if there was one."""
        before = _bytes(self.current)
        kept = None if before is None else self._keep(before, date)
        self._fs.make_folders(self.folder)
        self._fs.replace_file(self.current, encode_calibration(calibration))
        return None if kept is None else self.folder / "kept" / kept

    def bring_back(self, name: str | None, date: str) -> Path:
        """Put a kept file in use again, byte for byte: ``name``, or the last one kept that is not in use.

        What was in use is kept, so that doing it twice changes nothing. Raises SessionError, CalibrationError for a
        file that is damaged.
        """
        now = _bytes(self.current)
        files = sorted((self.folder / "kept").glob("*.json"), key=lambda path: (_leading(path.name), path.name))
        others = [path for path in files if (path.name == name if name is not None else _bytes(path) != now)]
        if not others:
            there = ", ".join(path.name for path in files) or "none"
            what = "no other calibration is kept" if name is None else f"no calibration {name} is kept"
            raise SessionError(f"{what} in {self.folder / 'kept'} (there: {there}); calibrate, or give one of these")
        path = others[-1]
        load_calibration(path)
        data = path.read_bytes()
        # What is in use now may be kept nowhere yet, as where somebody copied it in.
        if now is not None:
            self._keep(now, date)
        self._fs.replace_file(self.current, data)
        return path

    def begin(self) -> Session:
        """Put the session away and begin a new one."""
        folder = self.folder / "session"
        if folder.is_dir():
            self._fs.make_folders(self.folder / "sessions")
            self._fs.move_folder(folder, self.folder / "sessions" / f"{_next(self.folder / 'sessions'):04d}")
        return self.session()

    def _keep(self, data: bytes, date: str) -> str:
        """Name of the kept file with these bytes, which is written where there is none."""
        folder = self.folder / "kept"
        self._fs.make_folders(folder)
        for path in sorted(folder.glob("*.json")):
            if _bytes(path) == data:
                return path.name
        path = folder / f"{_next(folder):04d}-{date}.json"
        self._fs.replace_file(path, data)
        return path.name


def _next(folder: Path) -> int:
    """Return the number after the largest in a folder."""
    try:
        found = [_leading(path.name) for path in folder.iterdir()]
    except OSError as error:
        raise StorageError.of("cannot list", folder, error) from error
    return max(found, default=0) + 1


def _leading(name: str) -> int:
    """Return the number that a name begins with; 0 where it begins with none."""
    found = re.match(r"\d{1,9}", name)
    return 0 if found is None else int(found[0])


def _bytes(path: Path) -> bytes | None:
    try:
        return path.read_bytes()
    except OSError:
        return None


def _hash_of(path: Path) -> str | None:
    try:
        return load_calibration(path).hash
    except CalibrationError:
        return None
