"""Who stands in a dive's folder, or has named one, need not say `--root`; who does neither is told where was looked."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from appliance.calibration.file import encode
from appliance.cli import main
from appliance.config import default_rig_path, load_rig
from appliance.instrument import CALIBRATION_FILE, design_of
from appliance.offline.scripting import open_dive
from appliance.storage.library import Library
from tests.appliance.storage.scenes import ORIGIN, PREVIEW, cloud, frames, record


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A root with one scan and a calibration of another instrument than the packaged rig file's."""
    root = tmp_path / "dive"
    library = Library(root)
    library.prepare()
    library.begin(frames(1), record(), ORIGIN).publish(record(cloud={"points": 20}), cloud(), PREVIEW)
    made = replace(design_of(load_rig(default_rig_path())), rig_serial="KF-0042", method="bundle")
    (root / CALIBRATION_FILE).parent.mkdir()
    (root / CALIBRATION_FILE).write_bytes(encode(made))
    return root


def listed(capsys: pytest.CaptureFixture[str]) -> list[str]:
    assert main(["scans", "list", "--json"]) == 0
    return [one["folder"] for one in json.loads(capsys.readouterr().out)]


def test_the_root_is_the_one_that_somebody_stands_in(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    scan = root / "scans" / "000001"
    monkeypatch.setenv("KINGFISHER_ROOT", str(tmp_path / "not looked at"))
    for inside in (root, root / "scans", scan):
        monkeypatch.chdir(inside)
        assert listed(capsys) == [str(scan)]
        assert open_dive().root == root
    assert main(["calibration", "show", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rig_serial"] == "KF-0042"


def test_the_root_is_that_of_the_environment_where_nobody_stands_in_one(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "elsewhere" / "scans").mkdir(parents=True)  # anybody's folder of that name is no root
    monkeypatch.chdir(tmp_path / "elsewhere")
    monkeypatch.setenv("KINGFISHER_ROOT", str(root))
    assert listed(capsys) == [str(root / "scans" / "000001")]
    assert [scan.name for scan in open_dive()] == ["000001"]
    assert main(["reconstruct", "7"]) == 1
    assert f"no scan '7' under {root}; `kingfisher scans list --all --root {root}`" in capsys.readouterr().err
    monkeypatch.setenv("KINGFISHER_ROOT", str(tmp_path / "gone"))
    assert main(["scans", "list"]) == 2
    assert f"KINGFISHER_ROOT={tmp_path / 'gone'}: no such folder" in capsys.readouterr().err


@pytest.mark.parametrize("verb", [["scans", "list"], ["reconstruct", "1"], ["object", "show", "thing"]])
def test_where_there_is_no_root_it_is_said_where_was_looked(
    verb: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    default = load_rig(default_rig_path()).storage.root
    if default.exists():
        pytest.skip(f"this computer has {default}, as an instrument does")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("KINGFISHER_ROOT", raising=False)
    assert main(verb) == 2
    error = capsys.readouterr().err
    for where in ("the folder you stand in", "KINGFISHER_ROOT is not set", str(default), "--root PATH"):
        assert where in error
    with pytest.raises(NotADirectoryError, match="KINGFISHER_ROOT is not set"):
        open_dive()


def test_the_calibration_of_a_root_is_shown_without_its_rig_file(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # The packaged rig file draws KF-0001: that drawing was shown instead.
    assert main(["calibration", "show", "--root", str(root), "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert (shown["rig_serial"], shown["method"]) == ("KF-0042", "bundle")
    (root / CALIBRATION_FILE).unlink()
    assert main(["calibration", "show", "--root", str(root)]) == 1
    assert str(root / CALIBRATION_FILE) in capsys.readouterr().err
