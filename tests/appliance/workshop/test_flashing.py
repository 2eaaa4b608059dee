"""What is copied onto the boards: exactly the firmware's files, with this instrument's USB identity and sync in one of them."""

from __future__ import annotations

import json
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from appliance.cli.main import main
from appliance.cli.output import Exit
from appliance.store.config import Rig, default_rig_path, load_rig, parse_rig
from appliance.workshop.finding import BringupError
from appliance.workshop.flashing import Part, firmware_files
from tests.support.golden_texts import Says

ROOT = Path(__file__).parents[3]
TEXT = default_rig_path().read_text(encoding="utf-8")
RIG = load_rig()
COMPACT = ROOT / "hw_sim" / "rigs" / "compact.toml"
PARTS: tuple[Part, ...] = ("board", "keys")


def values(content: bytes) -> dict[str, object]:
    found: dict[str, object] = {}
    exec(compile(content, "instrument.py", "exec"), {}, found)
    return {name: value for name, value in found.items() if not name.startswith("__")}


def written(part: Part, rig: Rig) -> dict[str, object]:
    return values(firmware_files(part, rig)[f"drivers/{part}/firmware/instrument.py"])


def shown(width_px: int, height_px: int, refresh_hz: float = 60.0) -> Rig:
    return replace(RIG, projector=replace(RIG.projector, width_px=width_px, height_px=height_px, refresh_hz=refresh_hz))


@pytest.mark.parametrize("part", PARTS)
def test_every_file_of_the_firmware_is_laid_out_and_no_cache(part: Part) -> None:
    folder = ROOT / "drivers" / part / "firmware"
    tracked = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", folder],
        cwd=ROOT, capture_output=True, text=True, check=True, timeout=20.0,
    ).stdout.split()  # fmt: skip
    if not tracked:
        pytest.skip("not in a git tree")
    files = firmware_files(part, RIG)
    assert files.pop("main.py") == (folder / "main.py").read_bytes()
    assert files.keys() == {name for name in tracked if not name.endswith("/main.py")}
    for name, content in files.items():
        assert content == (ROOT / name).read_bytes(), "for the packaged rig file it is the source tree's"


def test_another_instrument_has_its_own_identity_on_both_boards() -> None:
    rig = parse_rig(TEXT.replace("0x4B42", "0x0042").replace("0x4B46", "0x0046").replace("0x1209", "0xCAFE"))
    assert written("board", rig) == {"VENDOR": 0xCAFE, "PRODUCT": 0x42, "SYNC_RISES": False}
    assert written("keys", rig) == {"VENDOR": 0xCAFE, "PRODUCT": 0x46}


@pytest.mark.parametrize(
    ("mode", "rises"),
    [((640, 480, 59.94), False), ((800, 600, 60.32), True), ((1024, 768, 75.03), True), ((1280, 720, 59.94), True)],
)
def test_the_edge_follows_from_the_published_timing(mode: tuple[int, int, float], rises: bool) -> None:
    assert written("board", shown(*mode))["SYNC_RISES"] is rises


@pytest.mark.parametrize(("sync", "rises"), [("positive", True), ("negative", False)])
def test_what_the_rig_file_says_comes_before_the_mode(sync: str, rises: bool) -> None:
    for text in (TEXT, COMPACT.read_text(encoding="utf-8")):
        rig = parse_rig(text.replace("[projector]", f'[projector]\nsync = "{sync}"'))
        assert written("board", rig)["SYNC_RISES"] is rises


@pytest.mark.parametrize(("width_px", "height_px"), [(912, 1140), (1280, 800)])
def test_a_mode_of_either_sign_is_refused_with_the_key_to_set(width_px: int, height_px: int) -> None:
    with pytest.raises(BringupError, match=rf'{width_px}x{height_px} at 60 Hz .*sync = "negative" or "positive"'):
        firmware_files("board", shown(width_px, height_px))
    assert written("keys", shown(width_px, height_px))["PRODUCT"] == 0x4B46, "the pad sees no sync"


def test_it_is_laid_out_again_as_a_whole(tmp_path: Path, capsys: pytest.CaptureFixture[str], says: Says) -> None:
    out, rig = tmp_path / "made" / "board", tmp_path / "rig.toml"
    rig.write_text(TEXT)
    assert main(["setup", "firmware", "board", "--rig", str(rig), "--out", str(out)]) == Exit.OK
    says(capsys.readouterr().out)
    rig.write_text(TEXT.replace("0x4B42", "0x4B43"))
    (out / "main.py").unlink()
    assert main(["setup", "firmware", "board", "--rig", str(rig), "--out", str(out), "--json"]) == Exit.OK
    said = json.loads(capsys.readouterr().out)
    there = sorted(path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file())
    assert there == said["files"]
    assert values((out / "drivers/board/firmware/instrument.py").read_bytes())["PRODUCT"] == 0x4B43
    assert [path.name for path in out.parent.iterdir()] == ["board"], "nothing half-made stays"


def test_a_folder_with_something_else_in_it_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "thesis.txt").write_text("years")
    assert main(["setup", "firmware", "keys", "--out", str(tmp_path)]) == Exit.USAGE
    assert "thesis.txt, which is no file of this firmware" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]
