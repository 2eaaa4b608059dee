"""Runs pytest in one tree again and again, each time in a fork of a process that has the heavy libraries already.

With a job that is ``interpreted`` numba compiles nothing: kernels run as the Python that they are written in.

A program of its own that imports nothing of the project: what it imported from one tree would hide another's. Its
arguments name the libraries; it reads one job per line of its input (JSON) and writes one answer per line of its output.
A run over its limit is killed with everything that it started. The limit is of processor time, since a busy computer
makes a good run wait. By the clock a run is ended when twice that and a while are over and nothing of it has used the
processor lately: it waits for what never comes.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import json
import os
import resource
import signal
import sys
import threading
import time
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

_MEMORY_BYTES = 24 << 30
_WHILE_S, _IDLE_S, _LOOK_S = 20.0, 10.0, 0.25
_DIE_WITH_PARENT = 1  # PR_SET_PDEATHSIG
_SUBREAPER = 36  # PR_SET_CHILD_SUBREAPER: what a killed run started becomes ours, so that we can end it


class Chosen:
    """A pytest plugin that runs only the wanted tests, files in the given order, and notes how each went."""

    def __init__(self, files: list[str], wanted: list[str] | None) -> None:
        self._place = {name: place for place, name in enumerate(files)}
        self._wanted = None if wanted is None else set(wanted)
        self.tests: dict[str, list[Any]] = {}
        """Of each test: the worst outcome of its phases, and its seconds."""

    def pytest_collection_modifyitems(self, config: Any, items: list[Any]) -> None:
        kept = [one for one in items if self._wanted is None or one.nodeid in self._wanted]
        if len(kept) < len(items):
            left_out = [one for one in items if one not in set(kept)]
            config.hook.pytest_deselected(items=left_out)
        kept.sort(key=lambda one: self._place.get(one.nodeid.partition("::")[0], 1 << 30))
        items[:] = kept

    def pytest_runtest_logreport(self, report: Any) -> None:
        known = self.tests.setdefault(report.nodeid, ["passed", 0.0])
        known[1] += report.duration
        if report.outcome != "passed":
            known[0] = report.outcome

    def pytest_collectreport(self, report: Any) -> None:
        if report.outcome == "failed":
            self.tests[report.nodeid] = ["failed", 0.0]


class TooSlow(BaseException):
    """A test took longer than it may; no ``Exception``, so that nothing under test takes it for its own."""


class Interpreted:
    """A pytest plugin for kernels that run as plain Python: no test takes long, and only a broken assertion counts.

    An index beyond an array and a division by zero raise here, while a compiled kernel goes on with some number: what
    only raises shows nothing about the compiled kernel.
    """

    def __init__(self, most_s: float | None, mutated: bool) -> None:
        self._most_s, self._mutated = most_s, mutated
        self.asserted: set[str] = set()

    def pytest_runtest_logstart(self, nodeid: str, location: object) -> None:
        if self._most_s is not None:
            signal.signal(signal.SIGPROF, _too_slow)
            signal.setitimer(signal.ITIMER_PROF, self._most_s)  # processor time

    def pytest_runtest_logfinish(self, nodeid: str, location: object) -> None:
        signal.setitimer(signal.ITIMER_PROF, 0.0)

    def pytest_runtest_makereport(self, item: Any, call: Any) -> None:
        if call.excinfo is not None and (
            issubclass(call.excinfo.type, AssertionError) or call.excinfo.type.__name__ == "Failed"  # of pytest.fail
        ):
            self.asserted.add(item.nodeid)
            if self._mutated:
                item.session.shouldfail = "an assertion is broken"

    def judged(self, tests: dict[str, list[Any]]) -> dict[str, list[Any]]:
        """Return the tests and their outcomes, with "raised" for what failed otherwise than by an assertion."""
        return {
            name: ["raised" if outcome == "failed" and name not in self.asserted else outcome, seconds]
            for name, (outcome, seconds) in tests.items()
        }


def _too_slow(number: int, frame: FrameType | None) -> None:
    raise TooSlow


class Lines:
    """A pytest plugin that notes which lines of the watched files each test executes, in any thread and process."""

    def __init__(self, tree: str, watched: list[str], folder: Path) -> None:
        self._folder = folder
        self._watched = {os.path.join(tree, one): one for one in watched}  # noqa: PTH118 (as code objects name it)
        self.seen: dict[str, dict[str, list[int]]] = {}
        self._now: set[tuple[str, int]] = set()
        if watched:
            folder.mkdir(exist_ok=True)
            os.environ["KINGFISHER_MUTATE_LINES"] = json.dumps({"folder": str(folder), "watched": self._watched})
            os.environ["PYTHONPATH"] += os.pathsep + str(Path(tree) / "tests" / "mutate" / "child")

    def _call(self, frame: FrameType, event: str, argument: object) -> Any:
        code: CodeType = frame.f_code
        name = self._watched.get(code.co_filename)
        if name is None:
            return None
        now = self._now

        def line(frame: FrameType, event: str, argument: object) -> Any:
            if event == "line":
                now.add((name, frame.f_lineno))
            return line

        now.add((name, frame.f_lineno))
        return line

    def pytest_runtest_logstart(self, nodeid: str, location: object) -> None:
        self._now = set()
        threading.settrace(self._call)
        sys.settrace(self._call)

    def pytest_runtest_logfinish(self, nodeid: str, location: object) -> None:
        sys.settrace(None)
        threading.settrace(None)
        for told in self._folder.glob("*.json"):  # of processes that the test started
            self._now.update((name, line) for name, line in json.loads(told.read_text() or "[]"))
            told.unlink()
        by_file: dict[str, list[int]] = {}
        for name, line in sorted(self._now):
            by_file.setdefault(name, []).append(line)
        self.seen[nodeid] = by_file


def main() -> int:
    tree = str(Path.cwd())
    here = str(Path(__file__).parent)
    sys.path[:] = [one for one in sys.path if one != here]
    sys.path.insert(0, tree)
    libc = ctypes.CDLL(None)
    libc.prctl(_SUBREAPER, 1, 0, 0, 0)
    libc.prctl(_DIE_WITH_PARENT, signal.SIGKILL, 0, 0, 0)
    for name in sys.argv[1:]:
        try:
            importlib.import_module(name)
        except ImportError:
            continue  # only a head start
    for line in sys.stdin:
        sys.stdout.write(json.dumps(_answer(tree, json.loads(line))) + "\n")
        sys.stdout.flush()
    return 0


def _answer(tree: str, job: dict[str, Any]) -> dict[str, Any]:
    notes = Path(job["notes"])
    notes.unlink(missing_ok=True)
    began = time.monotonic()
    child = os.fork()
    if child == 0:
        code = 70
        try:
            code = _run(tree, job)
        finally:
            os._exit(code)
    status = _wait(child, began + 2.0 * job["limit_s"] + _WHILE_S, job["limit_s"])
    _end_the_rest(child)
    answer: dict[str, Any] = {"seconds": time.monotonic() - began, "tests": {}, "lines": {}}
    if notes.exists():
        answer |= json.loads(notes.read_text())
    if status is None:
        answer["outcome"] = "timed out"
    elif os.WIFSIGNALED(status):
        over = os.WTERMSIG(status) in (signal.SIGXCPU, signal.SIGKILL)
        answer["outcome"] = "timed out" if over else "died"
    else:
        answer["outcome"] = {0: "passed", 5: "no tests"}.get(os.WEXITSTATUS(status), "failed")
    return answer


def _wait(child: int, until: float, limit_s: float) -> int | None:
    """The child's status, or None when it had to be killed at a limit."""
    used_s, moved = 0.0, time.monotonic()
    look = moved + _LOOK_S
    while True:
        pid, status = os.waitpid(child, os.WNOHANG)
        if pid:
            return status
        now = time.monotonic()
        if now > look:
            look = now + _LOOK_S
            now_used_s = _used_s(child)
            if now_used_s > used_s + 0.01:
                used_s, moved = now_used_s, now
            if used_s > limit_s or (now > until and now - moved > _IDLE_S):
                break
        time.sleep(0.02)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None


def _used_s(session: int) -> float:
    """Processor time of all processes of a session."""
    ticks = 0
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue  # it has just ended
        if int(fields[3]) == session:
            ticks += sum(int(value) for value in fields[11:15])
    return ticks / os.sysconf("SC_CLK_TCK")


def _end_the_rest(child: int) -> None:
    """Kill what the run left behind, in its process group or in groups of their own."""
    for _ in range(100):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
        orphans = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
        if not orphans:
            return
        for orphan in orphans:
            try:
                os.kill(int(orphan), signal.SIGKILL)
                os.waitpid(int(orphan), 0)
            except (ProcessLookupError, ChildProcessError):
                continue


def _run(tree: str, job: dict[str, Any]) -> int:
    os.setsid()
    ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL, 0, 0, 0)  # a campaign that is ended leaves nothing behind
    resource.setrlimit(resource.RLIMIT_CPU, (int(job["limit_s"]) + 1, int(job["limit_s"]) + 5))
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY_BYTES, _MEMORY_BYTES))
    nothing, said = os.open(os.devnull, os.O_RDONLY), os.open(job["said"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for target, source in ((0, nothing), (1, said), (2, said)):
        os.dup2(source, target)
    os.environ |= {"NUMBA_CACHE_DIR": job["kernels"], "PYTHONPATH": tree, "KINGFISHER_MUTATED": tree}
    if job["interpreted"]:
        os.environ["NUMBA_DISABLE_JIT"] = "1"
    if "numba" in sys.modules:
        sys.modules["numba"].config.reload_config()
    if job["mutated"]:
        sys.dont_write_bytecode = True
        os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
    import pytest

    chosen = Chosen(job["files"], job["wanted"])
    plugins: list[object] = [chosen]
    lines = Lines(tree, job["watched"], Path(job["notes"]).with_suffix(".lines"))
    if job["watched"]:
        plugins.append(lines)
    interpreted = Interpreted(job["most_s"], job["mutated"])
    if job["interpreted"]:
        plugins.append(interpreted)
    options = ["-q", "-n0", "-p", "no:cacheprovider", "--hypothesis-seed=0", "--rootdir", tree, "--tb=short"]
    if job["mutated"] and not job["interpreted"]:
        options.append("-x")
    code = pytest.main([*options, *job["files"]], plugins=plugins)
    foreign = [
        name
        for name, module in list(sys.modules.items())
        if name.partition(".")[0] in {"appliance", "drivers", "hw_sim", "tests"}
        and not str(getattr(module, "__file__", None) or tree).startswith(tree)
    ]
    tests = interpreted.judged(chosen.tests) if job["interpreted"] else chosen.tests
    notes = {"tests": tests, "lines": lines.seen, "foreign": foreign}
    Path(job["notes"]).write_text(json.dumps(notes))
    return int(code)


if __name__ == "__main__":
    sys.exit(main())
