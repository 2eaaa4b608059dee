"""What a stranger types first at the desk gets one clear line: a wrong suffix, a wrong root, garbage, a disk that refuses."""

from __future__ import annotations

import errno
import os
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from appliance.cli import main
from appliance.cli.listing import number, say_report, shown
from appliance.storage.atomic import StorageError, refused, remedy_for
from appliance.storage.lock import hold_lock


def code_of(argv: list[str]) -> int:
    try:
        return main(argv)
    except SystemExit as end:
        return int(end.code or 0)


def error_of(argv: list[str], capsys: pytest.CaptureFixture[str], code: int = 2) -> str:
    assert code_of(argv) == code
    error = capsys.readouterr().err
    assert error.count("\n") == 1, error
    return error


@pytest.mark.parametrize("verb", [["reconstruct", "1"], ["scans", "merge", "1", "2"]])
@pytest.mark.parametrize("name", ["c.stl", "c", "c.ply.gz", "c.obj"])
def test_a_cloud_is_not_written_under_a_name_that_promises_another_format(
    verb: list[str], name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    error = error_of([*verb, "--root", str(tmp_path), "--out", str(tmp_path / name)], capsys)
    assert "a cloud is written as PLY" in error
    assert "allowed: .ply" in error
    assert not (tmp_path / name).exists()


def test_garbage_as_a_script_is_one_line_and_no_traceback(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    script = tmp_path / "garbage.bin"
    script.write_bytes(np.random.default_rng(1).bytes(100_000))
    size = ["--size", "400x300", "--root", str(tmp_path / "root")]
    code = code_of(["sim", "--script", str(script), *size])
    last = capfd.readouterr().err.splitlines()[-1]
    assert code == 2
    assert "garbage.bin: byte" in last
    assert "is not UTF-8; a script is a text file" in last


@pytest.mark.parametrize("verb", [["run"], ["sim"], ["scans", "list"], ["reconstruct", "1"]])
def test_a_file_as_storage_root_is_called_a_file(
    verb: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "garbage"
    file.write_bytes(b"\x00\x01")
    error = error_of([*verb, "--root", str(file)], capsys)
    assert f"--root {file}: is a file; give " in error


def test_the_instrument_runs_on_a_root_of_its_own(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """At a developer's desk it must not make /var/lib/kingfisher; a taken root shows that the given one is used."""
    with hold_lock(tmp_path):
        error = error_of(["run", "--root", str(tmp_path)], capfd, 1)
    assert f"cannot use {tmp_path}: another instance" in error


def test_a_board_that_begins_with_a_minus_is_judged_as_a_board(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    error = error_of(["calibrate", "air", str(tmp_path), "--board", "-5x3x1x1"], capsys)
    assert "expected one argument" not in error
    assert "-5x3x1x1" in error


@pytest.mark.parametrize(
    ("number_of_error", "words"),
    [
        (errno.ENOSPC, "the disk is full: free space"),
        (errno.EDQUOT, "share of the disk"),
        (errno.EROFS, "mounted for reading only: mount it for writing"),
        (errno.EACCES, "check the owner and the mode"),
        (errno.EPERM, "check the owner and the mode"),
        (errno.ENOTDIR, "a part of the path is a file"),
        (errno.EIO, "the disk fails"),
    ],
)
def test_each_refusal_of_a_disk_gets_its_own_remedy(number_of_error: int, words: str) -> None:
    path = Path("/somewhere")
    with pytest.raises(StorageError, match=words) as caught, refused("cannot make", path):
        raise OSError(number_of_error, os.strerror(number_of_error))
    assert str(caught.value).startswith(f"cannot make /somewhere: {os.strerror(number_of_error)}; ")
    assert words in remedy_for(OSError(number_of_error, ""))


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of its own of 1 MB; skipped where this user may not mount one."""
    place = tmp_path / "disk"
    place.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=1m", "none", str(place)], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip("this user may not mount a disk")
    try:
        yield place
    finally:
        subprocess.run(["umount", "-l", str(place)], check=True, timeout=20)


def test_a_disk_that_takes_no_changes_and_a_full_one_are_told_apart(
    disk: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    root = disk / "root"
    subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True, timeout=20)
    error = error_of(["run", "--root", str(root)], capfd, 1)
    assert "Read-only file system; the file system is mounted for reading only: mount it for writing" in error
    subprocess.run(["mount", "-o", "remount,rw", str(disk)], check=True, timeout=20)
    with suppress(OSError), (disk / "fill").open("wb") as fill:
        fill.write(bytes(1 << 22))
    error = error_of(["run", "--root", str(root)], capfd, 1)
    assert "No space left on device; the disk is full: free space on it" in error


def test_a_root_below_a_file_is_refused_with_the_path_to_mend(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="a part of the path is a file"), hold_lock(tmp_path / "file"):
        pass


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("coverage_percent", 96.17322585302021, "96.17"),
        ("coverage_percent", 0.012345, "0.01235"),
        ("points", 207846.0, "207846"),
        ("points", 207846, "207846"),
        ("noise_mm", 0.024891234, "0.02489"),
        ("distance_mm", 500.12849, "500.1"),
        ("baseline_mm", 229.87654321, "229.877"),
        ("water_index", 1.334712345, "1.33471"),
        ("principal_distance_px", 2555.55512, "2555.56"),
        ("residual_px", 0.0, "0"),
        ("shift", -12345.678, "-12346"),
        ("warnings", [], "none"),
        ("warnings", ["A: b", "C: d"], "A: b; C: d"),
        ("same_calibration", False, "no"),
        ("hash", "ab" * 32, "abababababab"),
        ("residual_px", None, "-"),
        ("waters", {"temperature_c": 20.123456}, "temperature_c 20.12"),
    ],
)
def test_numbers_are_rounded_to_what_they_mean(key: str, value: object, text: str) -> None:
    assert shown(key, value) == text


def test_rounding_never_changes_a_number_by_more_than_its_digits() -> None:
    chance = np.random.default_rng(3)
    for value in chance.normal(0, 1, 500) * 10.0 ** chance.integers(-6, 9, 500):
        assert float(number("noise_mm", float(value))) == pytest.approx(float(value), rel=6e-4)


def test_a_listing_has_its_names_in_a_column(capsys: pytest.CaptureFixture[str]) -> None:
    say_report({"points": 12.0, "a_name_that_is_longer_than_the_others": 1.23456}, as_json=False)
    first, second = capsys.readouterr().out.splitlines()
    assert first.split() == ["points", "12"]
    assert first.index("12") == second.index("1.235")


def test_help_names_no_file_that_an_installation_does_not_have(capsys: pytest.CaptureFixture[str]) -> None:
    verbs = [[], ["run"], ["sim"], ["evaluate"], ["scans"], ["scans", "merge"], ["scans", "verify"], ["measure"],
             ["measure", "response"], ["health"], ["health", "show"], ["calibrate"], ["calibrate", "water"]]  # fmt: skip
    for verb in verbs:
        assert code_of([*verb, "--help"]) == 0
        text = " ".join(capsys.readouterr().out.split())
        assert "docs/" not in text, verb
        assert "exit codes: 0 ok, 1 failed, 2 usage" in text
        assert ("3 script failed" in text) == (verb in ([], ["sim"]))
        assert ("4 damaged" in text) == (verb in ([], ["scans", "verify"]))
