"""The process is killed at any moment of a dive: every scan it called saved is there, whole, under its own number.

Each life is a fork of this process, so that many deaths take seconds. It dies by its own SIGKILL at the n-th call that changes the
disk (in the middle of a write, where that is one), or from outside at a moment drawn at random.
"""

from __future__ import annotations

import multiprocessing
import random
import time
from pathlib import Path

from appliance.calibrate.calibrations import Calibrations
from appliance.calibrate.health import HealthFile
from appliance.store.instrument import load_calibration
from appliance.store.library import Library, LibraryFolder
from tests.appliance.store.scenes import ORIGIN, frames, record
from tests.crash.life import CALIBRATIONS, HASH, OLD, SERIAL, live

FORKED = multiprocessing.get_context("fork")
BY_CALL, BY_TIME = 66, 20
"""Lives that die at a call, and at a moment."""


def lived(root: Path, seed: int, die_at_call: int = -1, kill_after_s: float | None = None) -> list[str]:
    """The words of one life; with neither way to die it ends by itself."""
    said = root.with_name("said")
    said.write_text("")
    process = FORKED.Process(target=live, args=(root, said, seed, die_at_call))
    process.start()
    if kill_after_s is not None:
        time.sleep(kill_after_s)
        process.kill()
    process.join(60.0)
    assert process.exitcode is not None
    return [line.rstrip(".") for line in said.read_text().splitlines() if line.endswith(".")]


class Book:
    """What was said in all lives, and what must therefore be on the disk."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.said: dict[str, list[str]] = {"RAW": [], "SAVED": [], "REJECTED": [], "JUDGED": [], "SESSION": []}

    def enter(self, words: list[str]) -> None:
        for line in words:
            word, _, value = line.partition(" ")
            self.said.get(word, []).append(value)

    def check_files(self) -> None:
        """What is replaced as a whole is the last one written or a newer one, never none and never half of one."""
        assert load_calibration(Calibrations(self.root, SERIAL).current).hash in CALIBRATIONS
        assert HealthFile(self.root, HASH).read().judged >= int(self.said["JUDGED"][-1])
        assert len(Calibrations(self.root, SERIAL).session().trials) >= 1

    def check_scans(self) -> None:
        """After the sweep of a new start."""
        library = Library(self.root)
        assert library.recover().failed == ()
        scans = {entry.scan_id: entry for entry in library.entries()}
        rejected = {entry.scan_id for entry in library.entries(LibraryFolder.REJECTED)}
        begun = self.said["RAW"]
        assert set(self.said["SAVED"]) <= set(scans), "a scan that was called saved is gone"
        assert set(self.said["REJECTED"]) <= rejected
        assert set(begun) <= set(scans) | rejected, "raw frames that were safe are gone"
        assert len(begun) == len(set(begun)), "a number was given twice"
        for scan_id in (*scans, *rejected):
            assert library.verify(scan_id).problems == ()
        for scan_id in self.said["SAVED"]:
            assert not scans[scan_id].manifest.recovered  # type: ignore[union-attr]
        assert not list((self.root / "scans").glob(".*"))
        assert int(library.begin(frames(), record(), ORIGIN).scan_id) > max(map(int, begun))


def test_sigkill_at_moments_spread_over_all_of_a_dive(tmp_path: Path) -> None:
    chance, died, root = random.Random(20), 0, tmp_path / "root"
    Calibrations(root, SERIAL).install(OLD, "2026-11-20")
    book = Book(root)
    book.enter(lived(root, 0))  # makes what the later ones find
    begun = time.monotonic()
    words = lived(root, 0)
    whole_s = time.monotonic() - begun
    (calls,) = (int(line.removeprefix("CALLS ")) for line in words if line.startswith("CALLS"))
    book.enter(words)
    for k in range(BY_CALL + BY_TIME):
        if k < BY_CALL:  # each stretch of the life once
            words = lived(root, k, die_at_call=(k * calls) // BY_CALL if k % 2 else chance.randrange(calls))
        else:
            words = lived(root, k, kill_after_s=chance.uniform(0.0, 1.2 * whole_s))
        died += not any(line.startswith("CALLS") for line in words)
        book.enter(words)
        book.check_files()
    book.check_scans()
    assert died >= 60, "the lives ended before they were killed"
    assert len(book.said["SAVED"]) > 40
