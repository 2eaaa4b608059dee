"""The installed service under the real systemd, with all its confinement: started, upgraded, taken back, switched off.

The instrument in it is simulated, and a diver in it takes one scan after each start. One machine goes through all of it
in this order; each test begins where the one before has ended. What it needs says ``tests.systemd.debian``; many minutes.
"""

from __future__ import annotations

import functools
import hashlib
import json
import operator
import os
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.systemd.container import Container
from tests.systemd.debian import ELSEWHERE, REPOSITORY, copied, debian, newer, setup, wheels

UNIT, SAFE = "kingfisher.service", "kingfisher-safe.service"
SCAN, BACK, DOWN = 0x01, 0x02, 0x08
UP_S = 120.0
"""From a start to the scan on the disk, on a busy computer."""
DIVER = """
wait state SELF_TEST 90
wait state AIM 90
press scan 0.4
wait state REVIEW 90
press scan 0.4
"""
FIRST_START = """[Service]
# The simulator's kernels are compiled in the service's own process, once.
WatchdogSec=300
"""

pytestmark = ELSEWHERE


@dataclass(frozen=True, slots=True)
class Instrument:
    machine: Container
    root: Path
    tree: Path

    @property
    def status(self) -> dict[str, object]:
        """As the service last told it; empty while it has not."""
        try:
            told: dict[str, object] = json.loads((self.root / "var/lib/kingfisher/run/status.json").read_text())
        except (OSError, ValueError):
            return {}
        return told

    @property
    def in_use(self) -> str:
        return (self.root / "opt/kingfisher/current").readlink().name

    def scans(self) -> dict[str, str]:
        """The checksum of each file of each saved scan."""
        folder = self.root / "var/lib/kingfisher/scans"
        files = [path for path in folder.rglob("*") if path.is_file()]
        return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}

    def until(self, what: str, met: Callable[[], bool], timeout_s: float = UP_S) -> None:
        end_s = time.monotonic() + timeout_s
        while not met():
            if time.monotonic() > end_s:
                journal = self.machine.journal(UNIT)[-3000:]
                raise AssertionError(f"{what}: not after {timeout_s:g} s: {self.status}\n{journal}")
            time.sleep(0.1)

    def works_again(self, before: dict[str, object]) -> None:
        """Wait until another process than ``before``'s has taken a scan."""
        taken = before.get("scans", 0)
        assert isinstance(taken, int)

        def met() -> bool:
            now = self.status
            return (now.get("pid") != before.get("pid"), now.get("state"), now.get("scans")) == (True, "AIM", taken + 1)

        self.until("another scan by another process", met)

    def pages(self) -> int:
        """How often the safe screen has told what is wrong."""
        return self.machine.journal(SAFE).count("; shown on")

    def begin_again(self) -> dict[str, object]:
        """A healthy service with its whole budget of starts; returns its status."""
        before = self.status
        self.machine.run("systemctl", "stop", SAFE, UNIT)
        self.machine.run("systemctl", "reset-failed")
        self.machine.run("systemctl", "start", UNIT)
        self.works_again(before)
        return self.status


@pytest.fixture(scope="module")
def instrument(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Instrument]:
    tree = copied(REPOSITORY, tmp_path_factory.mktemp("source") / "tree")
    with debian(tmp_path_factory.mktemp("debian")) as root:
        setup(tree, root, "install")
        options = '[rig.wires_options]\nscript = "/etc/kingfisher/diver.script"\n'
        options += 'status = "/var/lib/kingfisher/run/status.json"\n'
        rig = (tree / "hw_sim/rigs/small.toml").read_text().replace("/var/tmp/kingfisher-sim", "/var/lib/kingfisher")
        (root / "etc/kingfisher/rig.toml").write_text(rig.replace("[rig.wires_options]\n", options))
        (root / "etc/kingfisher/diver.script").write_text(DIVER)
        patience = root / "etc/systemd/system/kingfisher.service.d/first-start.conf"
        patience.parent.mkdir()
        patience.write_text(FIRST_START)
        with Container(root) as machine:
            made = Instrument(machine, root, tree)
            made.until("the simulator's kernels", lambda: made.status.get("scans") == 1, 400.0)
        patience.unlink()
        with Container(root) as machine:
            yield Instrument(machine, root, tree)


def test_it_starts_by_itself_and_setting_it_up_again_changes_nothing(instrument: Instrument) -> None:
    instrument.until("second scan", lambda: instrument.status.get("scans") == 2)
    assert set(instrument.status["devices"].values()) == {"ok"}  # type: ignore[attr-defined]
    shown = {what: instrument.machine.shown(UNIT, what) for what in ("User", "NRestarts")}
    assert (shown, instrument.machine.shown(SAFE, "ActiveState")) == (
        {"User": "kingfisher", "NRestarts": "0"},
        "inactive",
    )
    assert "is built already" in setup(instrument.tree, instrument.root, "install")
    instrument.machine.run("systemctl", "stop", UNIT)
    assert instrument.machine.shown(UNIT, "Result") == "success", "stopping waits for a good end"
    instrument.begin_again()
    assert "RESTARTED" not in instrument.machine.journal(UNIT).rpartition("Starting kingfisher.service")[2]


def test_a_crash_loop_ends_on_the_safe_screen_and_costs_no_scan(instrument: Instrument) -> None:
    scans, pages, killed = instrument.scans(), instrument.pages(), set[str]()

    def gone() -> bool:
        process = instrument.machine.shown(UNIT, "MainPID")
        if process not in ("0", *killed):
            killed.add(process)
            instrument.machine.kill(UNIT, signal.SIGKILL)
        return instrument.machine.shown(SAFE, "ActiveState") == "active"

    instrument.until("safe screen", gone)
    assert 3 <= len(killed) <= 5, "a budget, and one that allows for bad luck"
    instrument.until("a page", lambda: instrument.pages() > pages)
    assert instrument.scans() == scans
    before = instrument.status
    pad = Pad(instrument.machine)
    pad.hold(0, 1.0)
    pad.hold(SCAN, 0.5)
    pad.close()
    instrument.works_again(before)
    assert instrument.machine.shown(SAFE, "ActiveState") == "inactive"


def test_a_wrong_rig_file_ends_on_the_safe_screen_at_once(instrument: Instrument) -> None:
    instrument.begin_again()
    pages = instrument.pages()
    rig = instrument.root / "etc/kingfisher/rig.toml"
    good = rig.read_text()
    rig.write_text(good.replace("exposure_ms = 12.0", "exposure_ms = 99.0"))
    try:
        instrument.machine.run("systemctl", "restart", UNIT, check=False)
        instrument.until("a page", lambda: instrument.pages() > pages)
        assert "exposure_ms" in instrument.machine.journal(SAFE)
        assert instrument.machine.shown(UNIT, "NRestarts") == "0", "what is refused is refused again"
    finally:
        rig.write_text(good)
    instrument.begin_again()


class Pad:
    """A key pad of which only the reports are there: a pipe where the safe screen looks for it."""

    def __init__(self, machine: Container) -> None:
        path = machine.path("/dev/kingfisher-keys")
        if not path.exists():
            os.mkfifo(path)
            path.chmod(0o666)
        self._end = os.open(path, os.O_RDWR | os.O_NONBLOCK)

    def hold(self, key: int, duration_s: float) -> None:
        end_s = time.monotonic() + duration_s
        while time.monotonic() < end_s:
            body = bytes([1, key, 0, 0, 0, 0, 3])
            os.write(self._end, body + bytes([functools.reduce(operator.xor, body, 0xA5)]))
            time.sleep(0.05)

    def close(self) -> None:
        os.close(self._end)


def upgrade(instrument: Instrument, tree: Path, name: str) -> tuple[int, str]:
    """As its owner does it, in the running machine: exit code and what was said, after the trial has ended."""
    inside = Path("/var/tmp") / name
    shutil.copytree(tree, instrument.root / inside.relative_to("/"))
    given = wheels("upgrade")
    if given:
        copy = instrument.root / "var/tmp/wheels"
        if not copy.exists():
            shutil.copytree(given[1], copy)
        given = ["--wheels", "/var/tmp/wheels"]
    done = instrument.machine.run(inside / "systemd/install", "upgrade", *given, check=False)
    return done.returncode, done.stdout + done.stderr


def test_an_upgrade_that_passes_its_self_test_stays(instrument: Instrument, tmp_path: Path) -> None:
    before, scans, old = instrument.status, instrument.scans(), instrument.in_use
    code, said = upgrade(instrument, newer(instrument.tree, tmp_path / "newer"), "newer")
    assert code == 0, said
    assert "has passed its self-test and stays" in said
    instrument.works_again(before)
    assert instrument.in_use.startswith("9.")
    assert str(instrument.status["version"]).startswith("9.")
    assert (instrument.root / "opt/kingfisher/versions" / old).is_dir(), "for `rollback`"
    assert instrument.in_use in str((instrument.root / "opt/kingfisher/rescue").readlink()), "it has proved itself"
    assert scans.items() <= instrument.scans().items()


def test_an_upgrade_that_does_not_start_is_taken_back(instrument: Instrument, tmp_path: Path) -> None:
    before, scans, old = instrument.status, instrument.scans(), instrument.in_use
    broken = copied(instrument.tree, tmp_path / "broken")
    app = broken / "appliance" / "instrument" / "service" / "app.py"
    # Not where it is imported: that the setup finds before it puts a version on trial.
    app.write_text(app.read_text() + '\n\ndef run(rig):\n    raise RuntimeError("a mistake in the new version")\n')
    code, said = upgrade(instrument, broken, "broken")
    assert (code, "was taken back" in said) == (1, True), said
    instrument.works_again(before)
    assert instrument.in_use == old
    # On the screen it is told once: the diver's key has put it away.
    assert "UPDATE_UNDONE: 0." in instrument.machine.journal(UNIT).rpartition("Starting kingfisher.service")[2]
    assert scans.items() <= instrument.scans().items()


def test_from_the_safe_screen_the_diver_can_switch_off(instrument: Instrument) -> None:
    scans, pages = instrument.scans(), instrument.pages()
    (instrument.root / "etc/kingfisher/rig.toml").write_text("")
    instrument.machine.run("systemctl", "restart", UNIT, check=False)
    instrument.until("a page", lambda: instrument.pages() > pages)
    pad = Pad(instrument.machine)
    pad.hold(0, 1.0)
    for answer in ((SCAN,), (DOWN, SCAN)):  # STAY ON is selected when it asks
        assert not instrument.machine.is_off
        pad.hold(BACK, 4.0)
        for key in answer:
            pad.hold(0, 1.0)
            pad.hold(key, 0.5)
    instrument.until("power off", lambda: instrument.machine.is_off, 60.0)
    pad.close()
    assert instrument.scans() == scans
