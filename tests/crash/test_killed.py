"""The process is killed at any moment of a dive: every scan it called saved is there, whole, under its own number.

One process has everything loaded and is forked for each life, so that hundreds of deaths take seconds. A life dies by its
own SIGKILL at the n-th call that changes the disk (in the middle of a write, where that is one), or from outside at a
moment drawn at random.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from appliance.calibration import file as calibration_file
from appliance.storage.calibrations import Calibrations
from appliance.storage.health import HealthFile
from appliance.storage.library import Library, LibraryFolder
from tests.appliance.storage.scenes import ORIGIN, frames, record
from tests.crash.life import CALIBRATIONS, HASH, SERIAL

ROOT = Path(__file__).parents[2]


class Lives:
    """Starts one life after the other under a storage root, and reads what each said before it died."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._said = root.with_name("said")
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.crash.life", str(root), str(self._said)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            env={"PYTHONPATH": str(ROOT)},
        )

    def __enter__(self) -> Lives:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate(timeout=30)

    def live(self, seed: int, die_at_call: int = -1, kill_after_s: float | None = None) -> list[str]:
        """The words of one life; with neither way to die it ends by itself."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._said.write_text("")
        print(seed, die_at_call, file=self._process.stdin, flush=True)
        pid = int(self._process.stdout.readline())
        if kill_after_s is not None:
            time.sleep(kill_after_s)
            os.kill(pid, signal.SIGKILL)  # not yet waited for by its parent: the number is still its own
        print("waited", file=self._process.stdin, flush=True)
        assert self._process.stdout.readline() == "ended\n"
        return [line for line in self._said.read_text().splitlines() if line.endswith(".")]


class Book:
    """What was said in all lives, and what must therefore be on the disk."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.begun: list[str] = []
        self.saved: set[str] = set()
        self.rejected: set[str] = set()
        self.judged = 0
        self.sessions = 0

    def enter(self, words: list[str]) -> None:
        for line in words:
            word, _, value = line.rstrip(".").partition(" ")
            match word:
                case "RAW":
                    self.begun.append(value)
                case "SAVED":
                    self.saved.add(value)
                case "REJECTED":
                    self.rejected.add(value)
                case "JUDGED":
                    self.judged = int(value)
                case "SESSION":
                    self.sessions = int(value)

    def check_files(self) -> None:
        """What is replaced as a whole is the last one written or a newer one, never none and never half of one."""
        assert calibration_file.load(Calibrations(self.root, SERIAL).current).hash in CALIBRATIONS
        assert HealthFile(self.root, HASH).read().judged >= self.judged
        if self.sessions:
            assert len(Calibrations(self.root, SERIAL).session().trials) >= 1

    def check_scans(self) -> None:
        """After the sweep of a new start."""
        library = Library(self.root)
        assert library.recover().failed == ()
        scans = {entry.scan_id: entry for entry in library.entries()}
        rejected = {entry.scan_id for entry in library.entries(LibraryFolder.REJECTED)}
        assert self.saved <= set(scans), "a scan that was called saved is gone"
        assert self.rejected <= rejected
        assert set(self.begun) <= set(scans) | rejected, "raw frames that were safe are gone"
        assert len(self.begun) == len(set(self.begun)), "a number was given twice"
        for scan_id in (*scans, *rejected):
            assert library.verify(scan_id).problems == ()
        for scan_id in self.saved:
            assert not scans[scan_id].manifest.recovered  # type: ignore[union-attr]
        assert not list((self.root / "scans").glob(".*"))
        if self.begun:
            assert int(library.begin(frames(), record(), ORIGIN).scan_id) > max(map(int, self.begun))


def _deaths(tmp_path: Path, by_call: int, by_time: int, per_root: int, seed: int) -> tuple[int, int]:
    """How many lives died before their end, and how many scans were called saved in all of them."""
    chance = random.Random(seed)
    died = saved = 0
    done = 0
    while done < by_call + by_time:
        root = tmp_path / f"{done}" / "root"
        root.parent.mkdir()
        with Lives(root) as lives:
            book = Book(root)
            book.enter(lives.live(done))  # makes what the later ones find
            begun = time.monotonic()
            words = lives.live(done)
            whole_s = time.monotonic() - begun
            calls = int(next(line for line in words if line.startswith("CALLS")).split()[1].rstrip("."))
            book.enter(words)
            for k in range(done, min(done + per_root, by_call + by_time)):
                if k < by_call:  # spread over the whole life, each stretch of it once
                    words = lives.live(k, die_at_call=(k * calls) // by_call if k % 2 else chance.randrange(calls))
                else:
                    words = lives.live(k, kill_after_s=chance.uniform(0.0, 1.2 * whole_s))
                died += not any(line.startswith("CALLS") for line in words)
                book.enter(words)
                book.check_files()
            book.check_scans()
            saved += len(book.saved)
        done += per_root
    return died, saved


def test_sigkill_at_some_moments(tmp_path: Path) -> None:
    died, saved = _deaths(tmp_path, by_call=18, by_time=6, per_root=24, seed=20)
    assert died >= 12, "the lives ended before they were killed"
    assert saved > 12


@pytest.mark.dive
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("part", range(2))
def test_sigkill_at_hundreds_of_moments_spread_over_all_of_a_dive(tmp_path: Path, part: int) -> None:
    """Both parts together: 172 lives, of which 120 and more end early."""
    died, saved = _deaths(tmp_path, by_call=66, by_time=20, per_root=22, seed=21 + part)
    assert died >= 60
    assert saved > 40
