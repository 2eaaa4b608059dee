"""The process is killed at any moment of a dive: every scan it called saved is there, whole, under its own number."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import time
from pathlib import Path

from appliance.storage.library import Library, Shelf
from tests.appliance.storage.scenes import frames, record

KILLS = 30
WRITER = """
import sys
from pathlib import Path
from appliance.storage.library import Library
from tests.appliance.storage.scenes import PREVIEW, cloud, frames, record
library = Library(Path(sys.argv[1]))
library.prepare()
library.recover()
print("READY", flush=True)
for k in range(10_000):
    scan = library.begin(frames(k), record())
    print("RAW", scan.scan_id, flush=True)
    if k % 3 == 2:
        scan.reject("no")
    else:
        scan.publish(record(), cloud(2000, seed=k))
        print("SAVED", scan.scan_id, flush=True)
"""


def test_sigkill_at_random_moments(tmp_path: Path) -> None:
    chance = random.Random(20)
    root = tmp_path / "root"
    saved: set[str] = set()
    raw: list[str] = []
    writer = tmp_path / "writer.py"
    writer.write_text(WRITER)
    saving_s = 0.0
    for kill in range(KILLS):
        with subprocess.Popen(
            [sys.executable, str(writer), str(root)],
            stdout=subprocess.PIPE,
            text=True,
            cwd=Path(__file__).parents[3],
            env={"PYTHONPATH": str(Path(__file__).parents[3])},
        ) as child:
            assert child.stdout is not None
            assert child.stdout.readline() == "READY\n"
            if kill % 5 == 0:  # how long a scan takes now, on this disk, beside whatever else runs
                begun = time.monotonic()
                raw.append(child.stdout.readline().split()[1])
                saved.add(child.stdout.readline().split()[1])
                saving_s = time.monotonic() - begun
            time.sleep(chance.uniform(0.0, 5.0 * saving_s))
            child.send_signal(signal.SIGKILL)
            for line in child.stdout.read().splitlines():
                word, _, scan_id = line.partition(" ")
                if word == "SAVED" and len(scan_id) == 6:
                    saved.add(scan_id)
                elif word == "RAW" and len(scan_id) == 6:
                    raw.append(scan_id)
    assert len(saved) > KILLS / 2, "the child was always killed before it could save"
    assert len(raw) == len(set(raw)), "a number was given twice"

    library = Library(root)
    library.recover()
    entries = {entry.scan_id: entry for entry in library.entries()}
    assert saved <= set(entries)
    assert all(library.verify(scan_id).ok for scan_id in entries)
    kept_or_rejected = set(entries) | {entry.scan_id for entry in library.entries(Shelf.REJECTED)}
    assert set(raw) <= kept_or_rejected, "raw frames that were safe are gone"
    assert library.begin(frames(), record()).scan_id > max(raw)
