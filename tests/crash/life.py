"""All that a dive does to the disk, until it dies at a call; says what it did."""

from __future__ import annotations

import os
import random
import signal
from dataclasses import replace
from pathlib import Path

from appliance.calibrate.calibrations import Calibrations
from appliance.calibrate.guide import USED, AdjustmentSummary, RecordingCheck, Session
from appliance.calibrate.health import HealthFile, HealthTrend, TrendPoint
from appliance.measure.calibration.design import Design, design_calibration
from appliance.measure.light.water import Water
from appliance.store.atomic import Bytes, WritableFile
from appliance.store.library import Library
from appliance.store.room import Room
from tests.appliance.store.scenes import ORIGIN, PLAN, PREVIEW, CountedDisk, cloud, frames, record

SERIAL = "KF-TEST"
HASH = "0123456789abcdef" * 4
OLD = design_calibration(Design(11.5, 4.5, 230.0, 12.41, 30.0, 5.0, 1.77), SERIAL, 1600, 1200, Water(20.0, 0.0, 530.0))
NEW = replace(OLD, method="bundle", made_at="2026-11-21T10:00:00+00:00")
CALIBRATIONS = {OLD.hash, NEW.hash}
SCANS = 4


class DeadlyDisk(CountedDisk):
    """At changing call ``die_at`` the process kills itself, somewhere within it where that is a write."""

    def __init__(self, die_at: int, chance: random.Random) -> None:
        self.calls = 0
        self._die_at = die_at
        self._chance = chance

    def before(self, call: str) -> None:
        self.calls += 1
        if self.calls - 1 == self._die_at:
            os.kill(os.getpid(), signal.SIGKILL)

    def write(self, file: WritableFile, data: Bytes, name: str) -> None:
        if self.calls == self._die_at:
            file.write(memoryview(data)[: self._chance.randrange(len(data) + 1)])
        super().write(file, data, name)


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
