"""From power on to a scan on the disk, and what the instrument promises when it is killed, hung, reset or full.

One machine, switched on once, goes through it in this order: each test begins where the one before has ended.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.boot.instrument import Instrument
from tests.boot.machine import DISPLAY, Gone
from tests.boot.picture import image_of

ROOT = Path(__file__).resolve().parents[2]
UNIT = "kingfisher.service"
SCANS = "/var/lib/kingfisher/scans"
TOOL = "/opt/kingfisher/current/bin/kingfisher"
BOOT_S, RESTART_S, SCAN_S = 420.0, 240.0, 300.0
"""Emulated in software, and on a computer that does other things as well."""
DROP_IN = """[Service]
# Everything takes many times as long where the processor is emulated.
TimeoutStartSec=600
WatchdogSec=60
TimeoutStopSec=60
"""

pytestmark = [pytest.mark.boot, pytest.mark.timeout(1800)]


@pytest.fixture(scope="module")
def instrument(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Instrument]:
    artefacts = ROOT / "build" / "boot"
    artefacts.mkdir(parents=True, exist_ok=True)
    for old in artefacts.iterdir():
        old.unlink()
    with Instrument(image_of(ROOT), ROOT, tmp_path_factory.mktemp("vm"), artefacts, DROP_IN) as made:
        yield made


def ready(instrument: Instrument, timeout_s: float) -> dict[str, object]:
    """In AIM; a self-test that has something to say is answered as a diver does."""
    status = instrument.wait("self-test or aim", lambda s: s["state"] in ("SELF_TEST", "AIM"), timeout_s)
    end_s = time.monotonic() + timeout_s
    while status["state"] != "AIM" and time.monotonic() < end_s:
        if status["state"] == "SELF_TEST" and status["keys"].get("scan") == "GO ON":
            instrument.world.press("scan", 0.4)
            time.sleep(2.0)
        time.sleep(0.5)
        status = instrument.status() or status
    assert status["state"] == "AIM", status
    return status


def show(instrument: Instrument, unit_property: str) -> str:
    return instrument.machine.run(f"systemctl show -P {unit_property} {UNIT}").strip()


def stored(instrument: Instrument) -> dict[str, str]:
    """Checksums of every file of every saved scan."""
    text = instrument.machine.run(
        f"cd {SCANS} 2>/dev/null && find . -type f ! -path '*/.*' | xargs -r sha256sum", 120.0
    )
    return {name: digest for digest, name in (line.split("  ") for line in text.splitlines())}


def scan_once(instrument: Instrument, number: int) -> None:
    instrument.dive(
        f"""
        wait state AIM 60
        press scan 0.4
        wait state REVIEW {SCAN_S:g}
        """,
        SCAN_S + 120.0,
    )
    instrument.keep(f"review-{number}")


def save(instrument: Instrument, number: int) -> None:
    instrument.dive(
        f"""
        press scan 0.4
        wait scans {number} 120
        wait state AIM 60
        """,
        240.0,
    )


def test_power_on_leads_to_the_aim_screen_by_itself(instrument: Instrument) -> None:
    instrument.machine.wait_for_agent(BOOT_S)
    status = ready(instrument, BOOT_S)
    status = instrument.wait("six devices", lambda s: set(s["devices"].values()) == {"ok"}, RESTART_S)
    assert status["state"] == "AIM"
    picture = instrument.machine.screen(DISPLAY)
    assert picture.shape == (480, 800, 3)
    assert picture.std() > 10.0, "the aim screen shows a live image and words"
    instrument.keep("aim")
    report = instrument.machine.run(
        "systemd-analyze time; systemd-analyze critical-chain kingfisher.service --no-pager; "
        "systemd-analyze blame --no-pager | head -15; journalctl -u kingfisher -o short-monotonic --no-pager | head -40",
        120.0,
    )
    (instrument.artefacts / "boot-times.txt").write_text(report)
    assert show(instrument, "NRestarts") == "0"


def test_nothing_can_write_to_the_system(instrument: Instrument) -> None:
    code, text = instrument.machine.try_run("touch /usr/bin/x /opt/kingfisher/x /etc/x")
    assert code != 0
    assert text.count("Read-only file system") == 3, text
    mounted = " ".join(instrument.machine.run("grep -E '^[^ ]+ /(var)? ' /proc/mounts").split())
    assert " / ext4 ro" in mounted, mounted
    assert " /var ext4 rw" in mounted, mounted
    assert show(instrument, "User") == "kingfisher"


@pytest.mark.long
def test_a_press_of_scan_becomes_a_cloud_and_a_scan_on_the_disk(instrument: Instrument) -> None:
    scan_once(instrument, 1)
    cloud = instrument.machine.screen(DISPLAY)
    assert len(np.unique(cloud.reshape(-1, 3), axis=0)) > 200, "points coloured by depth"
    cv2.imwrite(str(instrument.artefacts / "projector.png"), instrument.cable.projected())
    save(instrument, 1)
    instrument.keep("saved")
    (manifest,) = [name for name in stored(instrument) if name.endswith("manifest.json")]
    told = json.loads(instrument.machine.run(f"cat {SCANS}/{manifest}"))
    assert told["ledger"]["expected"] == len(told["ledger"]["pulses"]) == 24


@pytest.mark.long
def test_a_killed_service_is_back_with_its_scans(instrument: Instrument) -> None:  # faults.md 37
    before, pid = stored(instrument), show(instrument, "MainPID")
    instrument.machine.run(f"kill -KILL {pid}")
    begun_s = time.monotonic()
    instrument.wait("another process", lambda s: str(s["pid"]) != pid, RESTART_S)
    ready(instrument, RESTART_S)
    print(f"killed: in AIM again after {time.monotonic() - begun_s:.1f} s")
    assert stored(instrument) == before
    assert show(instrument, "NRestarts") == "1"


@pytest.mark.long
def test_a_main_loop_that_hangs_is_ended_by_the_watchdog(instrument: Instrument) -> None:  # faults.md 38
    before, pid = stored(instrument), show(instrument, "MainPID")
    instrument.machine.run(f"kill -STOP {pid}")
    begun_s = time.monotonic()
    instrument.wait("another process", lambda s: str(s["pid"]) != pid, RESTART_S + 120.0)
    ready(instrument, RESTART_S)
    print(f"hung: in AIM again after {time.monotonic() - begun_s:.1f} s")
    assert "watchdog" in instrument.machine.run(f"journalctl -u {UNIT} --no-pager -n 200").lower()
    assert stored(instrument) == before


@pytest.mark.long
def test_a_full_disk_is_said_and_costs_nothing(instrument: Instrument) -> None:  # faults.md 31
    before = stored(instrument)
    instrument.machine.run("fallocate -l $(($(df --output=avail -B1 /var | tail -1) - 60000000)) /var/full", 120.0)
    instrument.wait("storage full", lambda s: any(a["headline"] == "STORAGE FULL" for a in s["alerts"]), 120.0)
    instrument.keep("storage-full")
    instrument.world.press("scan", 0.4)
    time.sleep(10.0)
    assert instrument.status()["state"] == "AIM"
    instrument.machine.run("rm /var/full")
    instrument.wait("room again", lambda s: all(a["headline"] != "STORAGE FULL" for a in s["alerts"]), 120.0)
    assert stored(instrument) == before


@pytest.mark.long
def test_a_reset_in_the_middle_of_saving_costs_no_scan(instrument: Instrument) -> None:  # faults.md 30
    before = stored(instrument)
    scan_once(instrument, 2)
    instrument.world.press("scan", 0.4)
    instrument.wait("saving", lambda s: s["state"] == "SAVING" or s["scans"] == 2, 60.0)
    instrument.machine.monitor.do("system_reset")
    instrument.exporter.cut()
    instrument.status_path.unlink(missing_ok=True)
    instrument.machine.wait_for_agent(BOOT_S)
    ready(instrument, BOOT_S)
    after = stored(instrument)
    assert before.items() <= after.items(), "what was saved is there, bit by bit"
    assert len({name.split("/")[1] for name in after}) == 2, "the one that was being saved was recovered"
    listed = json.loads(instrument.machine.run(f"{TOOL} scans list --root /var/lib/kingfisher --json", 240.0))
    print(json.dumps(listed)[:2000])


@pytest.mark.long
def test_a_crash_loop_ends_on_the_safe_screen(instrument: Instrument) -> None:  # faults.md 40
    before = stored(instrument)
    killed: set[str] = set()
    end_s = time.monotonic() + 300.0
    while time.monotonic() < end_s:
        if instrument.machine.run("systemctl is-active kingfisher-safe.service || true").strip() == "active":
            break
        pid = show(instrument, "MainPID")
        if pid not in ("0", *killed):
            killed.add(pid)
            instrument.machine.try_run(f"kill -KILL {pid}")
        time.sleep(0.2)
    assert instrument.machine.run("systemctl is-active kingfisher-safe.service").strip() == "active"
    assert len(killed) >= 3
    time.sleep(15.0)
    picture = instrument.machine.screen(DISPLAY)
    instrument.keep("safe")
    assert picture.std() > 5.0, "the safe screen says something"
    assert stored(instrument) == before
    with pytest.raises(Gone):
        instrument.machine.run(f"systemctl is-active {UNIT}")
