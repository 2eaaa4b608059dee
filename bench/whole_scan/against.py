"""Comparison of the CPU time of two revisions part by part, on the same frames in alternating turns.

A ratio is taken within each round and the median of those is reported, because a disturbance of one round affects both.
Each side is a process that does everything in one thread.
"""

from __future__ import annotations

import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from bench.foreign import end_process, last_words
from bench.result import Measurement
from bench.runner import version
from bench.timing import median_of
from bench.whole_scan import parts
from bench.whole_scan.scenes import DISC, FOLDER, NAMES

TREES = Path(".cache/against")
KEPT_TREES = 2
"""Trees of other revisions that stay, with their compiled kernels: the latest ones."""
GIT_TIMEOUT_S, COMPILE_TIMEOUT_S, START_TIMEOUT_S, ROUND_TIMEOUT_S = 60.0, 1200.0, 600.0, 120.0
ONE_SIDE = Path(__file__).with_name("one_side.py")
UNTIL_VERDICT = (
    parts.LAST_PAIR,
    parts.IDENTITY,
    parts.COARSE,
    "light",
    "fringes",
    "water",
    "sight",
    "motion",
    "sides",
    "medium",
    "windows",
    "grey",
    parts.WEIGHING,
)
SUMS: dict[str, Sequence[str]] = {
    "verdict": UNTIL_VERDICT,
    "complete": (*UNTIL_VERDICT, parts.COMPENSATION, parts.FULL),
    "complete_scan": (parts.RECORDING, *UNTIL_VERDICT, parts.COMPENSATION, parts.FULL),
}
"""Parts of each sum by the name in its key: last frame to verdict, to full cloud, and the whole scan. Absent parts
count as zero."""


SAME = ("points", "judgements")
HEADS = ((DISC, "disc"), ("pipe", "pipe"), ("turbid", "shell in turbid water"), ("moving", "moving, compensated"))
ROWS = {
    parts.RECORDING: "while recording: 23 pairs",
    **{part: part for part in UNTIL_VERDICT},
    parts.BACKSCATTER: "of the coarse cloud, what lies behind backscatter",
    parts.COMPENSATION: "compensation",
    parts.FULL: "full cloud",
    "verdict": "last frame to verdict",
    "complete": "last frame to full cloud",
    "complete_scan": "whole scan",
}
"""Rows of the table, and their words."""


class NoComparison(Exception):
    """Error of a revision that cannot be run; the text says why and the remedy."""


@dataclass(frozen=True, slots=True)
class Tree:
    """A source tree, and the environment in which Python runs its program."""

    root: Path
    revision: str
    environment: Mapping[str, str]


def compared(
    theirs: Tree, rounds: int, scenes: Sequence[str] = NAMES, width_px: int = 1600, folder: Path = FOLDER
) -> Iterator[Measurement]:
    """Yield this tree's CPU time over that of ``theirs``, for each scene and part. Raises NoComparison, ValueError."""
    if rounds < 1:
        raise ValueError(f"rounds is {rounds}; at least 1 is needed")
    ours = Tree(Path.cwd(), "", dict(os.environ, PYTHONPATH=str(Path.cwd())))
    for scene in scenes:
        arguments = (scene, str(width_px), str(folder.absolute()))
        with ExitStack() as stack:
            # Theirs first: missing frames are rendered once, by the first side.
            their_side = stack.enter_context(Side(theirs, arguments))
            our_side = stack.enter_context(Side(ours, arguments))
            turns = [_turn(our_side, their_side, ours_first=bool(k % 2)) for k in range(rounds)]
        yield from ratios(scene, theirs.revision, turns)
        common = our_side.found.keys() & their_side.found.keys()
        differ = sorted(name for name in common if our_side.found[name] != their_side.found[name])
        for what, equal in (("points", "points" not in differ), ("judgements", not set(differ) - {"points"})):
            label = f"{scene}: {what} the same to the last byte (1: yes)"
            yield Measurement(
                f"{label}; not {', '.join(differ)}" if differ else label,
                float(equal),
                "",
                key=key_of(scene, f"same_{what}"),
            )


def ratios(
    scene: str, revision: str, turns: Sequence[tuple[Mapping[str, float], Mapping[str, float]]]
) -> Iterator[Measurement]:
    """Yield the medians of ``turns``: CPU ms of each part in both trees, in each round."""
    parts_by_name: dict[str, Sequence[str]] = {part: (part,) for part in turns[0][0] if part in turns[0][1]} | SUMS
    for name, part_names in parts_by_name.items():
        pairs_ms = [
            (sum(our_ms.get(part, 0.0) for part in part_names), sum(their_ms.get(part, 0.0) for part in part_names))
            for our_ms, their_ms in turns
        ]
        # A part that takes almost no time on either side has no useful ratio.
        if all(other_ms >= 1.0 for _, other_ms in pairs_ms):
            label = f"{scene}, {name}: CPU over that of {revision[:8]}"
            yield median_of(label, [own_ms / other_ms for own_ms, other_ms in pairs_ms], "times", key_of(scene, name))


def table(revision: str, rounds: int, measured: Sequence[Measurement]) -> str:
    """Return the ratios as a table with a column for each scene; missing ones are a dash."""
    values_by_key = {number.key: number.value for number in measured}
    lines = [
        f"CPU time over that of revision {revision[:8]}: both run in turns on the same frames, in processes of one thread each; medians of {rounds} rounds.",
        "",
        f"| ratio | {' | '.join(head for _, head in HEADS)} |",
        "|---|" + "---:|" * len(HEADS),
    ]
    for part, label in ROWS.items():
        values = [values_by_key.get(key_of(scene, part)) for scene, _ in HEADS]
        if any(value is not None for value in values):
            lines.append(f"| {label} | {' | '.join(_ratio(value) for value in values)} |")
    for what in SAME:
        values = [values_by_key.get(key_of(scene, f"same_{what}")) for scene, _ in HEADS]
        lines.append(f"| {what} the same to the last byte | {' | '.join(_yes(value) for value in values)} |")
    return "\n".join([*lines, "", f"*Figures of {version()}.*"]) + "\n"


def _ratio(value: float | None) -> str:
    return "—" if value is None else f"{value:.2f}" if value >= 0.095 else f"{value:.1g}"


def _yes(value: float | None) -> str:
    return "—" if value is None else "yes" if value else "no"


def key_of(scene: str, part: str) -> str:
    """Return a ratio's name in ``latest.json``."""
    return f"{'' if scene == DISC else f'{scene}_'}against_{part.replace('of it: ', '').replace(' ', '_')}"


def other_tree(revision: str, trees: Path = TREES) -> Tree:
    """Make the tree of ``revision`` unless it exists, compile its kernels, and return it. Raises NoComparison."""
    try:
        commit = _git("rev-parse", "--verify", "--end-of-options", f"{revision}^{{commit}}").decode().strip()
        inside = _git("ls-tree", "--name-only", commit, "bench/whole_scan/parts.py")
    except subprocess.CalledProcessError as error:
        message = error.stderr.decode(errors="replace").strip()
        raise NoComparison(
            f"--against {revision}: git knows no such revision ({message}); give one of `git log`"
        ) from error
    if not inside:
        raise NoComparison(
            f"--against {revision}: it has no parts of a scan to compare (bench/whole_scan/parts.py); give a later one"
        )
    root = trees.absolute() / commit[:12]
    if not root.is_dir():
        trees.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=trees) as making:
            packed = Path(making) / "tree.tar"
            packed.write_bytes(_git("archive", commit))
            shutil.unpack_archive(packed, Path(making) / "tree", "tar", filter="data")
            (Path(making) / "tree").rename(root)
    root.touch()
    for old in sorted(
        (tree_folder for tree_folder in trees.iterdir() if tree_folder.is_dir()),
        key=lambda tree_folder: tree_folder.stat().st_mtime,
    )[:-KEPT_TREES]:
        shutil.rmtree(old)
    environment = {key: value for key, value in os.environ.items() if not key.startswith("NUMBA_")}
    environment["PYTHONPATH"] = str(root)
    folder = _python(root, environment, ("-m", "appliance.base.kernel_cache"), GIT_TIMEOUT_S).strip()
    environment["NUMBA_CACHE_DIR"] = folder
    Path(folder).mkdir(parents=True, exist_ok=True, mode=0o700)
    _python(root, environment, ("-m", "bench.kernels"), COMPILE_TIMEOUT_S)
    return Tree(root, commit, environment)


class Side:
    """One revision's program with a scene loaded. A context manager. Raises NoComparison where it does not answer."""

    def __init__(self, tree: Tree, arguments: Sequence[str]) -> None:
        self._tree, self._arguments = tree, arguments
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 (closed with the process)
        self._process: subprocess.Popen[bytes] | None = None
        self.found: dict[str, str] = {}
        """Digests of the results in the scene."""

    def __enter__(self) -> Side:
        command = [sys.executable, "-P", str(ONE_SIDE.absolute()), *self._arguments]
        try:
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._errors, bufsize=0,
                cwd=self._tree.root, env=dict(self._tree.environment),
            )  # fmt: skip
            self.found = self._answer(START_TIMEOUT_S)
        except BaseException:
            self._stop()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop()

    def round(self) -> dict[str, float]:
        """Run one scan; return CPU ms of each part."""
        process = self._process
        assert process is not None, "inside the context"
        assert process.stdin is not None
        process.stdin.write(b"\n")
        return {part: float(taken_ms) for part, taken_ms in self._answer(ROUND_TIMEOUT_S).items()}

    def _answer(self, timeout_s: float) -> Any:
        process = self._process
        assert process is not None
        assert process.stdout is not None
        if not select.select([process.stdout], [], [], timeout_s)[0]:
            raise NoComparison(f"{self._tree.root} gave no answer within {timeout_s:.0f} s")
        line = process.stdout.readline()
        if not line:
            raise NoComparison(
                f"the program in {self._tree.root} ended: {last_words(self._errors) or 'without a word'}"
            )
        return json.loads(line)

    def _stop(self) -> None:
        process, self._process = self._process, None
        end_process(process, self._errors)


def _turn(our_side: Side, their_side: Side, *, ours_first: bool) -> tuple[dict[str, float], dict[str, float]]:
    if ours_first:
        mine = our_side.round()
        return mine, their_side.round()
    theirs = their_side.round()
    return our_side.round(), theirs


def _git(*arguments: str) -> bytes:
    return subprocess.run(("git", *arguments), check=True, capture_output=True, timeout=GIT_TIMEOUT_S).stdout


def _python(root: Path, environment: Mapping[str, str], arguments: Sequence[str], timeout_s: float) -> str:
    command = (sys.executable, *arguments)
    try:
        ran = subprocess.run(
            command, cwd=root, env=dict(environment), capture_output=True, text=True, timeout=timeout_s, check=True
        )
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as error:
        lines = str(getattr(error, "stderr", "") or "").strip().splitlines()
        raise NoComparison(f"{' '.join(arguments)} failed in {root}: {lines[-1] if lines else error}") from error
    return ran.stdout
