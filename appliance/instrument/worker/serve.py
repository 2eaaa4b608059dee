"""The child's side of the worker: messages in, clouds out, until the pipe closes.

An error ends the process with a last message that names it; the parent starts another.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory

import numpy as np

from appliance.instrument.capture.store import FrameStore
from appliance.instrument.worker.memory import (
    LivePicture,
    SharedPoints,
    give_back_memory,
    limit_memory,
    share_freed_memory,
)
from appliance.instrument.worker.messages import (
    Begin,
    CloudCopied,
    Drop,
    Finish,
    FrameStored,
    FromWorker,
    Keep,
    LookAt,
    Ping,
    Pong,
    Ready,
    ToWorker,
)
from appliance.instrument.worker.neighbours import LiveGuide, Neighbours
from appliance.measure import (
    SIDES,
    AcquisitionSettings,
    Bracket,
    Calibration,
    CoarseCloud,
    Fault,
    FaultCode,
    FullCloud,
    News,
    PatternSequence,
    Pipeline,
    PointTable,
    ProcessedSequence,
    ReconstructionFailure,
    SequenceFact,
    SequenceProcessor,
    StereoNoise,
    Water,
    WorkerFailure,
    decode_calibration,
    remaining_kernels,
    watch_compiler,
)

NICENESS = 5
"""Priority of the process, below the service's cycle and the cameras."""


def work(
    pipe: Connection,
    calibration: bytes,
    water: Water,
    sequence: PatternSequence,
    noise: StereoNoise,
    store: tuple[str, int, int, int],
    results: str,
    headroom_mb: float,
) -> None:
    """Run the worker, as the child's main function.

    ``headroom_mb``: memory that it may still allocate once it is warm.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the service decides when to end
    os.nice(NICENESS)
    share_freed_memory()
    name, frames, height_px, width_px = store
    memory = SharedMemory(name=results)
    frame_store = FrameStore(frames, height_px, width_px, attach_to=name)
    try:
        # In a separate function, whose views end with it: otherwise the shared memory cannot be closed.
        _work(
            pipe,
            decode_calibration(calibration),
            water,
            sequence,
            noise,
            frame_store,
            memory,
            headroom_mb,
        )
    except (EOFError, OSError):
        pass  # the parent closed the pipe: the normal end
    finally:
        gc.collect()  # reference cycles keep their views until then
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
    points = SharedPoints(left.width_px, left.height_px)
    with Pipeline(calibration, water, sequence, table=points.full(memory.buf), noise=noise) as pipeline:
        processor = SequenceProcessor(pipeline, calibration, water)
        # Warm-up, so that the first real scan is as fast as the others.
        with _missing("scipy.linalg"):
            nothing = np.zeros(store.shape, np.uint8)
            with watch_compiler() as compiled:
                processor.process(dict.fromkeys(SIDES, nothing), AcquisitionSettings())
        give_back_memory()
        remaining: tuple[Callable[[], object], ...] = (
            *remaining_kernels(sequence),
            give_back_memory,
            partial(limit_memory, headroom_mb),
        )
        if compiled():
            # Now instead of in the pauses of the first scans: compiling takes half a minute, loading a fraction of 1 s.
            for run in remaining:
                run()
            remaining = ()
        pipe.send(Ready())
        neighbours = Neighbours(calibration, water, sequence, pipeline.coarse_stride)
        try:
            onlooker = LiveGuide(calibration, water, neighbours)
            picture = LivePicture(memory.buf, points.capacity)
            coarse = points.coarse(memory.buf)
            Server(pipe, processor, store, coarse, remaining, neighbours, (onlooker, picture)).serve()
        except (EOFError, OSError):
            raise
        except Exception as error:  # the last place where it can be reported
            pipe.send(WorkerFailure(f"{type(error).__name__}: {error}"))


@contextmanager
def _missing(module: str) -> Iterator[None]:
    """Let an import of ``module`` fail inside, unless it is loaded already.

    With its first kernel numba imports all of SciPy's linear algebra, only to see whether ``np.dot`` could be compiled
    (``numba.np.arraymath``): a sixth of the worker's start and 9 MB, for a function that no kernel here uses.
    """
    if module in sys.modules:
        yield
        return
    sys.modules[module] = None  # type: ignore[assignment]  # the documented way: the import raises ModuleNotFoundError
    try:
        yield
    finally:
        del sys.modules[module]


class Server:
    """Executes the messages in order. A sequence that is dropped, or followed by another, is not finished."""

    def __init__(
        self,
        pipe: Connection,
        processor: SequenceProcessor,
        store: FrameStore,
        coarse: PointTable,
        remaining: Iterable[Callable[[], object]] = (),
        neighbours: Neighbours | None = None,
        aiming: tuple[LiveGuide, LivePicture] | None = None,
    ) -> None:
        """Prepare to serve.

        ``coarse``: the parent's table for coarse clouds. ``remaining``: functions that load the rest, called one by one
        in pauses. ``neighbours``: compares scans; ``None``: they are not compared. ``aiming``: guidance, and the live
        image's place; ``None``: there is no guidance.
        """
        self._pipe, self._processor, self._store = pipe, processor, store
        self._coarse = coarse
        self._neighbours = neighbours
        self._aiming = aiming
        self._remaining: deque[Callable[[], object]] = deque(remaining)
        self._in_hand = False
        """True if a sequence was begun and is neither finished nor dropped."""
        self._ticket = 0
        """Ticket of the current sequence."""
        self._failed = False
        self._steps: Iterator[SequenceFact] | None = None
        """Remaining steps of the scan's first sequence; ``None``: all of them."""
        self._first: ProcessedSequence | None = None
        """The first sequence of the current scan, once a second one was begun."""
        self._second = False
        """True if the arriving frames are the second sequence's."""
        self._put_back: deque[ToWorker] = deque()

    def serve(self) -> None:
        """Serve until the pipe closes: then EOFError or OSError is raised."""
        while True:
            message = self._put_back.popleft() if self._put_back else self._next_message()
            try:
                self._do(message)
            except ValueError as error:  # the frames have a wrong form; those of the next scan may be right
                self._failed, self._in_hand, self._steps = True, False, None
                self._send_fact(ReconstructionFailure(Fault(FaultCode.RECONSTRUCTION_FAILED, str(error))))

    def _next_message(self) -> ToWorker:
        """Return the next message.

        While there is none, and no sequence in hand: load the rest, then compare scans, then evaluate live images.
        """
        while not self._in_hand and not self._pipe.poll(0.0) and self._do_one_piece():
            pass
        message: ToWorker = self._pipe.recv()
        return message

    def _do_one_piece(self) -> bool:
        """Do one piece of deferred work; return False if there is none."""
        if self._remaining:
            self._remaining.popleft()()
        elif self._neighbours is not None and self._neighbours.has_work:
            overlap = self._neighbours.go_on()
            if overlap is not None:
                self._send_fact(overlap)
        elif self._aiming is not None and self._aiming[0].has_work:
            # Guidance comes last, since the overlap of a scan is already awaited.
            guidance = self._aiming[0].go_on()
            if guidance is not None:
                self._send(guidance)
        else:
            return False
        return True

    def _do(self, message: ToWorker) -> None:
        match message:
            case Begin(ticket, settings, second, belongs_to):
                self._ticket, self._failed, self._second = ticket, False, second
                self._in_hand = True
                if self._neighbours is not None and not second:
                    self._neighbours.begin(belongs_to)
                if self._aiming is not None:
                    self._aiming[0].begin()
                if not second:
                    self._first = None
                elif self._first is None:
                    # A restarted worker gets the frames of the first sequence again, and computes its points here.
                    self._first = self._work_through_first()
                self._steps = None
                self._processor.begin(settings)
            case FrameStored(side, index) if not self._failed:
                self._processor.push(side, self._store.frames(side, second=self._second), index)
            case Finish() if not self._failed:
                self._in_hand = False
                self._finish()
            case Drop():
                # Later messages of this sequence (frames, Finish) are skipped until the next Begin.
                self._failed, self._in_hand = True, False
            case Keep() if self._neighbours is not None:
                self._neighbours.keep()
            case LookAt(shape=shape) if self._aiming is not None:
                onlooker, picture = self._aiming
                onlooker.look(message, picture.copy(shape))
            case Ping():
                self._send(Pong())
            case _:
                pass

    def _send(self, message: FromWorker) -> None:
        self._pipe.send(message)

    def _send_fact(self, fact: SequenceFact) -> None:
        self._send(News(self._ticket, fact))

    def _finish(self) -> None:
        """Send each fact of the sequence as soon as it is known, until another order ends the work on it."""
        if self._first is None:
            facts = self._steps = self._processor.steps()
        else:
            facts = self._processor.bracket_steps(self._first)
        for fact in facts:
            match fact:
                case CoarseCloud(found):
                    coarse = self._processor.cloud(found)
                    if self._neighbours is not None:
                        self._neighbours.coarse(coarse)
                    # In another place than the full cloud, so that computing goes on before the parent has read it.
                    self._send_fact(replace(fact, cloud=self._coarse.put(coarse)))
                case FullCloud() | Bracket():
                    self._send_fact(fact)
                    # Copied while the parent copies the points.
                    if self._neighbours is not None and self._first is None:
                        self._neighbours.add_full(self._store.frames("left"))
                    self._await_copy()
                    return
                case _:
                    self._send_fact(fact)
            if self._is_unwanted():
                return

    def _work_through_first(self) -> ProcessedSequence:
        """Do the remaining work on the first sequence without reporting; all of it after a restart.

        Raises ValueError.
        """
        if not self._processor.finished:
            for _ in self._steps or self._processor.steps():
                pass
        return self._processor.hold()

    def _is_unwanted(self) -> bool:
        """Return True if the parent has dropped the current sequence, or begun another one; never waits."""
        while self._pipe.poll(0.0):
            if self._ends_work(self._pipe.recv()):
                return True
        return False

    def _await_copy(self) -> None:
        """Wait until the cloud was copied, or is no longer needed."""
        while True:
            # The parent copies in its next cycle; until then the table in shared memory must not change.
            message: ToWorker = self._pipe.recv()
            if message == CloudCopied(self._ticket) or self._ends_work(message):
                return

    def _ends_work(self, message: ToWorker) -> bool:
        """Handle a message that arrives during work on a sequence; return True if it ends that."""
        match message:
            case Begin() | Drop():
                # `serve` executes it next.
                self._put_back.append(message)
                return True
            case Keep():
                # A scan can be kept only after the work on it.
                self._put_back.append(message)
            case Ping():
                self._send(Pong())
            case _:
                pass
        return False
