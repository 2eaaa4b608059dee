"""systemd understands the unit without a word of complaint, and the unit promises what the instrument needs."""

from __future__ import annotations

import configparser
import shutil
import subprocess
from pathlib import Path

import pytest

from appliance.cli import main

UNIT = Path(__file__).parents[2] / "systemd" / "kingfisher.service"
PROGRAM = "/opt/kingfisher/current/bin/kingfisher"

needs_systemd = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")


def complaints(text: str, folder: Path) -> str:
    """What ``systemd-analyze verify`` says; it ends with 0 even on keys it does not know."""
    here = folder / "kingfisher.service"
    here.write_text(text.replace(PROGRAM, "/bin/true"))  # the program is not installed on this machine
    result = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(here)], capture_output=True, text=True, timeout=60, check=False
    )
    return "\n".join(line for line in result.stderr.splitlines() if "kingfisher" in line)


@needs_systemd
def test_systemd_accepts_the_unit(tmp_path: Path) -> None:
    assert complaints(UNIT.read_text(), tmp_path) == ""


@needs_systemd
def test_a_misspelt_key_would_be_noticed(tmp_path: Path) -> None:
    assert "RestartSecs" in complaints(UNIT.read_text().replace("RestartSec=", "RestartSecs="), tmp_path)


def test_it_starts_without_network_and_comes_back() -> None:
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read_string(UNIT.read_text())
    assert not any("network" in value for section in unit.values() for value in section.values())
    assert unit["Service"]["Restart"] == "on-failure"
    assert unit["Install"]["WantedBy"] == "multi-user.target"
    assert unit["Service"]["ExecStart"].startswith(PROGRAM + " ")


def test_the_program_understands_the_command_of_the_unit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = next(line for line in UNIT.read_text().splitlines() if line.startswith("ExecStart="))
    missing = str(tmp_path / "rig.toml")
    arguments = [missing if word.endswith(".toml") else word for word in command.split()[1:]]
    assert missing in arguments
    assert main(arguments) == 2
    assert missing in capsys.readouterr().err


def test_kernels_may_be_compiled_and_devices_opened() -> None:
    text = UNIT.read_text()
    assert "\nMemoryDenyWriteExecute=" not in text
    assert "\nPrivateDevices=" not in text
