"""Kernels are compiled once, on several cores, with a word about it; what cannot be compiled is named, the rest is done."""

from __future__ import annotations

import gc
import io
import logging
import os
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path

import pytest

from appliance.base import kernel_build, kernel_cache
from appliance.base.kernel_build import CompileError, Compiling, Piece, compile_pieces, missing_kernels
from appliance.cli.kernels import CompileProgress

HERE = "tests.appliance.test_kernel_build"
LOG = "KERNEL_TEST_LOG"


def _note(name: str) -> None:
    with Path(os.environ[LOG]).open("a", encoding="ascii") as log:
        log.write(f"{name} {os.getpid()} {os.environ[kernel_cache.VARIABLE]}\n")


def one() -> None:
    """Stands for kernels: it says where and by whom it was run."""
    _note("one")
    time.sleep(0.3)


def two() -> None:
    _note("two")
    time.sleep(0.3)


def broken() -> None:
    raise TypeError("cannot unify int64 and array")


def dies() -> None:
    os._exit(9)


def collecting() -> None:
    """Kernels that must not be interrupted by a search for garbage."""
    _note(f"{gc.isenabled()}-{gc.get_freeze_count() > 0}")


collecting_again = collecting
PIECES = (Piece("the first", f"{HERE}:one"), Piece("the second", f"{HERE}:two"))


@pytest.fixture
def ran(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    log = tmp_path / "log"
    log.touch()
    monkeypatch.setenv(LOG, str(log))
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2]))
    return log


def lines(log: Path) -> list[list[str]]:
    return [line.split() for line in log.read_text(encoding="ascii").splitlines()]


def test_pieces_are_compiled_side_by_side_into_the_folder_and_never_again(
    ran: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, said = tmp_path / "kernels", list[Compiling]()
    compile_pieces(folder, PIECES, said.append, processes=2)
    assert {name for name, _, _ in lines(ran)} == {"one", "two"}
    assert len({process for _, process, _ in lines(ran)}) == 2
    assert {into for _, _, into in lines(ran)} == {str(folder)}
    assert said[0].what == ("the first", "the second")
    assert all(b.seconds - a.seconds < 10.0 for a, b in pairwise(said))
    compile_pieces(folder, PIECES, said.append)
    assert len(lines(ran)) == 2
    assert missing_kernels(folder, PIECES) == []
    monkeypatch.setattr(kernel_build, "stamps", lambda: "after a checkout")
    assert missing_kernels(folder, PIECES) == list(PIECES), (
        "what was compiled of a file that is written anew does not count"
    )


def test_garbage_is_looked_for_between_pieces_and_not_within(ran: Path, tmp_path: Path) -> None:
    pieces = (Piece("the first", f"{HERE}:collecting"), PIECES[0], Piece("the last", f"{HERE}:collecting_again"))
    compile_pieces(tmp_path / "kernels", pieces, processes=1)
    assert [name for name, _, _ in lines(ran)] == ["False-False", "one", "False-True"]


def test_who_starts_meanwhile_waits_and_compiles_nothing_twice(ran: Path, tmp_path: Path) -> None:
    code = f"""
from pathlib import Path
from appliance.base.kernel_build import compile_pieces
from {HERE} import PIECES
if __name__ == "__main__":
    compile_pieces(Path({str(tmp_path / "kernels")!r}), PIECES, print, processes=1)
"""
    script = tmp_path / "start.py"
    script.write_text(code, encoding="utf-8")
    both = [subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) for _ in range(2)]
    said = [process.communicate(timeout=120)[0] for process in both]
    assert [process.returncode for process in both] == [0, 0]
    assert sorted(name for name, _, _ in lines(ran)) == ["one", "two"]
    assert any("what=()" in each for each in said), "nobody was told that somebody else is compiling"


def test_what_cannot_be_compiled_is_named_and_the_rest_is_done(ran: Path, tmp_path: Path) -> None:
    bad = [Piece(f"the {name} one", f"{HERE}:{name}") for name in ("broken", "dies")]
    with pytest.raises(CompileError) as refused:
        compile_pieces(tmp_path / "kernels", (*bad, *PIECES), processes=1)
    for said in ("the broken one: TypeError: cannot unify int64 and array", "the dies one: ", "code 9"):
        assert said in str(refused.value)
    assert missing_kernels(tmp_path / "kernels", (*bad, *PIECES)) == bad


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_on_a_terminal_one_line_changes_and_is_cleared(caplog: pytest.LogCaptureFixture) -> None:
    terminal = Terminal()
    caplog.set_level(logging.INFO)
    with CompileProgress(terminal) as progress:
        progress(Compiling(0, 2, ("the first", "the second"), 0.0))
        progress(Compiling(1, 2, ("the second",), 7.0))
    shown = terminal.getvalue().split("\r")
    assert shown[1].strip() == "compiling, once: 0 of 2 done; the first, the second; 0 s"
    assert shown[2].strip() == "compiling, once: 1 of 2 done; the second; 7 s"
    assert not shown[3].strip()
    assert "\n" not in terminal.getvalue()
    assert caplog.messages == ["compiled in 7 s"]


def test_elsewhere_a_line_comes_at_least_every_ten_seconds() -> None:
    begun: list[float] = []
    now = 0.0
    with CompileProgress(io.StringIO(), lambda _: begun.append(now)) as progress:
        for now in [0.3 * k + k % 2 for k in range(200)]:
            progress(Compiling(0, 2, ("the first",), now))
    assert len(begun) < 12
    assert max(b - a for a, b in pairwise(begun)) < 10.0
