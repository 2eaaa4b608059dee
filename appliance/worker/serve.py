"""Owns the child's side of the warm process: messages in, clouds out, until the pipe closes.

Whatever goes wrong here ends the process with a last message that names it; the parent starts another.
"""

from __future__ import annotations

import gc
import os
import resource
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from typing import Any

import numpy as np

from appliance.calibration.file import Calibration, decode
from appliance.capture.store import FrameStore
from appliance.optics.water import Water
from appliance.patterns.sequence import PatternSequence, build_sequence
from appliance.reconstruct.pipeline import Pipeline
from appliance.reconstruct.table import Found, PointTable
from appliance.scan.acquisition import AcquisitionSettings
from appliance.scan.noise import StereoNoise
from appliance.scan.verdict import Judgement, Verdict
from appliance.worker.pair import Sequence
from appliance.worker.scan_work import ScanWork
from appliance.worker.warm import run_empty_scan, run_what_an_empty_scan_does_not

NICENESS = 5
"""Behind the heartbeat and the cameras."""


def work(
    pipe: Connection,
    calibration: bytes,
    water: Water,
    sequence: tuple[int, int, int],
    noise: StereoNoise,
    store: tuple[str, int, int, int],
    results: str,
    headroom_mb: float,
) -> None:
    """The child's main function. ``headroom_mb``: memory it may still ask for once it is warm, beyond what it has then."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the service decides when to end
    os.nice(NICENESS)
    name, frames, height_px, width_px = store
    memory = SharedMemory(name=results)
    frame_store = FrameStore(frames, height_px, width_px, attach_to=name)
    try:
        # In a function of its own: with a view of it alive, shared memory cannot be closed.
        _work(pipe, decode(calibration), water, build_sequence(*sequence), noise, frame_store, memory, headroom_mb)
    except (EOFError, OSError):
        pass  # the parent closed the pipe: the normal end
    finally:
        gc.collect()  # what points at itself keeps its views until then
        frame_store.close()
        memory.close()


def _work(
    pipe: Connection,
    calibration: Calibration,
    water: Water,
    sequence: PatternSequence,
    noise: StereoNoise,
    store: FrameStore,
    memory: SharedMemory,
    headroom_mb: float,
) -> None:
    left = calibration.rig.left
    with Pipeline(
        calibration, water, sequence, table=PointTable(left.width_px * left.height_px, memory.buf), noise=noise
    ) as pipeline:
        scan_work = ScanWork(pipeline, calibration, water)
        # So that the first real scan is as fast as the others.
        with _missing("scipy.linalg"):
            nothing = np.zeros(store.shape, np.uint8)
            run_empty_scan(scan_work, nothing)
            run_what_an_empty_scan_does_not(sequence, nothing)
        limit_memory(headroom_mb)
        pipe.send(("ready",))
        try:
            Server(pipe, scan_work, store).serve()
        except (EOFError, OSError):
            raise
        except Exception as error:  # the one place where it can still be named
            pipe.send(("crashed", f"{type(error).__name__}: {error}"))


@contextmanager
def _missing(module: str) -> Iterator[None]:
    """Importing ``module`` fails inside, unless it is there already.

    With its first kernel numba imports all of SciPy's linear algebra, only to see whether ``np.dot`` could be compiled
    (``numba.np.arraymath``): a sixth of the worker's start and 9 MB, for something that no kernel here uses.
    """
    if module in sys.modules:
        yield
        return
    sys.modules[module] = None  # type: ignore[assignment]  # the documented way: the import raises ModuleNotFoundError
    try:
        yield
    finally:
        del sys.modules[module]


def limit_memory(headroom_mb: float) -> None:
    """Let the kernel refuse private memory beyond what this process has now; what it shares with others does not count.

    Faster than the parent's own measure: an allocation out of proportion fails here, before the machine runs out.
    """
    status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    held = next((int(line.split()[1]) * 1024 for line in status.splitlines() if line.startswith("VmData:")), None)
    if held is None:
        return
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    wanted = held + int(headroom_mb * 1e6)
    if hard == resource.RLIM_INFINITY or wanted < hard:
        resource.setrlimit(resource.RLIMIT_DATA, (wanted, hard))


class Server:
    """Does what the messages say, in order. A scan that is dropped, or followed by another, is not finished."""

    def __init__(self, pipe: Connection, scan_work: ScanWork, store: FrameStore) -> None:
        self._pipe, self._work, self._store = pipe, scan_work, store
        self._ticket = 0
        """Of the scan in work, as the parent numbers them."""
        self._failed = False
        self._first: Sequence | None = None
        """Of the scan in work, once a second sequence was begun."""
        self._second = False
        """The frames that come are the second sequence's."""
        self._put_back: deque[Any] = deque()

    def serve(self) -> None:
        """Until the pipe closes: then EOFError or OSError."""
        while True:
            message = self._put_back.popleft() if self._put_back else self._pipe.recv()
            try:
                self._do(message)
            except ValueError as error:  # the frames are not what was agreed; the next scan may be
                self._failed = True
                self._pipe.send(("failed", self._ticket, str(error)))

    def _do(self, message: Any) -> None:
        match message:
            case ("begin", int(ticket), AcquisitionSettings() as settings):
                self._ticket, self._failed, self._second, self._first = ticket, False, False, None
                self._work.begin(settings)
            case ("begin second", int(ticket), AcquisitionSettings() as settings):
                self._ticket, self._failed, self._second = ticket, False, True
                if self._first is None:
                    self._first = self._work_through_first()
                self._work.begin(settings)
            case ("frame", str(side), int(index)) if not self._failed:
                self._work.push(side, self._store.frames(side, second=self._second), index)
            case ("finish",) if not self._failed:
                self._finish()
            case ("drop",):
                self._failed = True
            case ("ping",):
                self._pipe.send(("pong",))
            case _:
                pass

    def _work_through_first(self) -> Sequence:
        """The first sequence as it was left; without a word where this process was started since. Raises ValueError."""
        if not self._work.finished:
            self._work.find_coarse()
            self._work.judge(self._say_step)
            if self._work.moved:
                self._work.compensate()
            self._work.find_full()
        return self._work.hold()

    def _finish_pair(self, first: Sequence) -> None:
        """One answer for the second sequence: what its judges say, and the cloud of both."""
        begun_s = time.process_time()
        judgements: tuple[Judgement, ...] = (self._work.identify(),)
        found: Found | None = None
        if (spoiled := judgements[0].fault) is not None:
            pair = Judgement(
                Verdict("pair", False, {}, "the second exposure's frames are not what they should be"), spoiled
            )
        else:
            self._work.find_coarse()
            judgements += self._work.judge(self._say_step)
            if self._work.moved:
                judgements = (judgements[0], *self._work.compensate())
            self._work.find_full()
            judgements = (judgements[0], *self._work.conclude())
            merged = self._work.merge_with(first)
            pair, found = merged.judgement, merged.found
        self._pipe.send(("merged", self._ticket, found, judgements, pair, time.process_time() - begun_s))
        self._await_taken()

    def _finish(self) -> None:
        """Everything that is to be said of the scan, as soon as it is known, until nobody wants to hear it any more."""
        if self._second and self._first is not None:
            self._finish_pair(self._first)
            return
        identity = self._work.identify()
        if identity.fault is not None:
            self._pipe.send(("spoiled", self._ticket, identity))
            return
        self._pipe.send(("identified", self._ticket))
        if self._answer(False, self._work.find_coarse):
            begun_s = time.process_time()
            judgements = (identity, *self._work.judge(self._say_step))
            windows = self._work.windows
            self._pipe.send(("judged", self._ticket, judgements, windows, time.process_time() - begun_s))
            if self._work.moved:
                begun_s = time.process_time()
                judgements = (identity, *self._work.compensate())
                self._pipe.send(("judged", self._ticket, judgements, None, time.process_time() - begun_s))
            self._answer(True, lambda: self._concluded(identity, judgements))

    def _concluded(self, identity: Judgement, said: tuple[Judgement, ...]) -> Found:
        """The full cloud; before it, what is said of the scan in its light, where that is something else than was ``said``."""
        found = self._work.find_full()
        judgements = (identity, *self._work.conclude())
        if [one.fault for one in judgements] != [one.fault for one in said]:
            self._pipe.send(("judged", self._ticket, judgements, None, 0.0))
        return found

    def _say_step(self) -> None:
        """A slow processor is told from a process that hangs."""
        self._pipe.send(("step", self._ticket))

    def _answer(self, full: bool, find: Callable[[], Found]) -> bool:
        """Say where the points are, and wait until they were copied; False when nobody wants them any more."""
        begun_s = time.process_time()
        found = find()
        self._pipe.send(("cloud", self._ticket, full, found, time.process_time() - begun_s))
        return self._await_taken()

    def _await_taken(self) -> bool:
        """Until what was found was copied; False when nobody wants it any more."""
        while True:
            match self._pipe.recv():
                case ("taken", int(ticket)) if ticket == self._ticket:
                    return True
                case ("begin" | "begin second" | "drop", *_) as message:
                    self._put_back.append(message)
                    return False
                case ("ping",):
                    self._pipe.send(("pong",))
                case _:
                    pass
