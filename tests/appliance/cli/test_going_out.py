"""What goes out can be read, whatever a stranger wrote into a manifest, and wherever it goes: a closed or full place is one line."""

from __future__ import annotations

import inspect
import io
import json
import os
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

from appliance.base.process_start import interrupts
from appliance.cli import main
from appliance.cli.output import Exit, ProgressLine, complain, plain
from appliance.cli.verbs import VerbEntry
from appliance.measure.verdict import Verdict
from appliance.store import manifest as form
from appliance.store.library import Library
from tests.appliance.cli.test_loaded import EVERY
from tests.appliance.store.scenes import ORIGIN, PREVIEW, cloud, frames, record
from tests.support.commands import ROOT

ESCAPES = "\x1b[2J\x1b]0;gone\x07 \x9b31m \u202e evil"
"""Clear the screen, name the window, turn red by a C1 code, and write from right to left."""


QUICK = {"calibration"}
"""Modules of verbs that read and write some small files."""


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A storage root whose only scan says odd things of itself."""
    library = Library(tmp_path)
    library.prepare()
    library.begin(frames(1), record(), ORIGIN).publish(record(), cloud(), PREVIEW)
    folder = tmp_path / "scans" / "000001"
    strange = record(wall_time=ESCAPES, verdicts=(Verdict(ESCAPES, False, {}),), software_version=f"1\n2{ESCAPES}")
    changed = form.Manifest(
        "000001", form.Stage.COMPLETE, form.Decision.KEPT, strange, form.read(folder).files, frame_crc32={}
    )
    (folder / form.MANIFEST_FILE).write_bytes(form.encode(changed))
    return tmp_path


@pytest.mark.parametrize("words", ["list", "show 1", "verify", "list --json", "show 1 --json", "show GONE"])
def test_escape_codes_of_a_strange_manifest_do_not_reach_the_terminal(
    words: str, root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["scans", *(ESCAPES if one == "GONE" else one for one in words.split()), "--root", str(root)])
    out, error = capsys.readouterr()
    assert (out + error).replace("\n", "").isprintable()
    if "--json" in words:
        assert ESCAPES in str(json.loads(out)).encode().decode("unicode_escape")
    if words == "list":
        assert len(out.splitlines()) == 2, "a line end in a manifest begins no line"
    for as_json in (False, True):
        complain(f"a\n{ESCAPES}", as_json=as_json)
        error = capsys.readouterr().err
        assert (error[-1], error[:-1].isprintable()) == ("\n", True)
        assert not as_json or json.loads(error) == {"error": f"a {ESCAPES}"}


@pytest.mark.parametrize(
    ("text", "written"),
    [
        ("ä 東 é\u00a0", "ä 東 é\u00a0"),
        ("\x1b\x9b\u202e", r"\u001b\u009b\u202e"),
        ("\U000e0001", r"\udb40\udc01"),
        ("\udcff", r"\udcff"),
        ("a\nb\tc", r"a\u000ab\u0009c"),
    ],
)
def test_what_is_not_to_be_read_is_written_as_an_escape_of_json(text: str, written: str) -> None:
    assert plain(text) == written
    assert json.loads(f'"{written}"') == text


@pytest.mark.parametrize(
    ("shell", "code", "lines", "environment"),
    [
        ("scans list --root R > /dev/full", Exit.FAILED, 1, {}),
        ("scans list --root R > /dev/full", Exit.FAILED, 1, {"PYTHONUNBUFFERED": "1"}),
        ("scans list --root R >&-", Exit.FAILED, 1, {}),
        ("scans list --root R 2>&-", Exit.OK, 0, {}),
        ("scans show 99 --root R 2>/dev/full", Exit.FAILED, 0, {}),
        ("--help > /dev/full", Exit.FAILED, 1, {}),
        ("scans show 1 --root R | head -c 1 > /dev/null; exit ${PIPESTATUS[0]}", Exit.OK, 0, {"PYTHONUNBUFFERED": "1"}),
        # A terminal without Unicode gets escapes.
        (r"scans list --root R | grep -F 'Stra\xdfe \u6771' > /dev/null", Exit.OK, 0, {"PYTHONUTF8": "0", "LC_ALL": "C", "PYTHONCOERCECLOCALE": "0"}),
    ],
)  # fmt: skip
def test_results_that_cannot_be_written_are_one_line_and_an_exit_code(
    shell: str, code: Exit, lines: int, environment: dict[str, str], root: Path
) -> None:
    assert main(["scans", "label", "1", "--name", "Straße 東", "--root", str(root)]) == 0
    command = f"{sys.executable} -m appliance.cli {shell.replace('R', str(root), 1)}"
    ran = subprocess.run(
        ["bash", "-c", command], capture_output=True, text=True, timeout=60, check=False, cwd=ROOT, env={**os.environ, **environment}
    )  # fmt: skip
    assert (ran.returncode, len(ran.stderr.splitlines())) == (code, lines), ran.stderr


class AtATerminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_progress_on_a_terminal_is_one_line_that_is_cleared_and_silent_for_a_second() -> None:
    now_s, terminal, file = 0.0, AtATerminal(), io.StringIO()
    with ProgressLine(terminal, lambda: now_s) as progress, ProgressLine(file, lambda: now_s) as in_file:
        progress("verifying", 0.1)
        now_s = 0.9
        progress("verifying", 0.2)
        assert terminal.getvalue() == ""
        now_s = 1.5
        progress("verifying", 0.5)
        in_file("verifying", 0.5)
        assert terminal.getvalue() == "\rverifying  50 %"
    assert (terminal.getvalue()[-17:], file.getvalue()) == ("\r" + " " * 15 + "\r", "")


def test_where_there_is_no_terminal_progress_comes_in_lines_some_seconds_apart() -> None:
    now_s, lines = 0.0, list[tuple[float, str]]()
    with ProgressLine(io.StringIO(), lambda: now_s, lambda text: lines.append((now_s, text))) as progress:
        for k in range(60):
            now_s = 0.5 * k
            progress(f"pair {k}\x1b[2J", k / 60)
    times = [at for at, _ in lines]
    assert times[0] <= 5.0
    assert all(b - a >= 5.0 for a, b in pairwise(times))
    assert len(times) == 4
    assert all(text.isprintable() for _, text in lines)


def test_an_interruption_within_a_compiled_library_is_one() -> None:
    error = SystemError("<built-in function loads> returned a result with an exception set")
    error.__cause__ = KeyboardInterrupt()
    assert interrupts(error)
    assert interrupts(KeyboardInterrupt())
    assert not interrupts(SystemError("bad argument to internal function"))
    later = ValueError("a fault of its own")
    later.__context__ = KeyboardInterrupt()
    assert not interrupts(later)


@pytest.mark.parametrize(("words", "listed"), EVERY, ids=lambda one: " ".join(one) if isinstance(one, tuple) else "")
def test_every_verb_that_may_take_long_says_how_far_it_is(words: tuple[str, ...], listed: VerbEntry) -> None:
    """Off a terminal, too: by the one class that does it."""
    source = inspect.getsource(sys.modules[listed.load().__module__])
    says = "ProgressLine(" in source or "open_scans(" in source
    assert says or listed.location.partition(":")[0] in QUICK or listed.load().service
