"""What is typed or scripted for the simulated world, and the status file that it reads, is understood or refused however it is damaged."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import strategies as st

from hw_sim.faults import KINDS, PARTS
from hw_sim.mount_shift import AMOUNTS
from hw_sim.people import commands, status_file
from hw_sim.people.commands import SURROUNDINGS
from hw_sim.people.console import Console
from hw_sim.people.script import ScriptError, parse_script
from hw_sim.world import World, WorldOptions
from tests.support.damage import Parser, changed, damaged, reworded

FAULT_WORDS = (
    *(word for kind in KINDS for word in kind), *(f"{name}.{part}" for name, parts in PARTS.items() for part in parts),
    "how=truncate", "how=repeat", "frame=3", "at_s=0", "for_s=1", "count=2", "amount=4", *(f"{name}=1" for name in AMOUNTS),
)  # fmt: skip
SCRIPT = """\
# a dive
wait state AIM 60
press scan
press back 1.2
wait label SCAN KEEP 10
never state CAPTURE 1
pause 0.5
fault camera.left off at_s=3 for_s=2
fault camera.right garbage how=truncate frame=9 count=2
fault sensor.TPROJ wrong amount=81.5
knock left yaw_deg=0.2 x_mm=0.3
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
""".splitlines()
SCRIPT_WORDS = (
    *FAULT_WORDS, *SURROUNDINGS, "wait", "never", "press", "pause", "fault", "knock", "object", "scan", "state", "end", "clear", "off", "date",
    "-1e9", "kept", "2106-01-01",
)  # fmt: skip
LINES = tuple(line for line in SCRIPT if line.split()[0] in commands.HELP)
TYPED = tuple(line for line in LINES if "screenshot" not in line)
"""Without pictures, which go wherever they are told to."""


def sentences(lines: tuple[str, ...] | list[str], words: tuple[str, ...]) -> st.SearchStrategy[str]:
    """As they are, or damaged: too few of the damaged ones are understood."""
    return st.sampled_from(lines) | st.sampled_from(lines).flatmap(lambda line: reworded(line, words))


def read_typed(pieces: tuple[bytes, int], folder: Path) -> None:
    text, at = pieces
    world = World(WorldOptions(world="damaged", width_px=400, height_px=300, truth="nominal", noise=False))
    (folder / "scans").mkdir(exist_ok=True)
    console = Console(world, folder / "status.json")
    said = [line for piece in (text[:at], text[at:]) for line in console.feed(piece)]
    assert all(line.strip() for line in said), "an answer says something"
    where = console.feed(b"\nwhere\n")[-1]
    assert where.startswith(world.scene.object), "the next line is understood, whatever was before"
    assert console.feed(b"clear\n") == ["done"]
    console.feed(b"disk on\ndisk spare\n")
    assert world.broken == ()


def read_script(text: str, _: Path) -> None:
    for step in parse_script(text):
        assert str(step).startswith("line ")


STATUS = {
    "state": "AIM", "since_ns": 1, "alerts": [{"code": "LEAK", "headline": "LEAK", "action": "ASCEND", "severity": "CRITICAL"}],
    "keys": {"scan": "SCAN"}, "devices": {"board": "ok"}, "scans": 3, "scans_left": None, "last_scan": "000003",
    "gallery": {"scan": "000003", "damaged": False, "taken": None},
    "calibration": {"step": "M1", "busy": False, "result": "FITS", "done": ["M1"]}, "pid": 7, "worker_pid": None,
}  # fmt: skip


def read_status(data: bytes, folder: Path) -> None:
    (folder / "status.json").write_bytes(data)
    status = status_file.read(folder / "status.json")
    for kind, (least, _) in status_file.CONDITIONS.items():
        words = ["500", "5"] if kind in ("distance", "tilt") else ["LEAK", "ok", "x"][: max(1, least)]
        assert status_file.is_met(status, kind, words) in (True, False)
    assert status_file.summary(status)


SCRIPTS = st.lists(sentences(SCRIPT, SCRIPT_WORDS) | st.sampled_from(SCRIPT), min_size=1, max_size=9).map("\n".join)
BYTES = st.lists(sentences(TYPED, SCRIPT_WORDS), min_size=1, max_size=5).map(
    lambda lines: "\n".join(line for line in lines if "screenshot" not in line).encode("utf-8", "surrogatepass") + b"\n"
)
PARSERS = (
    Parser("console", st.tuples(BYTES | BYTES.flatmap(lambda text: damaged([text])), st.integers(0, 99)), read_typed, share=0.3),
    Parser("script", SCRIPTS, read_script, (ScriptError,), "line "),
    Parser(
        "status", changed(STATUS).map(lambda tree: json.dumps(tree).encode()) | damaged([json.dumps(STATUS).encode()]), read_status,
    ),
)  # fmt: skip


@pytest.mark.parametrize("parser", PARSERS, ids=lambda parser: parser.name)
def test_whatever_is_said_to_the_world_is_understood_or_refused(parser: Parser, tmp_path: Path) -> None:
    assert parser.judge(tmp_path)["accepted"], "nothing behind the first check was reached"
