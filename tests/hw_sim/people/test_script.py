"""The diver plays a script, knows the product only by its status file, and a failure is never silent; deeds do what they say."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest

from hw_sim.faults import FaultSyntaxError
from hw_sim.optics.beamer import Beamer
from hw_sim.people import status_file
from hw_sim.people.commands import check, do
from hw_sim.people.script import ScriptError, parse_script
from hw_sim.rendering.render import LightSlice, Renderer
from hw_sim.wires import ScriptFailedError, SimWires
from hw_sim.wires import open as open_wires
from hw_sim.world import World, WorldOptions
from tests.hw_sim.conftest import SMALL

STATUS = {
    "state": "AIM", "alerts": [{"code": "FRAME_MISSING", "headline": "INCOMPLETE 23/24", "action": "REPEAT"}],
    "keys": {"scan": "REPEAT"}, "devices": {"keys": "lost"}, "scans": 3,
    "guidance": {"words": "50 %: SCAN NOW", "toward": None}, "calibration": None,
}  # fmt: skip


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


def until(condition: Callable[[], bool], real_s: float = 20.0) -> None:
    deadline_s = time.monotonic() + real_s
    while not condition():
        assert time.monotonic() < deadline_s, "it does not happen"
        time.sleep(0.002)


DIVE = """
# a dive
wait state AIM 30      # comment
press up
press down 0.9
fault keypad off
wait state REVIEW 30
clear
object plane 0 0 500 0 20 0
wait alert LEAK 30
"""


def test_it_waits_presses_and_breaks_things(tmp_path: Path) -> None:
    with playing(tmp_path, DIVE) as (wires, status):
        device = wires.hidraw.device()
        device.open_path(wires.hidraw.enumerate()[0]["path"])
        seen: list[int] = []
        with suppress(OSError):  # the key pad is off
            while True:
                seen.append(device.read(8, 20_000)[1])
        assert [key for key in dict.fromkeys(seen) if key] == [4, 8]
        write_status(status, "REVIEW")
        until(lambda: wires.hidraw.enumerate() != [])
        until(lambda: wires._world.scene.object == "plane")
        assert wires._world.scene.pose == (0.0, 0.0, 500.0, 0.0, 20.0, 0.0)
        write_status(status, "REVIEW", "LEAK")


@pytest.mark.parametrize("error", [None, KeyError("service")])
def test_a_wait_that_fails_or_a_service_that_ends_too_early_is_raised_and_hides_no_other_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception | None
) -> None:
    def dive() -> None:
        with playing(tmp_path, "wait state REVIEW 2\nend") as (wires, status):
            write_status(status, "AIM", "LEAK")
            until(lambda: wires._world.keypad.keys == 2)  # the gesture, so that the service ends
            write_status(status, "SHUTDOWN")

    with pytest.raises(ScriptFailedError, match=r"line 1: .*after 2 s the state is AIM; alerts: LEAK"):
        dive()
    monkeypatch.setattr("hw_sim.wires.in_process.SCRIPT_GRACE_S", 0.1)

    def serve() -> None:
        with playing(tmp_path, "wait state REVIEW 1000"):
            if error is not None:
                raise error

    with pytest.raises(ScriptFailedError if error is None else KeyError):
        serve()


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("jump", "wait|never state|"),
        ("wait state AIM", "allowed are"),
        ("wait mood GOOD 3", "'mood'"),
        ("never label scan 3", "2 words or more"),
        ("disk slow", "disk fill, disk off, disk on, disk spare, power cut, worker hang, worker kill"),
        ("wait state AIM soon", "'soon'"),
        ("pause -1", "'-1'"),
        ("press left", "scan, back, up, down"),
        ("fault camera.left explode", "supported"),
        ("object plane 1 2", "allowed are"),
        ("follow 0 30", "0..100"),
        ("water attenuation_per_m=50", "0..20"),
        ("motion velocity_mm_s=3", "three finite numbers"),
        ("daylight torch=bright", "give a number"),
        ("daylight", "no amount"),
        ("drift bubbles=1.5", "whole number"),
        ("cap middle on", "allowed are"),
        ("projector brightness=3", "allowed"),
    ],
)
def test_a_script_is_checked_before_it_is_played(line: str, named: str) -> None:
    with pytest.raises(ScriptError, match=f"^line 1: .*{re.escape(named)}"):
        parse_script(f"{line}\npause 1")


@pytest.mark.parametrize(
    ("seen", "not_seen"),
    [
        ("state AIM", "state REVIEW"),
        ("alert FRAME_MISSING", "alert LEAK"),
        ("gone LEAK", "gone FRAME_MISSING"),
        ("headline INCOMPLETE 23/24", "headline INCOMPLETE 22/24"),
        ("headline INCOMPLETE *", "headline COMPLETE *"),
        ("action REPEAT", "action REPEA"),
        ("label scan REPEAT", "label back REPEAT"),
        ("device keys lost", "device board lost"),
        ("scans 3", "scans 4"),
        ("guidance *SCAN NOW", "guidance *GO BACK"),
    ],
)
def test_what_is_there_is_seen_and_nothing_else(seen: str, not_seen: str) -> None:
    for sentence, there in ((seen, True), (not_seen, False)):
        kind, *words = sentence.split()
        status_file.check(kind, words)
        assert status_file.is_met(STATUS, kind, words) is there
        assert not status_file.is_met({}, kind, words), "without a status not even that an alert is gone"


def test_caps_the_projectors_menu_and_one_thing_that_is_mended() -> None:
    with World(WorldOptions(**{**SMALL, "world": "deeds", "projector": "repeats"})) as world:

        def say(line: str) -> None:
            verb, *words = line.split()
            assert check(verb, tuple(words))
            do(world, verb, tuple(words), Path("nowhere"))

        def light(side: str) -> float:
            white = [LightSlice(np.full((768, 1024), 255, np.uint8), 0.012)]
            return float(Renderer(world.truth, world.scene).light(side, white, 0.0, 0.012, (False, False)).mean())

        say("cap left on")
        assert (light("left"), light("right") > 100.0) == (0.0, True)
        say("cap left off")
        assert light("left") > 100.0
        say("projector mirrored=true gamma=2.2 latency_blanks=2")
        assert world.projector_truth.beamer == Beamer("repeats", mirrored=True, gamma=2.2, latency_blanks=2)
        say("projector mirrored=off gamma=off latency_blanks=off")
        assert world.projector_truth.beamer == Beamer("repeats")
        for sentence in ("laser.left off", "laser.right stuck", "sensor.TPROJ off"):
            say(f"fault {sentence}")
        say("mend laser.left off")
        assert world.broken == ("laser.right stuck", "sensor.TPROJ off")
        with pytest.raises(FaultSyntaxError, match="no such fault"):
            say("mend laser.left off")
