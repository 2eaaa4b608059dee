"""What is typed or scripted for the simulated world, and the status file that it reads."""

from __future__ import annotations

import functools
import json
import math
from dataclasses import fields
from pathlib import Path
from random import Random
from typing import Any

from hw_sim.faults import KINDS, PARTS, FaultSyntaxError
from hw_sim.faults import parse as parse_fault
from hw_sim.mount_shift import AMOUNTS, MountShiftError
from hw_sim.mount_shift import parse as parse_knock
from hw_sim.people import commands, status_file
from hw_sim.people.commands import SURROUNDINGS
from hw_sim.people.commands import changed as with_amounts
from hw_sim.people.console import Console
from hw_sim.people.script import ScriptError, parse_script
from hw_sim.timing import calendar
from hw_sim.world import World, WorldOptions
from tests.fuzz.damage import changed, damaged, reworded
from tests.fuzz.target import Target

FAULTS = (
    "camera.left off at_s=3 for_s=2", "camera.right garbage how=truncate frame=9 count=2", "projector delayed frame=3",
    "sensor.TPROJ wrong amount=81.5", "camera.left delayed amount=2", "board wrong how=reset", "key.scan stuck for_s=9", "leak wrong",
)  # fmt: skip
FAULT_WORDS = (
    *(name for name, _ in KINDS), *(verb for _, verb in KINDS), *(f"{name}.{part}" for name, parts in PARTS.items() for part in parts),
    "how=truncate", "how=repeat", "frame=3", "at_s=0", "for_s=1", "count=2", "amount=4",
)  # fmt: skip
KNOCKS = ("left yaw_deg=0.5 x_mm=0.3", "right pitch_deg=-0.1 z_mm=2", "left roll_deg=1")
KNOCK_WORDS = ("left", "right", *(f"{name}=1" for name in AMOUNTS))
SCRIPT = """\
# a dive
wait state AIM 60
press scan
press back 1.2
wait label SCAN KEEP 10
never state CAPTURE 1
pause 0.5
fault camera.left off for_s=2
knock left yaw_deg=0.2
water attenuation_per_m=1.5
motion off
object plane 0 0 500 0 0 0
disk off
date 1970-01-01T00:00:07
date +3600.5
worker kill
screenshot /tmp/a b.png
clear
end
"""
SCRIPT_WORDS = (
    "wait",
    "never",
    "press",
    "pause",
    "fault",
    "knock",
    "object",
    "scan",
    "state",
    "end",
    "clear",
    "off",
    "date",
    "-1e9",
    "kept",
    "2106-01-01",
    *SURROUNDINGS,
)


def _script(chance: Random) -> str:
    lines = SCRIPT.splitlines()
    for _ in range(chance.randrange(1, 4)):
        at = chance.randrange(len(lines))
        lines[at] = reworded(chance, lines[at], (*SCRIPT_WORDS, *FAULT_WORDS))
    chosen = [line for line in lines if chance.random() < 0.4] or lines
    text = "\n".join(chosen)
    return (
        damaged(chance, text.encode("utf-8", "surrogatepass")).decode("utf-8", "replace")
        if chance.random() < 0.2
        else text
    )


LINES = tuple(line for line in SCRIPT.splitlines() if line.split()[0] in commands.HELP)


def _deed(line: str, _: Path) -> None:
    verb, *words = line.split("#", 1)[0].split() or [""]
    known = commands.check(verb, tuple(words))
    if known and verb == "date":
        try:
            assert calendar.changed(calendar.Date(calendar.FIRST, kept=True), words[0]).utc >= calendar.FIRST
        except ValueError:
            return  # it leads out of the computer's time from there
    if known and verb in SURROUNDINGS:
        before: Any = SURROUNDINGS[verb]
        for one in fields(before):
            old, new = getattr(before, one.name), getattr(with_amounts(before, verb, words), one.name)
            if isinstance(old, tuple):
                assert len(old) == len(new)
            for number in new if isinstance(new, tuple) else (new,):
                assert not isinstance(number, float) or math.isfinite(number), "the world would be nowhere"


TYPED = (
    *LINES,
    "help",
    "help fault",
    "help date",
    "see",
    "where",
    "faults",
    "press scan 0.2",
    "press down",
    "date kept",
)


def _typed(chance: Random) -> list[bytes]:
    """What one read after the other gets of a trainer's typing; without pictures, which go wherever they are told to."""
    lines = [
        reworded(chance, chance.choice(TYPED), (*SCRIPT_WORDS, *FAULT_WORDS)) for _ in range(chance.randrange(1, 6))
    ]
    text = "\n".join(line for line in lines if "screenshot" not in line).encode("utf-8", "surrogatepass") + b"\n"
    if chance.random() < 0.3:
        text = damaged(chance, text)
    cuts = sorted(chance.randrange(len(text) + 1) for _ in range(chance.randrange(4)))
    return [text[a:b] for a, b in zip([0, *cuts], [*cuts, len(text)], strict=True)]


@functools.cache
def _world() -> World:
    """In which no time passes: nobody enters it."""
    return World(WorldOptions(world="fuzzed", width_px=400, height_px=300, truth="nominal", noise=False))


def _type(pieces: list[bytes], scratch: Path) -> None:
    world = _world()
    (scratch / "run").mkdir(exist_ok=True)
    (scratch / "scans").mkdir(exist_ok=True)
    console = Console(world, scratch / "run" / "status.json")
    said = [line for piece in pieces for line in console.feed(piece)]
    assert all(line.strip() for line in said), "an answer says something"
    assert console.feed(b"\nwhere\n")[-1].startswith(world.scene.object), (
        "the next line is understood, whatever was before"
    )
    assert console.feed(b"clear\n") == ["done"]
    console.feed(b"disk on\ndisk spare\n")
    assert world.broken == ()


def _play(text: str, _: Path) -> None:
    for step in parse_script(text):
        assert str(step).startswith("line ")


def _fault(text: str, _: Path) -> None:
    fault = parse_fault(text, 10**9)
    assert fault.begins_ns >= 0
    assert fault.in_force(10**12) in (True, False)


STATUS = {
    "state": "AIM", "since_ns": 1, "alerts": [{"code": "LEAK", "headline": "LEAK", "action": "ASCEND", "severity": "CRITICAL"}],
    "keys": {"scan": "SCAN"}, "devices": {"board": "ok"}, "scans": 3, "scans_left": None, "last_scan": "000003",
    "gallery": {"scan": "000003", "damaged": False, "taken": None},
    "calibration": {"step": "M1", "busy": False, "result": "FITS", "done": ["M1"]}, "pid": 7, "worker_pid": None,
}  # fmt: skip
ASKED = tuple(
    (kind, (["500", "5"] if kind in ("distance", "tilt") else ["LEAK", "ok", "x"][: max(1, least)]))
    for kind, (least, _) in status_file.CONDITIONS.items()
)


def _status(chance: Random) -> bytes:
    if chance.random() < 0.3:
        return damaged(chance, json.dumps(STATUS).encode())
    return json.dumps(changed(chance, STATUS)).encode("utf-8", "surrogatepass")


def _look(data: bytes, scratch: Path) -> None:
    path = scratch / "status.json"
    path.write_bytes(data)
    status = status_file.read(path)
    for kind, words in ASKED:
        assert status_file.is_met(status, kind, list(words)) in (True, False)
    assert status_file.summary(status)


TARGETS = (
    Target("fault", "a fault sentence of the simulated world", lambda c: reworded(c, c.choice(FAULTS), FAULT_WORDS), _fault,
           (FaultSyntaxError,)),
    Target("knock", "a knock's sentence", lambda c: reworded(c, c.choice(KNOCKS), KNOCK_WORDS), lambda text, _: parse_knock(text),
           (MountShiftError,)),
    Target("console", "a line of the trainer's console", lambda c: reworded(c, c.choice(LINES), (*SCRIPT_WORDS, *FAULT_WORDS)), _deed, (ValueError,)),
    Target("console-bytes", "what is typed at the trainer's console, as it is read", _typed, _type, cost=5.0),
    Target("script", "a diver's script", _script, _play, (ScriptError,), "line ", cost=2.0),
    Target("status", "the instrument's status file, as the simulated diver reads it", _status, _look, cost=3.0),
)  # fmt: skip
