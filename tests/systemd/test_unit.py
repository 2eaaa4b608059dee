"""systemd understands the units without a word of complaint, and they promise what the instrument needs."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from appliance.cli import main
from appliance.instrument.service.loop import QUIT_TIMEOUT_S
from kingfisher_setup import placed

SYSTEMD = Path(__file__).parents[2] / "systemd"
UNITS = sorted(path.name for path in (*SYSTEMD.glob("*.service"), *SYSTEMD.glob("*.path")))
STATED = re.compile(r"^\| `(kingfisher\S*\.service)` \| ([0-9.]+) \|", re.MULTILINE)
EXPOSURE = {name: float(figure) for name, figure in STATED.findall((SYSTEMD / "README.md").read_text())}
"""Of 10, by unit, as its page states it."""
OTHER_VERSIONS = 0.3
"""Most that another systemd than Debian 12's counts more or less."""
ON_INSTRUMENT = re.compile(r"^(Exec\w+=[-+!@:]*)/opt/kingfisher/\S+", re.MULTILINE)
"""Programs that are not installed on the machine that tests."""
NEEDED_OFF = {
    "kingfisher.service": ("MemoryDenyWriteExecute", "PrivateDevices", "PrivateNetwork", "PrivateUsers", "RootDirectory"),
    "kingfisher-trial.service": ("User", "ProtectSystem", "PrivateDevices"),
}  # fmt: skip

needs_systemd = pytest.mark.skipif(
    shutil.which("systemd-analyze") is None, reason="systemd-analyze is not here: apt-get install systemd"
)


def analyzed(*words: object, cwd: Path = SYSTEMD) -> subprocess.CompletedProcess[str]:
    command = ["systemd-analyze", *map(str, words)]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=60, check=False)


def settings(name: str) -> dict[str, list[str]]:
    """A unit's keys, each with all its values."""
    found: dict[str, list[str]] = {}
    for line in (SYSTEMD / name).read_text().splitlines():
        key, equals, value = line.partition("=")
        if equals and not line.startswith("#"):
            found.setdefault(key, []).append(value)
    return found


@needs_systemd
@pytest.mark.parametrize("spoilt", ["RestartSec=", "RestartSecs="])
def test_systemd_accepts_the_units_and_would_notice_a_misspelt_key(tmp_path: Path, spoilt: str) -> None:
    """It ends with 0 even on keys it does not know."""
    for name in UNITS:
        text = ON_INSTRUMENT.sub(r"\1/bin/true", (SYSTEMD / name).read_text())
        (tmp_path / name).write_text(text.replace("RestartSec=", spoilt))
    said = analyzed("verify", "--man=no", *UNITS, cwd=tmp_path).stderr
    assert ("kingfisher" in said) == (spoilt != "RestartSec="), said


@needs_systemd
@pytest.mark.parametrize("name", [name for name in UNITS if name.endswith(".service")])
def test_a_unit_is_as_confined_as_its_page_states(name: str) -> None:
    result = analyzed("security", "--offline=true", "--no-pager", SYSTEMD / name)
    found = re.search(r"exposure level for \S+: ([0-9.]+)", result.stdout)
    assert found is not None, result.stdout
    assert float(found[1]) == pytest.approx(EXPOSURE[name], abs=OTHER_VERSIONS)


@pytest.mark.parametrize("name", UNITS)
def test_nothing_waits_for_a_network_or_a_clock(name: str) -> None:
    unit = settings(name)
    order = [word for key in ("After", "Wants", "Requires", "BindsTo", "Requisite") for word in unit.get(key, [])]
    assert not [word for word in order if re.search(r"network|time-sync|time-set|remote|nss|chrony|ntp|resolved", word)]


def test_it_comes_back_within_a_budget_and_then_the_safe_screen_takes_over() -> None:
    unit = settings("kingfisher.service")
    assert (unit["Restart"], unit["OnFailure"]) == (["on-failure"], ["kingfisher-safe.service"])
    # Who hangs is found after this time; five of them must still fall within the budget's interval.
    burst, interval_s = int(unit["StartLimitBurst"][0]), int(unit["StartLimitIntervalSec"][0])
    longest_s = max(int(unit["WatchdogSec"][0]), int(unit["TimeoutStartSec"][0])) + int(unit["TimeoutAbortSec"][0])
    assert burst * longest_s < interval_s
    assert int(unit["TimeoutStopSec"][0]) > QUIT_TIMEOUT_S, "a save is finished before it is killed"


def test_the_program_understands_the_command_of_the_unit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (command,) = settings("kingfisher.service")["ExecStart"]
    missing = str(tmp_path / "rig.toml")
    arguments = [missing if word.endswith(".toml") else word for word in command.split()[1:]]
    assert (missing in arguments, main(arguments), missing in capsys.readouterr().err) == (True, 2, True)
    assert settings("kingfisher.service")["RestartPreventExitStatus"] == ["2"]  # it would be refused again


def test_what_must_stay_off_is_off_and_says_why() -> None:
    for name, directives in NEEDED_OFF.items():
        for directive in directives:
            assert directive not in settings(name)
            assert re.search(rf"^# {directive}= +- \S", (SYSTEMD / name).read_text(), re.MULTILINE)
    unit = settings("kingfisher-trial.service")
    assert unit["CapabilityBoundingSet"] == ["CAP_DAC_OVERRIDE CAP_SYS_ADMIN"]
    assert "@mount" in unit["SystemCallFilter"][0], "a read-only system is mounted for writing while versions change"
    assert unit["RestrictAddressFamilies"] == ["AF_UNIX"], "systemctl and sd_notify"


def test_the_drivers_whose_devices_are_allowed_are_loaded_before_the_service() -> None:
    """systemd looks such names up when the service starts: a board plugged in later would be shut out for good."""
    modules = (SYSTEMD / "kingfisher.modules").read_text().split()
    loaded = {"char-ttyACM": "cdc_acm", "char-hidraw": "usbhid", "char-drm": "drm"}
    for name in ("kingfisher.service", "kingfisher-safe.service"):
        needed = {loaded.get(allowed.split()[0]) for allowed in settings(name)["DeviceAllow"]} - {None}
        assert needed <= set(modules)


def test_nothing_sleeps_and_names_are_stable() -> None:
    rules = (SYSTEMD / "70-kingfisher.rules").read_text()
    usb = [line for line in rules.splitlines() if 'SUBSYSTEM=="usb"' in line]
    assert ['ATTR{power/control}="on"' in line for line in usb] == [True, True, True]
    rig = (SYSTEMD.parent / "appliance" / "store" / "rigs" / "kingfisher.toml").read_text()
    assert 'url = "/dev/kingfisher-board"' in rig
    assert 'SYMLINK+="kingfisher-board"' in rules
    assert "usbcore.usbfs_memory_mb=256" in (SYSTEMD / "kingfisher.grub").read_text()


def test_a_unit_that_wants_to_start_by_itself_is_enabled_and_no_other() -> None:
    wanting = [name for name in UNITS if "WantedBy=multi-user.target" in (SYSTEMD / name).read_text()]
    links = [link for link in placed.LINKS if link.parent == placed.UNITS / "multi-user.target.wants"]
    assert sorted(link.name for link in links) == wanting
    assert "kingfisher.service" in wanting
