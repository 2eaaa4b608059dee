"""Files below ``<root>/calibration``: the calibration in use, earlier ones, and the running session.

    current.json                the calibration in use
    air.json                    the air calibration with covariance, where there is one
    beams.json                  laser pointers, learnt with the one in use (``instrument.service.remembered``)
    kept/0001-2026-11-21.json   an earlier calibration, byte for byte; numbers only grow, the date may be wrong
    session/session.json        the scans of each step, and how they were judged
    session/solved.json         the calibration solved from them; report.html and report.json belong to it
    sessions/0001/              earlier sessions, the oldest first

Whether the solved calibration is in use follows from a comparison of the files, so that it is right after a loss of
power between two writes. No method deletes a file. Only one process writes, from one thread at a time.
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
    """Error of a request that does not fit the state of the session; the text says why and the remedy."""


class Calibrations:
    """The calibration files of one instrument. Methods raise StorageError for errors of the disk."""

    def __init__(self, root: Path, rig_serial: str, fs: FileSystem | None = None) -> None:
        """Prepare the paths; no file is touched before a method is called."""
        self.folder = (root / CALIBRATION_FILE).parent
        self._of: Mapping[str, str] = {"rig_serial": rig_serial}
        self._fs: FileSystem = fs or LocalFileSystem()

    @property
    def current(self) -> Path:
        """Path of the calibration in use."""
        return self.folder / CALIBRATION_FILE.name

    @property
    def air(self) -> Path:
        """Path of the air calibration, from which every adjustment in water starts; the file may be missing."""
        return self.folder / AIR_FILE.name

    @property
    def solved(self) -> Path:
        """Path of the calibration that was solved from the session's recordings."""
        return self.folder / "session" / SOLVED

    @property
    def in_use(self) -> str | None:
        """Hash of the calibration in use; ``None`` where the nominal one is."""
        return _hash_of(self.current)

    # ------------------------------------------------------------------------------------- reading

    def session(self) -> Session:
        """Return the stored session; a new one where none of this instrument can be read.

        A damaged file stays until the next session is begun or written.
        """
        session = self._read()
        solved = _hash_of(self.solved)
        if session.solved is not None and session.solved.calibration_hash != solved:
            session = replace(session, solved=None, verified=None)  # power was lost between the two files
        # Compared instead of stored: a stored flag could be lost between two writes, and would be wrong after somebody
        # copied a file.
        in_use = session.solved is not None and _bytes(self.current) == _bytes(self.solved)
        is_name_valid = session.kept is not None and is_kept_calibration(session.kept)
        verified = session.verified
        if verified is not None and not in_use and verified.checked != self.in_use:
            # Another calibration was put in use since the length check, which therefore says nothing about it.
            session = replace(session, verified=None if verified.after is None else replace(verified, before=None))
        kept_name = session.kept if is_name_valid and (self.folder / "kept" / str(session.kept)).is_file() else None
        return replace(session, in_use=in_use, kept=kept_name)

    def _read(self) -> Session:
        try:
            return SESSIONS.load(self.folder / "session" / SESSION, self._of) or Session()
        except ContentError:
            return Session()

    def previous(self, session: Session) -> Calibration | None:
        """Return the calibration that was in use before; ``None`` where none is kept or it cannot be read."""
        if session.kept is None:
            return None
        try:
            return load_calibration(self.folder / "kept" / session.kept)
        except CalibrationError:
            return None

    # ------------------------------------------------------------------------------------- writing

    def write(self, session: Session) -> Session:
        """Write the session durably and return it as stored."""
        self._fs.make_folders(self.folder / "session")
        stored = replace(session, in_use=False)  # derived from the files, never stored
        self._fs.replace_file(self.folder / "session" / SESSION, SESSIONS.encode(stored, self._of))
        return self.session()

    def write_solved(
        self, calibration: Calibration, session: Session, report: Mapping[str, bytes] = MappingProxyType({})
    ) -> Session:
        """Write a solved calibration, the files of its ``report`` by name, and then the session, all durable."""
        self._fs.make_folders(self.folder / "session")
        for name, data in report.items():
            self._fs.replace_file(self.folder / "session" / name, data)
        # The session is written last: without it, as after a loss of power, these files have no effect.
        self._fs.replace_file(self.solved, encode_calibration(calibration))
        return self.write(session)

    def use_solved(self, date: str) -> Session:
        """Put the solved calibration in use; the former file is kept first, under ``date`` (ISO 8601, a day).

        Raises SessionError.
        """
        session = self.session()
        data = _bytes(self.solved)
        if session.solved is None or data is None:
            raise SessionError("no calibration is solved; solve first")
        if session.in_use:
            return session
        before = _bytes(self.current)
        if before is not None:
            # Kept and named in the session before it is replaced, so that it can be restored after a loss of power at
            # any moment (ADR 0020).
            session = self.write(replace(session, kept=self._keep(before, date)))
        self._fs.make_folders(self.folder)
        self._fs.replace_file(self.current, data)
        return self.session()

    def restore(self) -> Session:
        """Put the kept file in use again, byte for byte. Raises SessionError, CalibrationError if it is damaged."""
        session = self.session()
        if session.kept is None:
            raise SessionError("no earlier calibration is kept; calibrate")
        path = self.folder / "kept" / session.kept
        load_calibration(path)
        data = _bytes(path)
        if data is None:
            raise SessionError(f"{path} cannot be read; copy the instrument's calibration to {self.current}")
        self._fs.replace_file(self.current, data)
        return self.session()

    def install(self, calibration: Calibration, date: str) -> Path | None:
        """Put a calibration in use that no session made; return where the former file is kept, ``None`` without one."""
        before = _bytes(self.current)
        kept_name = None if before is None else self._keep(before, date)
        self._fs.make_folders(self.folder)
        self._fs.replace_file(self.current, encode_calibration(calibration))
        return None if kept_name is None else self.folder / "kept" / kept_name

    def bring_back(self, name: str | None, date: str) -> Path:
        """Put a kept file in use again, byte for byte: ``name``, or the last kept one that is not in use.

        The file in use is kept before, so that a second call undoes the first. Raises SessionError, CalibrationError
        for a damaged file.
        """
        current = _bytes(self.current)
        files = sorted((self.folder / "kept").glob("*.json"), key=lambda path: (_leading(path.name), path.name))
        candidates = [path for path in files if (path.name == name if name is not None else _bytes(path) != current)]
        if not candidates:
            available = ", ".join(path.name for path in files) or "none"
            problem = "no other calibration is kept" if name is None else f"no calibration {name} is kept"
            raise SessionError(
                f"{problem} in {self.folder / 'kept'} (there: {available}); calibrate, or give one of these"
            )
        path = candidates[-1]
        load_calibration(path)
        data = path.read_bytes()
        # The file in use may not be kept yet, for instance if somebody copied it there.
        if current is not None:
            self._keep(current, date)
        self._fs.replace_file(self.current, data)
        return path

    def begin(self) -> Session:
        """Move the session to the earlier ones and begin a new one."""
        folder = self.folder / "session"
        if folder.is_dir():
            self._fs.make_folders(self.folder / "sessions")
            self._fs.move_folder(folder, self.folder / "sessions" / f"{_next(self.folder / 'sessions'):04d}")
        return self.session()

    def _keep(self, data: bytes, date: str) -> str:
        """Return the name of the kept file with these bytes; write one if there is none."""
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
        numbers = [_leading(path.name) for path in folder.iterdir()]
    except OSError as error:
        raise StorageError.of("cannot list", folder, error) from error
    return max(numbers, default=0) + 1


def _leading(name: str) -> int:
    """Return the number at the start of a name; 0 without one."""
    match = re.match(r"\d{1,9}", name)
    return 0 if match is None else int(match[0])


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
