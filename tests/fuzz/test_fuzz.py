"""Damaged input never ends a parser in another way than it promises: some of each kind here, more by ``./dev fuzz``."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.fuzz.runner import run
from tests.fuzz.target import Target
from tests.fuzz.targets import TARGETS

INPUTS = 400


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_damaged_input_is_answered_as_promised(target: Target, tmp_path: Path) -> None:
    tally = run(target, 1, range(max(60, int(INPUTS / target.cost))), tmp_path)
    assert tally.findings == [], "\n".join(f"{finding}\n{finding.trace}" for finding in tally.findings)
    assert tally.accepted, "everything was refused: nothing behind the first check was reached"
    assert tally.refused or not target.refusals, "nothing was refused: the inputs are not damaged"


def _refuse(data: bytes, _: Path) -> None:
    raise ValueError("" if data == b"\0" else "wrong")


def _hang(data: bytes, _: Path) -> None:
    while True:
        pass


def _crash(data: bytes, _: Path) -> None:
    raise KeyError(data)


@pytest.mark.parametrize(("read", "said"), [(_refuse, "says nothing"), (_hang, "more than"), (_crash, "KeyError")])
def test_the_runner_notices_what_it_looks_for(
    read: object, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.fuzz.runner.LONGEST_S", 0.05)
    bad = Target("bad", "a bad parser", lambda chance: b"\0", read, (ValueError,))  # type: ignore[arg-type]
    tally = run(bad, 0, range(1), tmp_path)
    assert [said in finding.what for finding in tally.findings] == [True]


def test_a_process_that_dies_names_the_input_and_the_rest_goes_on(tmp_path: Path) -> None:
    program = tmp_path / "dies.py"
    program.write_text(
        "import os, signal\n"
        "from tests.fuzz.__main__ import _in_own_process\n"
        "from tests.fuzz.target import Target\n"
        "def read(case, _):\n"
        "    if case == 17: os.kill(os.getpid(), signal.SIGSEGV)\n"
        "target = Target('dies', '', lambda chance: chance.randrange(50), read)\n"
        "tally = _in_own_process(target, 0, 100)\n"
        "print(tally.inputs, sorted({f'{f.what} {f.case}' for f in tally.findings}))\n"
    )
    root = Path(__file__).parents[2]
    said = subprocess.run(
        [sys.executable, str(program)],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
        cwd=root,
        env={"PYTHONPATH": str(root)},
    )
    assert said.stdout == "100 ['the process died: SIGSEGV 17']\n"
