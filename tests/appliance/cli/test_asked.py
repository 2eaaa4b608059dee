"""How the guide speaks with a person: one line on stderr, an Enter as the answer, and what happens where nobody answers."""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from appliance.cli import main
from appliance.cli.setup import AtTheTerminal, _line
from appliance.store.config import default_rig_path
from appliance.workshop.step import GivenUp


def piped(sent: bytes, *, closed: bool = True) -> tuple[io.TextIOBase, Callable[[], None]]:
    """A pipe's end to read from, with bytes in it, and how to close it."""
    read, write = os.pipe()
    os.write(write, sent)
    if closed:
        os.close(write)
    stream = os.fdopen(read)

    def close() -> None:
        stream.close()
        if not closed:
            os.close(write)

    return stream, close


def test_each_question_takes_one_line_of_what_was_typed_ahead() -> None:
    stream, close = piped(b"\nyes\n\n")
    lines = io.StringIO()
    person = AtTheTerminal(stream, lines)  # type: ignore[arg-type]
    for _ in range(3):
        person.ask("put the caps on")
    assert lines.getvalue() == 3 * "DO: put the caps on; then press Enter\n"
    with pytest.raises(GivenUp, match="call again to continue"):
        person.ask("put the caps on")
    close()


def test_what_the_software_sees_for_itself_is_told_and_the_end_of_the_input_is_giving_up() -> None:
    lines = io.StringIO()
    person = AtTheTerminal(io.StringIO("yes"), lines)  # no file is behind it
    person.tell("press SCAN once and let it go")
    assert lines.getvalue() == "DO: press SCAN once and let it go\n"
    with pytest.raises(GivenUp, match="the input ended"):
        person.ask("stand it before a wall")


def test_nobody_is_waited_for_without_end() -> None:
    stream, close = piped(b"half a li", closed=False)
    assert _line(stream, 0.05) is None  # type: ignore[arg-type]
    close()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "--rig: not given"),
        (["--rig", "RIG"], "--out: not given"),
        (["--rig", "RIG", "--out", "RIG"], "is a file; give a folder"),
        (["--rig", "RIG", "--out", "new", "pads"], "no such step; allowed are board, pad, vsync"),
    ],
)
def test_wrong_arguments_are_told_before_anything_is_opened(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    given = [str(default_rig_path()) if one == "RIG" else one for one in arguments]
    given = [str(tmp_path / one) if one == "new" else one for one in given]
    assert main(["setup", "guide", *given]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "new").exists()
