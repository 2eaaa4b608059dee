"""A process that does all that a dive does to the disk, again and again, until it is killed; says what it did.

    python -m tests.crash.life ROOT SAID

Reads ``SEED CALL`` lines, forks for each, answers the pid, and after the next line waits for its end.
"""

from __future__ import annotations

import os
import random
import signal
import sys
from dataclasses import replace
from pathlib import Path

from appliance.calibration.design import Design, design_calibration
from appliance.calibration.guide import USED, AdjustmentSummary, RecordingCheck, Session
from appliance.calibration.health import HealthTrend, TrendPoint
from appliance.optics.water import Water
from appliance.storage.calibrations import Calibrations
from appliance.storage.filesystem import Bytes, LocalFileSystem, WritableFile
from appliance.storage.health import HealthFile
from appliance.storage.library import Library
from appliance.storage.room import Room
from tests.appliance.storage.scenes import ORIGIN, PLAN, PREVIEW, cloud, frames, record

SERIAL = "KF-TEST"
HASH = "0123456789abcdef" * 4
OLD = design_calibration(Design(11.5, 4.5, 230.0, 12.41, 30.0, 5.0, 1.77), SERIAL, 1600, 1200, Water(20.0, 0.0, 530.0))
NEW = replace(OLD, method="bundle", made_at="2026-11-21T10:00:00+00:00")
CALIBRATIONS = {OLD.hash, NEW.hash}
SCANS = 4


class DeadlyDisk(LocalFileSystem):
    """The local disk; at changing call ``die_at`` the process kills itself, half way through where that is a write."""

    def __init__(self, die_at: int, chance: random.Random) -> None:
        self.calls = 0
        self._die_at = die_at
        self._chance = chance

    def reached(self) -> bool:
        self.calls += 1
        return self.calls - 1 == self._die_at

    def before(self) -> None:
        if self.reached():
            os.kill(os.getpid(), signal.SIGKILL)

    def make_folder(self, path: Path) -> None:
        self.before()
        super().make_folder(path)

    def create(self, path: Path) -> WritableFile:
        self.before()
        return _DeadlyFile(self, super().create(path), self._chance)

    def rename(self, source: Path, target: Path) -> None:
        self.before()
        super().rename(source, target)

    def allocate(self, path: Path, length_bytes: int) -> None:
        self.before()
        super().allocate(path, length_bytes)

    def reopen(self, path: Path) -> WritableFile:
        self.before()
        return _DeadlyFile(self, super().reopen(path), self._chance)

    def sync_folder(self, path: Path) -> None:
        self.before()
        super().sync_folder(path)

    def remove(self, path: Path) -> None:
        self.before()
        super().remove(path)


class _DeadlyFile:
    def __init__(self, disk: DeadlyDisk, file: WritableFile, chance: random.Random) -> None:
        self._disk, self._file, self._chance = disk, file, chance

    def write(self, data: Bytes) -> None:
        if self._disk.reached():
            self._file.write(memoryview(data)[: self._chance.randrange(len(data) + 1)])
            os.kill(os.getpid(), signal.SIGKILL)
        self._file.write(data)

    def sync(self) -> None:
        self._disk.before()
        self._file.sync()

    def close(self) -> None:
        self._file.close()


def live(root: Path, said: Path, seed: int, die_at: int) -> None:
    """A start, some scans kept and rejected, a calibration put in use and taken back, the trend after each."""
    log = os.open(said, os.O_WRONLY | os.O_APPEND)

    def say(*words: object) -> None:
        os.write(log, (" ".join(map(str, words)) + ".\n").encode())

    disk = DeadlyDisk(die_at, random.Random(seed))
    room = Room(root, disk)
    library = Library(root, room)
    library.prepare()
    library.recover()
    store = Calibrations(root, SERIAL, disk)
    health = HealthFile(root, HASH, disk)
    judged = health.read().judged
    for k in range(SCANS):
        room.hold(PLAN)
        scan = library.begin(frames(seed + k), record(), ORIGIN)
        say("RAW", scan.scan_id)
        if k % 3 == 2:
            scan.reject("moved", record())
            say("REJECTED", scan.scan_id)
        else:
            scan.publish(record(), cloud(300, seed=k), PREVIEW)
            say("SAVED", scan.scan_id)
        judged += 1
        point = TrendPoint(scan.scan_id, (1.0, 2.0, 3.0, 4.0), (0.5,) * 4, 1.0, 2.0, 0.5, False)
        health.write(HealthTrend(judged=judged, points=(point,)))
        say("JUDGED", judged)
        if k == 1:
            session = Session((RecordingCheck(USED[0], None, 0.03, 900, "bar", scan.scan_id),))
            session = store.write(session)
            say("SESSION", 1)
            session = store.write_solved(
                NEW, replace(session, solved=AdjustmentSummary(NEW.method, 0.03, (), NEW.hash))
            )
            session = store.use_solved("2026-11-21")
            if session.kept is not None:
                store.restore()
    say("CALLS", disk.calls)


def main() -> None:
    """Serve lives until the input ends."""
    root, said = Path(sys.argv[1]), Path(sys.argv[2])
    Calibrations(root, SERIAL).install(OLD, "2026-11-20")
    while line := sys.stdin.readline():
        seed, die_at = map(int, line.split())
        pid = os.fork()
        if pid == 0:
            try:
                live(root, said, seed, die_at)
            finally:
                os._exit(0)
        print(pid, flush=True)
        sys.stdin.readline()
        os.waitpid(pid, 0)
        print("ended", flush=True)


if __name__ == "__main__":
    main()
