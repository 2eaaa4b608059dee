"""``./dev fuzz [--runs N] [--target NAME] [--seed S] [--only INDEX] [--list]``: damaged input for every parser.

Each target runs in a process of its own, so that one that dies or hangs below Python is found as well.
"""

from __future__ import annotations

import argparse
import mmap
import os
import pickle
import resource
import signal
import struct
import sys
import tempfile
import time
from pathlib import Path

from tests.fuzz.runner import Finding, Tally, make_case, run
from tests.fuzz.target import Target
from tests.fuzz.targets import TARGETS

RUNS = 100_000
STUCK_S = 60.0
"""One input may take that long by the clock before its process is ended."""
MEMORY_BYTES = 6 << 30
"""Of address space: a length that lies must not be believed."""


def main() -> int:
    """0 when every input was answered as promised."""
    parser = argparse.ArgumentParser("dev fuzz", description="Damaged input for every parser of bytes from outside.")
    parser.add_argument("--runs", type=int, default=RUNS, metavar="N", help=f"inputs per target (default {RUNS})")
    parser.add_argument("--target", action="append", metavar="NAME", help="only this one; may be repeated")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="another seed, other inputs (default 0)")
    parser.add_argument("--only", type=int, metavar="INDEX", help="only this input, with its traceback")
    parser.add_argument("--kinds", action="store_true", help="list the kinds of refusals that were reached")
    parser.add_argument("--list", action="store_true", help="list the targets")
    args = parser.parse_args()
    if args.list:
        for target in TARGETS:
            print(f"{target.name:14} {target.about}")
        return 0
    known = {target.name: target for target in TARGETS}
    for name in args.target or ():
        if name not in known:
            parser.error(f"--target {name}; known are {', '.join(known)}")
    chosen = [known[name] for name in args.target or known]
    if args.only is not None:
        return _one(chosen, args.seed, args.only)
    print(f"{'target':14} {'inputs':>8} {'accepted':>9} {'refused':>8} {'kinds':>6} {'inputs/s':>9}  findings")
    findings: list[Finding] = []
    for target in chosen:
        tally = _in_own_process(target, args.seed, args.runs)
        findings += tally.findings
        print(
            f"{target.name:14} {tally.inputs:8} {tally.accepted:9} {tally.refused.total():8} {len(tally.refused):6} "
            f"{tally.per_s:9.0f}  {len(tally.findings)}",
            flush=True,
        )
        if args.kinds:
            for kind, count in tally.refused.most_common():
                print(f"    {count:7}  {kind}")
    for finding in findings:
        print(f"\n{finding}\n{finding.trace}")
    return 1 if findings else 0


def _one(chosen: list[Target], seed: int, index: int) -> int:
    findings: list[Finding] = []
    for target in chosen:
        print(f"{target.name}: {make_case(target, seed, index)!r}")
        with tempfile.TemporaryDirectory() as scratch:
            tally = run(target, seed, [index], Path(scratch))
        print(*(tally.refused or ["accepted" if tally.accepted else "not answered as promised"]))
        findings += tally.findings
    for finding in findings:
        print(f"\n{finding}\n{finding.trace}")
    return 1 if findings else 0


def _in_own_process(target: Target, seed: int, runs: int) -> Tally:
    """The tally of all inputs; after a death the rest goes on behind the input that killed."""
    done = Tally()
    first = 0
    while first < runs:
        tally, died_at, why = _child(target, seed, range(first, runs))
        if tally is not None:
            _add(done, tally)
            break
        done.inputs += died_at - first + 1  # what the dead one had counted is gone with it
        case = repr(make_case(target, seed, died_at))[:600]
        done.findings.append(Finding(target.name, seed, died_at, f"the process died: {why}", case, ""))
        if len(done.findings) >= 5:
            break
        first = died_at + 1
    return done


def _add(done: Tally, more: Tally) -> None:
    done.inputs += more.inputs
    done.accepted += more.accepted
    done.refused += more.refused
    done.findings += more.findings
    done.cpu_s += more.cpu_s


def _child(target: Target, seed: int, indices: range) -> tuple[Tally | None, int, str]:
    with mmap.mmap(-1, 8) as shared, tempfile.TemporaryDirectory(dir=_fast()) as scratch:
        reading, writing = os.pipe()
        sys.stdout.flush()
        pid = os.fork()
        if pid == 0:  # the child: no handler of the parent's may run
            os.close(reading)
            try:
                resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
                tally = run(
                    target, seed, indices, Path(scratch), lambda index: struct.pack_into("<q", shared, 0, index)
                )
                with os.fdopen(writing, "wb") as pipe:
                    pickle.dump(tally, pipe)
            finally:
                os._exit(0)
        os.close(writing)
        os.set_blocking(reading, False)
        answer, stuck = _collect(reading, pid, shared)
        os.close(reading)
        _, status = os.waitpid(pid, 0)
        at: int = struct.unpack_from("<q", shared)[0]
    if answer:
        tally = pickle.loads(answer)
        assert isinstance(tally, Tally)
        return tally, at, ""
    ended = signal.Signals(os.WTERMSIG(status)).name if os.WIFSIGNALED(status) else f"status {status}"
    return None, at, f"no input may take {STUCK_S:g} s" if stuck else ended


def _collect(reading: int, pid: int, shared: mmap.mmap) -> tuple[bytes, bool]:
    """Everything the child writes before it ends, and whether it had to be ended because it did not go on."""
    answer = bytearray()
    at, since_s = -1, time.monotonic()
    while True:
        try:
            piece = os.read(reading, 1 << 16)
            if not piece:
                return bytes(answer), False
            answer += piece
            continue
        except BlockingIOError:
            time.sleep(0.02)
        now: int = struct.unpack_from("<q", shared)[0]
        if now != at or answer:
            at, since_s = now, time.monotonic()
        elif time.monotonic() - since_s > STUCK_S:
            os.kill(pid, signal.SIGKILL)
            return b"", True


def _fast() -> str | None:
    """A folder in memory, where there is one."""
    return "/dev/shm" if os.access("/dev/shm", os.W_OK) else None


if __name__ == "__main__":
    sys.exit(main())
