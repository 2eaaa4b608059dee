"""The diver plays a script, knows the product only by its status file, and a failure is never silent."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import pytest

from hw_sim.people.script import ScriptError, parse_script
from hw_sim.wires import ScriptFailedError, SimWires
from hw_sim.wires import open as open_wires
from tests.hw_sim.conftest import SMALL


def write_status(path: Path, state: str, *alerts: str) -> None:
    path.write_text(json.dumps({"state": state, "alerts": [{"code": code} for code in alerts]}))


@contextmanager
def playing(tmp_path: Path, script: str, state: str = "AIM") -> Iterator[tuple[SimWires, Path]]:
    """Wires with a diver, and the status file he watches."""
    status = tmp_path / "status.json"
    write_status(status, state)
    (tmp_path / "dive.txt").write_text(script)
    options = {**SMALL, "world": "dive", "script": str(tmp_path / "dive.txt"), "status": str(status)}
    with open_wires({**options, "idle_speed": 20.0}) as wires:
        yield wires, status


def until(condition: Callable[[], bool], real_s: float = 5.0) -> None:
    deadline_s = time.monotonic() + real_s
    while not condition():
        assert time.monotonic() < deadline_s, "it does not happen"
        time.sleep(0.002)


def test_it_waits_presses_and_breaks_things(tmp_path: Path) -> None:
    script = """
    # a dive
    wait state AIM 30      # comment
    pause 0.5
    press up
    press down 0.9
    fault keypad off
    wait state REVIEW 30
    clear
    object plane 0 0 500 0 20 0
    wait alert LEAK 30
    """
    with playing(tmp_path, script) as (wires, status):
        seen = keys_seen_until_lost(wires)
        assert [key for key in dict.fromkeys(seen) if key] == [4, 8]
        until(lambda: wires.hidraw.enumerate() == [])
        write_status(status, "REVIEW")
        until(lambda: wires.hidraw.enumerate() != [])
        until(lambda: wires._world.scene.object == "plane")
        assert wires._world.scene.pose == (0.0, 0.0, 500.0, 0.0, 20.0, 0.0)
        write_status(status, "REVIEW", "LEAK")


def keys_seen_until_lost(wires: SimWires) -> list[int]:
    device = wires.hidraw.device()
    device.open_path(wires.hidraw.enumerate()[0]["path"])
    seen: list[int] = []
    try:
        while True:
            report = device.read(8, 20_000)
            seen.append(report[1])
    except OSError:
        return seen


def test_the_power_off_gesture_is_repeated_until_the_service_goes(tmp_path: Path) -> None:
    with playing(tmp_path, "end") as (wires, status):
        device = wires.hidraw.device()
        device.open_path(wires.hidraw.enumerate()[0]["path"])
        held_ms: list[int] = []
        since_ms: int | None = None
        while len(held_ms) < 3:
            report = device.read(8, 5000)
            now_ms = report[4] | report[5] << 8
            if report[1] == 2 and since_ms is None:
                since_ms = now_ms
            elif report[1] == 0 and since_ms is not None:
                if now_ms - since_ms > 100:  # not a bounce
                    held_ms.append(now_ms - since_ms)
                since_ms = None
        write_status(status, "SHUTDOWN")
    assert min(held_ms) > 800


def test_a_wait_that_fails_ends_the_dive_and_is_raised(tmp_path: Path) -> None:
    said = r"line 1: wait state REVIEW 2: after 2 s the state is AIM; alerts: LEAK;"

    def dive() -> None:
        with playing(tmp_path, "wait state REVIEW 2\nend") as (wires, status):
            write_status(status, "AIM", "LEAK")
            until(lambda: wires._world.keypad.keys == 2, 20)  # the gesture, so that the service ends
            write_status(status, "SHUTDOWN")

    with pytest.raises(ScriptFailedError, match=said):
        dive()


def test_a_service_that_ends_too_early_is_a_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hw_sim.wires.in_process.SCRIPT_GRACE_S", 0.1)
    with (
        pytest.raises(ScriptFailedError, match="the service ended before the script did"),
        playing(tmp_path, "wait state REVIEW 1000"),
    ):
        pass


def test_an_error_of_the_service_is_not_hidden_by_the_script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hw_sim.wires.in_process.SCRIPT_GRACE_S", 0.1)
    with pytest.raises(KeyError), playing(tmp_path, "wait state REVIEW 1000"):
        raise KeyError("service")


def test_no_thread_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hw_sim.wires.in_process.SCRIPT_GRACE_S", 0.1)
    before = set(threading.enumerate())
    with pytest.raises(ScriptFailedError), playing(tmp_path, "pause 10000"):
        assert {t.name for t in set(threading.enumerate()) - before} >= {"diver", "world"}
    assert set(threading.enumerate()) <= before


def test_a_screenshot_is_the_display(tmp_path: Path) -> None:
    picture = tmp_path / "a folder  with blanks" / "screen.png"
    picture.parent.mkdir()
    with playing(tmp_path, f"screenshot {picture}"):
        until(picture.exists)
    written = cv2.imread(str(picture))
    assert written is not None
    assert written.shape == (480, 800, 3)


def test_a_screenshot_that_cannot_be_written_fails_the_script(tmp_path: Path) -> None:
    with (
        pytest.raises(ScriptFailedError, match="line 1: screenshot"),
        playing(tmp_path, f"screenshot {tmp_path}/nowhere/screen.png", state="SHUTDOWN"),
    ):
        pass


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("jump", "line 1: jump: allowed are: wait|never state|"),
        ("wait state AIM", "allowed are"),
        ("wait mood GOOD 3", "'mood' cannot be waited for; allowed are state, alert, gone"),
        ("never label scan 3", "'label' takes 2 words or more"),
        (
            "disk slow",
            "'disk slow'; allowed are disk fill, disk off, disk on, disk spare, power cut, worker hang, worker kill",
        ),
        ("wait state AIM soon", "could not convert string to float: 'soon'"),
        ("pause -1", "'-1' is no duration"),
        ("press left", "key 'left'; allowed are scan, back, up, down"),
        ("press scan 1 2", "allowed are"),
        ("fault camera.left explode", "not supported; supported: "),
        ("object plane 1 2", "allowed are"),
        ("end now", "allowed are"),
        ("follow 25", "allowed are"),
        ("follow 0 30", "a step of 0 mm; allowed are 0..100"),
        ("follow 25 -1", "'-1' is no duration"),
        ("water attenuation_per_m=50", "attenuation_per_m = 50.0; allowed are 0..20"),
        ("motion velocity_mm_s=3", "velocity_mm_s = (3.0,); give three finite numbers"),
        ("daylight flicker=1", "'flicker=1' is not understood; allowed are off, or any of flicker_depth"),
        ("daylight torch=bright", "daylight torch = 'bright'; give a number"),
        ("daylight", "what of it?"),
        ("drift bubbles=1.5", "drift bubbles = '1.5'; give a whole number"),
    ],
)
def test_a_script_is_checked_before_it_is_played(line: str, said: str) -> None:
    with pytest.raises(ScriptError) as caught:
        parse_script(f"{line}\npause 1")
    assert said in str(caught.value)
