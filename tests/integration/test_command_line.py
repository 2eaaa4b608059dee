"""One dive by script, and then everything the command line can tell about what it left behind."""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from appliance.storage.lock import hold_lock
from appliance.storage.ply import read_ply

ROOT = Path(__file__).parents[2]
SMALL_RIG = ROOT / "hw_sim" / "rigs" / "small.toml"
DIVE = """
wait state AIM 90
press back            # UNCALIBRATED: seen
press scan
wait state REVIEW 60
pause 1
press scan            # keep
wait state AIM 60
press scan
wait state REVIEW 60
press back 1.2        # held: repeat: this one is not wanted
wait state AIM 60
end
"""


@dataclass(frozen=True)
class Said:
    """What a command did."""

    code: int
    out: str
    err: str

    @property
    def document(self) -> Any:
        return json.loads(self.out)

    @property
    def error(self) -> str:
        """The one line of the error; what was only a warning is not it."""
        errors = [line for line in self.err.splitlines() if "uncalibrated" not in line]
        assert len(errors) == 1, self.err
        return errors[0]


def kingfisher(*words: object, cwd: Path = ROOT, most_bytes: int | None = None) -> Said:
    """What the program said; it can make no file larger than ``most_bytes``."""
    done = subprocess.run(
        [sys.executable, "-m", "appliance.cli", *map(str, words)],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
        preexec_fn=None
        if most_bytes is None
        else partial(resource.setrlimit, resource.RLIMIT_FSIZE, (most_bytes,) * 2),
    )
    assert "Traceback" not in done.stderr, done.stderr
    return Said(done.returncode, done.stdout, done.stderr)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A storage root after a dive: one scan kept, one rejected."""
    folder = tmp_path_factory.mktemp("dive")
    script = folder / "dive.script"
    script.write_text(DIVE)
    options = ("--truth", "nominal", "--seed", 3, "--object", "frustum", "--script", script)
    said = kingfisher("sim", "--rig", SMALL_RIG, "--root", folder / "root", *options)
    assert said.code == 0, said.err
    assert said.out == "", "results only, and there are none"
    news = [line.removeprefix("kingfisher: ") for line in said.err.splitlines()]
    assert "AIM → ARMED (KeyPressed)" in news
    assert news[-1] == "switched off"
    return folder / "root"


@pytest.fixture
def copy(root: Path, tmp_path: Path) -> Path:
    """The scan that was kept, to be spoilt."""
    return Path(shutil.copytree(root / "scans" / "000001", tmp_path / "000001"))


# ----------------------------------------------------------------------------------- what is there


def test_the_scans_are_listed_shown_and_verified(root: Path) -> None:
    listed = kingfisher("scans", "list", "--root", root)
    assert listed.code == 0
    _, line = listed.out.splitlines()
    assert line.split()[:2] == ["000001", "saved"]
    listed = kingfisher("scans", "list", "--all", "--root", root, "--json")
    assert [(one["scan"], one["shelf"], one["ok"]) for one in listed.document] == [
        ("000001", "scans", True),
        ("000002", "rejected", True),
    ]
    shown = kingfisher("scans", "show", 1, "--root", root)
    lines = dict(one.split(None, 1) for one in shown.out.splitlines())
    assert lines["manifest.record.sequence.period_px"] == "16"
    assert lines["manifest.decision"] == "kept"
    points = kingfisher("scans", "show", 1, "--root", root, "--json").document["points"]
    assert lines["points"] == str(points)
    verified = kingfisher("scans", "verify", "--all", "--root", root)
    assert (verified.code, verified.out.splitlines()[-1]) == (0, "2 checked, 0 damaged")
    assert kingfisher("scans", "verify", "--root", root, "--json").document["checked"] == 1


def checked(folder: Path, *faults: str, change: Callable[[str], str] = str) -> dict[str, dict[str, Any]]:
    """What ``kingfisher check`` says of each device of a rig in which something is wrong; exit code 1 if it says so."""
    rig = folder / "rig.toml"
    text = change(SMALL_RIG.read_text(encoding="utf-8"))
    rig.write_text(text.replace("[rig.wires_options]", f"[rig.wires_options]\nfaults = {json.dumps(faults)}"))
    said = kingfisher("check", "--rig", rig, "--json")
    assert said.code == (0 if all(one["ok"] for one in said.document) else 1)
    return {one["device"]: one for one in said.document}


def test_the_simulated_devices_pass_the_check_and_identify_themselves() -> None:
    said = kingfisher("check", "--rig", SMALL_RIG)
    assert said.code == 0, said.out + said.err
    header, *lines = said.out.splitlines()
    assert header.split()[:4] == ["DEVICE", "SERIAL", "LINK", "FIRMWARE"]
    rows = {line.split()[0]: line.split()[1] for line in lines}
    assert rows == dict.fromkeys(["camera.left", "camera.right", "board", "keys", "projector", "display"], "ok")
    assert lines[0].split()[:6] == ["camera.left", "ok", "KF-CAM-L", "5000", "Mbit/s", "1.0"]


def test_the_check_names_what_is_wrong_with_each_device(tmp_path: Path) -> None:
    def other(text: str) -> str:
        """The rig wants another left camera than the one that is there, and another firmware of the board."""
        return text.replace('serial = "KF-CAM-L"', 'serial = "KF-CAM-7"').replace(
            "[board]", '[board]\nfirmware = "2.0"'
        )

    said = checked(tmp_path, "camera.right slow", "keypad off", change=other)
    assert [name for name, one in said.items() if not one["ok"]] == ["camera.left", "camera.right", "board", "keys"]
    assert "KF-CAM-7 not found" in said["camera.left"]["summary"]
    assert "KF-CAM-L" in said["camera.left"]["summary"]  # which is there in its place
    assert "480 Mbit/s" in said["camera.right"]["summary"]
    assert said["camera.right"]["details"]["serial"] == "KF-CAM-R"
    assert "firmware 1.4.2; the rig file wants 2.0" in said["board"]["summary"]
    assert all(". " in said[name]["summary"] for name in ("camera.left", "camera.right", "board", "keys"))  # a remedy


def test_a_device_that_does_not_answer_fails_the_check(tmp_path: Path) -> None:
    said = checked(tmp_path, "camera.right off")
    assert [name for name, one in said.items() if not one["ok"]] == ["camera.right"]
    assert "KF-CAM-R" in said["camera.right"]["summary"]


def test_the_check_leaves_a_running_instrument_alone(tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(SMALL_RIG.read_text().replace('root = "/var/tmp/kingfisher-sim"', f'root = "{tmp_path}"'))
    with hold_lock(tmp_path):
        said = kingfisher("check", "--rig", rig)
    assert said.code == 1
    assert f"is running (process {os.getpid()})" in said.error
    assert "systemctl stop kingfisher" in said.error


# ------------------------------------------------------------------------------- the same cloud again


def test_a_scan_is_reconstructed_to_the_same_points(root: Path, tmp_path: Path) -> None:
    made = kingfisher("reconstruct", 1, "--rig", SMALL_RIG, "--root", root, "--out", tmp_path / "again.ply", "--json")
    assert made.code == 0, made.err
    stored = read_ply(root / "scans" / "000001" / "cloud.ply")
    again = read_ply(tmp_path / "again.ply")
    assert made.document["points"] == len(stored.points_mm) > 10_000
    assert made.document["same_calibration"] is True
    assert np.array_equal(stored.points_mm, again.points_mm)
    plain = kingfisher("reconstruct", root / "scans" / "000001", "--rig", SMALL_RIG, "--root", root, cwd=tmp_path)
    assert plain.code == 0, plain.err
    lines = dict(one.split(None, 1) for one in plain.out.splitlines())
    assert lines["file"] == "000001.ply"
    assert lines["points"] == str(made.document["points"])
    assert (tmp_path / "000001.ply").read_bytes() == (tmp_path / "again.ply").read_bytes()


def test_a_rejected_scan_can_be_reconstructed_as_well(root: Path, tmp_path: Path) -> None:
    made = kingfisher("reconstruct", 2, "--rig", SMALL_RIG, "--root", root, "--out", tmp_path / "x.ply", "--json")
    assert made.code == 0, made.err
    assert made.document["points"] > 10_000


# --------------------------------------------------------------------------------------- what is wrong


def flip_a_bit(folder: Path) -> None:
    path = folder / "frames_right.npy"
    raw = bytearray(path.read_bytes())
    raw[5000] ^= 1
    path.write_bytes(raw)


def cut(folder: Path) -> None:
    path = folder / "frames_left.npy"
    path.write_bytes(path.read_bytes()[:1000])


def lose_manifest(folder: Path) -> None:
    (folder / "manifest.json").unlink()


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (flip_a_bit, ("frames_right.npy", "damaged", "copy")),
        (cut, ("frames_left.npy", "1000 bytes instead of 2880128")),
        (lose_manifest, ("manifest.json", "missing")),
    ],
)
def test_no_cloud_is_made_of_a_damaged_scan(
    spoil: Callable[[Path], None], words: tuple[str, ...], copy: Path, tmp_path: Path
) -> None:
    spoil(copy)
    out = tmp_path / "x.ply"
    said = kingfisher("reconstruct", copy, "--rig", SMALL_RIG, "--out", out, "--json")
    assert said.code == 1
    text = json.loads(said.error)["error"]
    for word in (str(copy), *words):
        assert word in text
    assert not out.exists()


def test_a_damaged_preview_keeps_nobody_from_the_raw_frames(copy: Path, tmp_path: Path) -> None:
    path = copy / "preview.png"
    path.write_bytes(bytes(len(path.read_bytes())))
    said = kingfisher("reconstruct", copy, "--rig", SMALL_RIG, "--out", tmp_path / "x.ply")
    assert said.code == 0, said.err


def test_frames_of_another_size_are_not_measured_with_this_calibration(root: Path, tmp_path: Path) -> None:
    """The drawing of 1600x1200 px would make an empty cloud of frames of 400x300, and call that done."""
    said = kingfisher("reconstruct", 1, "--root", root, "--out", tmp_path / "x.ply")
    assert said.code == 2
    for word in ("400x300", "1600x1200", "--rig", "--calibration"):
        assert word in said.error
    nominal = tmp_path / "nominal.json"
    assert kingfisher("calibration", "nominal", "--out", nominal).code == 0
    said = kingfisher("reconstruct", 1, "--rig", SMALL_RIG, "--root", root, "--calibration", nominal)
    assert said.code == 2
    assert str(nominal) in said.error


def test_a_disk_that_refuses_is_no_crash_and_half_a_cloud_does_not_stay(root: Path, tmp_path: Path) -> None:
    out = tmp_path / "cloud.ply"
    words = ("reconstruct", 1, "--rig", SMALL_RIG, "--root", root, "--out")
    said = kingfisher(*words, out, most_bytes=100_000)
    assert said.code == 1
    assert said.error.startswith(f"kingfisher: cannot write {out}: File too large")
    assert "--out" in said.error
    assert list(tmp_path.iterdir()) == []
    said = kingfisher(*words, "/dev/null")
    assert (said.code, "no ordinary file" in said.error) == (2, True)


def test_a_calibration_is_never_replaced(tmp_path: Path) -> None:
    for out in ((), ("--out", tmp_path / "x.json")):
        first = kingfisher("calibration", "nominal", "--rig", SMALL_RIG, "--root", tmp_path, *out, "--json")
        assert first.code == 0, first.err
        path = Path(first.document["file"])
        before = path.read_bytes()
        again = kingfisher("calibration", "nominal", "--rig", SMALL_RIG, "--root", tmp_path, *out)
        assert again.code == 2
        assert str(path) in again.error
        assert path.read_bytes() == before
    said = kingfisher("calibration", "nominal", "--out", tmp_path / "no" / "x.json")
    assert (said.code, "no folder" in said.error) == (2, True)


def test_an_unusable_target_is_refused_before_the_work(root: Path, tmp_path: Path) -> None:
    for out, word in ((tmp_path / "no" / "x.ply", "no folder"), (tmp_path, "is a folder")):
        said = kingfisher("reconstruct", 1, "--rig", SMALL_RIG, "--root", root, "--out", out)
        assert said.code == 2
        assert said.error.startswith(f"kingfisher: --out {out}:")
        assert word in said.error


def test_an_unknown_scan_and_an_unknown_root(root: Path, tmp_path: Path) -> None:
    for verb in (("scans", "show"), ("scans", "verify"), ("reconstruct", "--rig", SMALL_RIG)):
        said = kingfisher(*verb, 77, "--root", root)
        assert (said.code, "'77'" in said.error, "scans list" in said.error) == (1, True, True)
        said = kingfisher(*verb, 1, "--root", tmp_path / "none")
        assert (said.code, "--root" in said.error) == (2, True)


# --------------------------------------------------------------------------------------------- sim


@pytest.mark.parametrize(
    ("script", "code", "words"),
    [
        ("press fire", 2, ("line 1: press fire", "allowed are scan, back, up, down")),
        ("wait state REVIEW 1", 3, ("line 1: wait state REVIEW 1", "after 1 s the state is")),
    ],
)
def test_a_script_says_at_which_line_it_failed(script: str, code: int, words: tuple[str, ...], tmp_path: Path) -> None:
    path = tmp_path / "dive.script"
    path.write_text(script + "\n")
    said = kingfisher("sim", "--rig", SMALL_RIG, "--root", tmp_path / "root", "--script", path)
    assert said.code == code
    last = said.err.splitlines()[-1]
    for word in words:
        assert word in last


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--fault", "camera.left explode"), ("camera.left explode", "supported: camera.left|right intermittent")),
        (("--truth", SMALL_RIG), ("truth", "small.toml", "nominal, realistic")),
        (("--rig", ROOT / "appliance" / "rigs" / "kingfisher.toml"), ("drivers.native:open", "kingfisher run")),
    ],
)
def test_an_option_that_the_world_refuses_is_wrong_usage(
    options: tuple[object, ...], words: tuple[str, ...], tmp_path: Path
) -> None:
    said = kingfisher("sim", "--rig", SMALL_RIG, "--root", tmp_path / "root", *options)
    assert said.code == 2
    for word in words:
        assert word in said.error
