"""Cost of the first run: every kernel compiled into an empty folder, on all processors, piece by piece.

CPU time of all processes, imports included; divided by the processors, it is the waiting time with a new clone.
"""

from __future__ import annotations

import json
import os
import queue
import select
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from appliance.base.kernel_build import PIECE_S
from appliance.cli.simrig import simulator_kernels
from appliance.measure.warm import PIECES
from bench.document import COMPILING
from bench.result import Measurement
from bench.runner import machine, version

OUT = Path("bench/out")
LISTED = 5
"""Number of the dearest kernels that the table names of each piece."""
STAGES = {
    "nopython_type_inference": "finding types",
    "native_lowering": "machine code, LLVM's work and numba's way there",
}
"""The dearest stages, as numba calls them."""


@dataclass(frozen=True, slots=True)
class CompileCost:
    """Cost of one piece."""

    what: str
    cpu_s: float
    kernels: Sequence[tuple[str, float]]
    """Names with their module, and CPU time without that of the functions they call, s."""
    stages_s: Mapping[str, float]
    """CPU time by numba's name of each stage."""


def measure() -> Iterator[Measurement]:
    OUT.mkdir(parents=True, exist_ok=True)
    pieces = [(piece.what, piece.function) for piece in PIECES]
    begun_s = time.monotonic()
    done = compiled([*pieces, *simulator_kernels()], len(os.sched_getaffinity(0)))
    taken_s = time.monotonic() - begun_s
    (OUT / COMPILING).write_text(table(done, len(pieces), taken_s), encoding="utf-8")
    yield from figures(done, taken_s)


def compiled(pieces: Sequence[tuple[str, str]], processes: int) -> list[CompileCost]:
    """Compile ``pieces`` (text, function) into an empty folder by ``processes``. Raises RuntimeError."""
    left: queue.SimpleQueue[int] = queue.SimpleQueue()
    for number in range(len(pieces)):
        left.put(number)
    done: dict[int, CompileCost] = {}
    failed: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        environment = dict(os.environ, NUMBA_CACHE_DIR=folder)

        def work() -> None:
            command = [sys.executable, "-m", "bench.compiling.pieces"]
            with subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0, env=environment
            ) as process:
                try:
                    while not failed:
                        number = left.get_nowait()
                        what, function = pieces[number]
                        answer = _asked(process, function)
                        done[number] = CompileCost(
                            what,
                            answer["cpu_s"],
                            [(name, own_s) for name, own_s in answer["kernels"]],
                            answer["stages"],
                        )
                except queue.Empty:
                    pass
                except (OSError, ValueError) as error:
                    failed.append(f"{what}: {error}")
                finally:
                    process.kill()

        threads = [threading.Thread(target=work, name=f"bench-compile-{k}") for k in range(processes)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(len(pieces) * PIECE_S)
    if failed or len(done) < len(pieces):
        raise RuntimeError(f"not all kernels could be compiled: {'; '.join(failed) or 'one did not end'}")
    return [done[number] for number in range(len(pieces))]


def _asked(process: subprocess.Popen[bytes], function: str) -> dict[str, Any]:
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(f"{function}\n".encode())
    line = b""
    until_s = time.monotonic() + PIECE_S
    # A long answer may come in parts.
    while not line.endswith(b"\n"):
        if not select.select([process.stdout], [], [], max(until_s - time.monotonic(), 0.0))[0]:
            raise ValueError(f"not compiled within {PIECE_S:.0f} s")
        part = process.stdout.read(65_536)
        if not part:
            raise ValueError("the compiling process ended; what it said stands above")
        line += part
    answer: dict[str, Any] = json.loads(line)
    return answer


def figures(done: Sequence[CompileCost], taken_s: float) -> Iterator[Measurement]:
    """Yield the total, the pieces, and the functions of numba itself."""
    whole_s = sum(piece.cpu_s for piece in done)
    yield Measurement("all kernels compiled, processor time", whole_s, "s CPU", key="compile_cpu_s")
    yield Measurement("by the clock", taken_s, "s", key="compile_wall_s")
    numba_s = [own_s for piece in done for name, own_s in piece.kernels if name.startswith("numba.")]
    yield Measurement(
        f"of it numba's own array functions, {len(numba_s)}", sum(numba_s), "s CPU", key="compile_of_numba_cpu_s"
    )
    yield Measurement("functions compiled", sum(len(piece.kernels) for piece in done), "", key="compile_functions")
    for name, key in STAGES.items():
        spent_s = sum(piece.stages_s.get(name, 0.0) for piece in done)
        yield Measurement(
            f"of it {key}", spent_s, "s CPU", key=f"compile_{key.partition(',')[0].replace(' ', '_')}_cpu_s"
        )
    for piece in done:
        yield Measurement(
            f"{piece.what}: {_words(dearest(piece))}",
            piece.cpu_s,
            "s CPU",
            key=f"compile_{piece.what.replace(' ', '_')}_cpu_s",
        )


def dearest(piece: CompileCost) -> Sequence[tuple[str, float, int]]:
    """Return short name, processor time and number of forms of the dearest functions of a piece, the dearest first."""
    spent_s: Mapping[str, list[float]] = defaultdict(list)
    for name, own_s in piece.kernels:
        spent_s[name].append(own_s)
    ranked = sorted(((sum(took_s), name, len(took_s)) for name, took_s in spent_s.items()), reverse=True)
    return [(_short(name), taken_s, forms) for taken_s, name, forms in ranked[:LISTED]]


def table(done: Sequence[CompileCost], of_the_product: int, taken_s: float) -> str:
    """Return the table of ``docs/performance.md``; the first ``of_the_product`` pieces are the product's, the others the simulator's."""
    on, whole_s = machine(), sum(piece.cpu_s for piece in done)
    ours_s = sum(piece.cpu_s for piece in done[:of_the_product])
    lines = [
        f"On {on['processor']}, {on['processors']} processors: {whole_s:.0f} s of CPU, {ours_s:.0f} of them the product's, and {taken_s:.0f} s by the clock.",
        f"Finding types takes {_stage_s(done, 0):.0f} s of them, machine code (numba's way there and LLVM's work) {_stage_s(done, 1):.0f} s.",
        "",
        "| Piece | s CPU | functions | the dearest in it, s CPU without what they call (× forms) |",
        "|---|---:|---:|---|",
    ]
    lines += [
        f"| {piece.what} | {piece.cpu_s:.1f} | {len(piece.kernels)} | {_words(dearest(piece), code='`')} |"
        for piece in done
    ]
    return "\n".join([*lines, "", f"*Figures of {version()}.*"]) + "\n"


def _stage_s(done: Sequence[CompileCost], number: int) -> float:
    return sum(piece.stages_s.get(list(STAGES)[number], 0.0) for piece in done)


def _words(kernels: Sequence[tuple[str, float, int]], code: str = "") -> str:
    return ", ".join(
        f"{code}{name}{code} {own_s:.1f}{'' if forms == 1 else f' (× {forms})'}" for name, own_s, forms in kernels
    )


def _short(name: str) -> str:
    """Return the last part of the module and the function's name, without the scopes around it."""
    module, _, function = name.replace(".<locals>", "").rpartition(".")
    return f"{module.rpartition('.')[2]}.{function}"
