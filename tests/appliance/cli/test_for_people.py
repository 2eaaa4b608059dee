"""What a stranger types first at the desk gets one clear line: a wrong root, garbage, a disk that refuses."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from appliance.cli.output import format_number, format_value, say_report
from appliance.store.lock import hold_lock
from tests.support.commands import Shell


def error_of(argv: list[str], capsys: pytest.CaptureFixture[str], code: int = 2) -> str:
    """The one line of the error."""
    said = Shell(capsys)(*argv)
    assert said.code == code
    return said.error


def test_garbage_as_a_script_is_one_line_and_no_traceback(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    script = tmp_path / "garbage.bin"
    script.write_bytes(np.random.default_rng(1).bytes(100_000))
    said = Shell(capfd)("sim", "--script", script, "size=400x300", "--root", tmp_path / "root")
    assert (said.code, "garbage.bin: byte" in said.err.splitlines()[-1]) == (2, True)


@pytest.mark.parametrize("verb", [["run"], ["sim"], ["scans", "list"], ["cloud", "1"]])
def test_a_file_as_storage_root_is_called_a_file(
    verb: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "garbage"
    file.write_bytes(b"\x00\x01")
    assert f"--root {file}: is a file" in error_of([*verb, "--root", str(file)], capsys)


def test_the_instrument_runs_on_a_root_of_its_own_and_a_board_that_begins_with_a_minus_is_a_board(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """At a developer's desk it must not make /var/lib/kingfisher; a taken root shows that the given one is used."""
    with hold_lock(tmp_path):
        assert f"cannot use {tmp_path}" in error_of(["run", "--root", str(tmp_path)], capfd, 1)
    error = error_of(["calibration", "air", str(tmp_path), "--board", "-5x3x1x1"], capfd)
    assert ("expected one argument" in error, "-5x3x1x1" in error) == (False, True)


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of its own of 1 MB; skipped where this user may not mount one."""
    place = tmp_path / "disk"
    place.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=1m", "none", str(place)]
    if subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip("this user may not mount a disk")
    try:
        yield place
    finally:
        subprocess.run(["umount", "-l", str(place)], check=True, timeout=20)


def test_a_disk_that_takes_no_changes_and_a_full_one_are_told_apart(
    disk: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    run = ["run", "--root", str(disk / "root")]
    subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True, timeout=20)
    assert "mounted read-only" in error_of(run, capfd, 1)
    subprocess.run(["mount", "-o", "remount,rw", str(disk)], check=True, timeout=20)
    with suppress(OSError), (disk / "fill").open("wb") as fill:
        fill.write(bytes(1 << 22))
    assert "the disk is full" in error_of(run, capfd, 1)


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("coverage_percent", 96.17322585302021, "96.17"), ("coverage_percent", 0.012345, "0.01235"), ("points", 207846.0, "207846"), ("points", 207846, "207846"),
        ("noise_mm", 0.024891234, "0.02489"), ("distance_mm", 500.12849, "500.1"), ("baseline_mm", 229.87654321, "229.877"), ("water_index", 1.334712345, "1.33471"),
        ("principal_distance_px", 2555.55512, "2555.56"), ("residual_px", 0.0, "0"), ("shift", -12345.678, "-12346"), ("warnings", [], "none"),
        ("warnings", ["A: b", "C: d"], "A: b; C: d"), ("same_calibration", False, "no"), ("hash", "ab" * 32, "abababababab"), ("residual_px", None, "-"),
        ("waters", {"temperature_c": 20.123456}, "temperature_c 20.12"),
    ],
)  # fmt: skip
def test_numbers_are_rounded_to_what_they_mean(key: str, value: object, text: str) -> None:
    assert format_value(key, value) == text


def test_rounding_never_changes_a_number_by_more_than_its_digits_and_names_stand_in_a_column(
    capsys: pytest.CaptureFixture[str],
) -> None:
    chance = np.random.default_rng(3)
    for value in chance.normal(0, 1, 200) * 10.0 ** chance.integers(-6, 9, 200):
        assert float(format_number("noise_mm", float(value))) == pytest.approx(float(value), rel=6e-4)
    say_report({"points": 12.0, "a_name_that_is_longer_than_the_others": 1.23456})
    first, second = capsys.readouterr().out.splitlines()
    assert first.split() == ["points", "12"]
    assert first.index("12") == second.index("1.235")
