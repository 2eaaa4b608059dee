"""The parent's end of the worker, step by step: what it says to the process, how long it waits, and when it starts it again.

Below it lies a machine of this test's own: it starts processes that say what the test tells them, at the end of real pipes, and its
``/proc`` holds what the test writes. Time stands still unless the test moves it.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
from collections.abc import Iterator
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from appliance.instrument.capture.store import FrameStore
from appliance.instrument.worker import child
from appliance.instrument.worker import messages as say
from appliance.instrument.worker.messages import WorkOrder
from appliance.instrument.worker.process import ReconstructionWorker, WorkerEvent
from appliance.measure.cloud import CloudLocation, CloudSummary
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.guidance import LOST, Overlap
from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.exposure import Exposure
from appliance.measure.light.patterns import build_sequence
from appliance.measure.news import (
    Bracket,
    CoarseCloud,
    FullCloud,
    LiveGuidance,
    News,
    PatternIdentity,
    ReconstructionFailure,
    ScanOverlap,
    SequenceFact,
    Verdicts,
    WorkerFailure,
    WorkProgress,
)
from appliance.measure.verdict import Judgement, Verdict
from tests.drivers.output.kernel import Time
from tests.support import synthetic

N = 3
SECOND = AcquisitionSettings(Exposure(3_200))
FOUND = CloudLocation(((0, 0),), CloudSummary(0, None, None, None, None))
SAID = Judgement(Verdict("identity", True))
WRONG = Judgement(Verdict("identity", False), Fault(FaultCode.PATTERN_WRONG))
RIGHT, COARSE, FULL = PatternIdentity(SAID), CoarseCloud(FOUND, 0.1), FullCloud(FOUND, (SAID,), 0.3)
PROGRESS, JUDGED = WorkProgress("light"), Verdicts((SAID,), 0.2)
UNFIT = ReconstructionFailure(Fault(FaultCode.RECONSTRUCTION_FAILED, "frame 3 was pushed"))


@dataclass(frozen=True)
class Ends:
    code: int


class ScriptedProcess:
    """A process as ``multiprocessing`` shows it, at the other end of a real pipe: it says what the test tells it to."""

    def __init__(self, machine: Machine, arguments: tuple[Any, ...]) -> None:
        self._machine, self._theirs, self.arguments = machine, arguments[2], pickle.loads(arguments[3])
        self.pid, self.exitcode = 4711, 0
        self.killed = False
        self.waits_s: list[float] = []
        """How long it was waited for, each time."""

    def start(self) -> None:
        if not self._machine.room:
            raise OSError(12, "Cannot allocate memory")
        self.pipe = Connection(os.dup(self._theirs.fileno()))
        self._machine.started.append(self)

    def join(self, timeout_s: float) -> None:
        self.waits_s.append(timeout_s)

    def is_alive(self) -> bool:
        return self.waits_s == [0.0]  # with a moment's patience it has ended, since its pipe was closed

    def kill(self) -> None:
        self.killed = True


class Machine:
    """What lies below the worker: starting processes, pipes, and the files of ``/proc``."""

    def __init__(self, proc: Path) -> None:
        self.room = True
        self.started: list[ScriptedProcess] = []
        self.Pipe = multiprocessing.Pipe
        self._proc = proc / "4711"
        self._proc.mkdir()

    def Process(self, *, args: tuple[Any, ...], **_: object) -> ScriptedProcess:  # noqa: N802  # multiprocessing's name
        return ScriptedProcess(self, args)

    def use(self, cpu_s: float, memory_mb: float | None) -> None:
        """Write what the process takes as proc(5) says it."""
        ticks = round(cpu_s * os.sysconf("SC_CLK_TCK"))
        (self._proc / "stat").write_text(f"4711 (kf-reconstruct) S {'0 ' * 10}{ticks // 3} {ticks - ticks // 3} 0 0")
        kb = "" if memory_mb is None else f"RssAnon:\t{round(1000 * memory_mb) - 40_000} kB\nRssFile:\t40000 kB\n"
        (self._proc / "status").write_text(f"Name:\tpython\n{kb}RssShmem:\t9000000 kB\n"[: None if kb else 13])


@dataclass
class Desk:
    worker: ReconstructionWorker
    machine: Machine
    time: Time
    cpu_s: float = 0.0
    memory_mb: float | None = 100.0
    asked: list[int] = field(default_factory=list)
    """At each look at the process's memory, the time."""

    @property
    def child(self) -> ScriptedProcess:
        return self.machine.started[-1]

    def after(self, seconds: float, *says: object) -> WorkerEvent | None:
        self.time.sleep_s(seconds)
        for one in says:
            if isinstance(one, Ends):
                self.child.exitcode = one.code
                self.child.pipe.close()
            else:
                self.child.pipe.send(one)
        return self.worker.poll()

    def told(self) -> list[object]:
        heard: list[object] = []
        while self.child.pipe.poll(0.0):
            heard.append(self.child.pipe.recv())
        return heard

    def scan(self, number: int) -> None:
        self.worker.begin(number)
        self.worker.finish()

    def told_of(self, number: int, *facts: SequenceFact) -> WorkerEvent | None:
        """The process tells these facts of the sequence with that ticket."""
        return self.after(0.0, *(News(number, fact) for fact in facts))

    def ready(self) -> None:
        assert self.after(0.0, say.Ready()) == say.Ready()


@pytest.fixture
def desk(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Desk]:
    machine, time = Machine(tmp_path), Time()
    monkeypatch.setattr(multiprocessing, "get_context", lambda kind: machine)
    order = WorkOrder(synthetic.calibration(), synthetic.WATER, build_sequence(16))
    with FrameStore(N, 300, 400) as store:
        worker = ReconstructionWorker(order, store, time)
        made = Desk(worker, machine, time)

        def below(path: str) -> Path:
            made.machine.use(made.cpu_s, made.memory_mb)
            if path.endswith("status"):
                made.asked.append(time.ns)
            return tmp_path / path.removeprefix("/proc/")

        monkeypatch.setattr(child, "Path", below)
        with worker:
            yield made
            last = made.child if worker.pid is not None else None
    if last is not None:
        assert (last.waits_s, last.killed) == ([2.0], False), "one that is well is given time to end"


def frames() -> list[object]:
    return [say.FrameStored(side, k) for k in range(N) for side in ("left", "right")]


def begin(ticket: int, settings: AcquisitionSettings | None = None, *, second: bool = False) -> say.Begin:
    return say.Begin(ticket, settings or AcquisitionSettings(), second)


def failed(event: WorkerEvent | None, why: str) -> int | None:
    """The scan that was lost, ``None``: none; the event must be a failure that says ``why``."""
    match event:
        case WorkerFailure(text):
            assert why in text
            return None
        case News(number, ReconstructionFailure(fault)):
            assert fault.code is FaultCode.RECONSTRUCTION_FAILED
            assert why in fault.detail
            return number
        case _:
            raise AssertionError(f"{event} is no failure")


def test_a_scan_from_its_first_frame_to_its_full_cloud(desk: Desk) -> None:
    desk.ready()
    desk.worker.begin(7)
    desk.worker.frame("left", 0)
    desk.worker.finish()
    assert desk.told() == [begin(1), say.FrameStored("left", 0), say.Finish()]
    assert desk.told_of(1, RIGHT) == News(7, RIGHT), "as it was told, with the number of the scan"
    assert [desk.worker.coarse] == [None]
    assert desk.told_of(1, COARSE) == News(7, COARSE)
    coarse = desk.worker.coarse
    assert (coarse and coarse.points_mm.shape, desk.worker.full) == ((0, 3), None)
    assert desk.told() == [], "nobody waits until the coarse one was seen"
    assert desk.told_of(1, *[PROGRESS] * 10, JUDGED) == News(7, JUDGED), "at the same heartbeat"
    assert desk.told_of(1, FULL) == News(7, FULL)
    assert desk.worker.full is not None
    assert desk.told() == [say.CloudCopied(1)]
    share = ScanOverlap(Overlap(0.5), 0.1)
    assert desk.told_of(1, share) == News(7, share)
    desk.worker.begin(8)
    assert [desk.worker.coarse, desk.worker.full] == [None, None]
    desk.worker.drop()
    desk.told()
    assert desk.after(3600.0, say.Pong()) is None, "nothing more is awaited"
    assert desk.worker.restarts == 0


def test_what_is_said_of_an_earlier_scan_and_of_one_that_was_dropped_is_of_no_interest(desk: Desk) -> None:
    desk.ready()
    desk.worker.begin(7)
    desk.worker.begin(8)
    assert desk.told_of(1, RIGHT) is None
    assert desk.told_of(2, RIGHT) == News(8, RIGHT)
    desk.worker.finish()
    desk.worker.drop()
    assert desk.told()[-1] == say.Drop()
    assert desk.told_of(2, JUDGED) is None
    assert desk.after(20.0) is None, "no cloud is awaited any more"
    desk.worker.finish()
    assert say.Finish() not in desk.told(), "there is nothing to finish"


def test_wrong_patterns_and_frames_that_are_no_sequence_end_the_scan_and_nothing_is_awaited(desk: Desk) -> None:
    desk.ready()
    desk.scan(7)
    assert desk.told_of(1, PatternIdentity(WRONG)) == News(7, PatternIdentity(WRONG))
    assert desk.told_of(1, JUDGED) is None
    assert desk.after(20.0, say.Pong()) is None
    desk.scan(8)
    assert failed(desk.told_of(2, UNFIT), "frame 3 was pushed") == 8
    assert desk.after(20.0, say.Pong()) is None
    assert (desk.worker.restarts, len(desk.machine.started)) == (0, 1)


def test_a_process_that_says_what_is_no_answer_is_started_again(desk: Desk) -> None:
    desk.ready()
    assert failed(desk.after(0.0, "hello"), "str") is None
    assert failed(desk.after(0.0, WorkerFailure("MemoryError")), "MemoryError") is None
    assert failed(desk.after(0.0, Ends(9)), "code 9") is None
    assert desk.worker.restarts == 3
    assert len(desk.machine.started) == 4


def test_a_start_may_take_four_minutes_and_a_scan_that_waits_for_it_gets_its_time_when_it_is_ready(desk: Desk) -> None:
    desk.after(239.9)
    assert desk.worker.restarts == 0
    desk.after(0.2)
    assert desk.worker.restarts == 1
    desk.scan(7)
    assert desk.after(200.0) is None
    desk.ready()
    assert desk.after(9.9) is None
    assert failed(desk.after(0.2), "10 s") is None


def test_each_step_of_a_scan_may_take_ten_seconds_and_one_that_is_told_begins_anew(desk: Desk) -> None:
    desk.ready()
    desk.scan(7)
    assert desk.after(9.9, News(1, PROGRESS)) is None
    assert desk.after(9.9, News(1, JUDGED)) is not None
    assert desk.after(9.9) is None
    assert desk.worker.answers
    assert failed(desk.after(0.2), "it sent nothing for 10 s") is None
    assert desk.told()[-len(frames()) - 2 :] == [begin(1), *frames(), say.Finish()], "its frames are still there"


@pytest.mark.parametrize(("used_s", "steps"), [(0.51, 5), (0.49, 0)])
def test_a_step_that_computes_is_waited_for_a_minute(desk: Desk, used_s: float, steps: int) -> None:
    desk.cpu_s = 50.0
    desk.ready()
    desk.scan(7)
    for _ in range(steps):
        desk.cpu_s += used_s
        assert desk.after(10.1) is None
    desk.cpu_s += 5.0 if steps else used_s
    why = "computed for 60 s" if steps else "it sent nothing for 10 s"
    assert failed(desk.after(10.1), why) is None


def test_an_idle_process_is_asked_once_a_second_and_has_five_seconds_to_answer(desk: Desk) -> None:
    desk.ready()
    assert desk.after(0.9) is None
    assert desk.told() == []
    assert desk.after(0.2) is None
    assert desk.told() == [say.Ping()]
    assert desk.after(4.9) is None
    assert desk.told() == [], "asked once"
    assert desk.after(0.0, say.Pong()) is None
    assert desk.after(1.1) is None
    assert desk.told() == [say.Ping()]
    assert desk.worker.answers
    assert failed(desk.after(5.1), "5 s") is None
    hung = desk.machine.started[0]
    assert (hung.waits_s[0], hung.killed) == (0.0, True), "the heartbeat waits for nothing"


def test_the_watchdog_waits_longer_than_the_worker_does_itself(desk: Desk) -> None:
    def answers_after(*seconds: float) -> list[bool]:
        found = []
        for waited_s in seconds:
            desk.time.sleep_s(waited_s)
            found.append(desk.worker.answers)
        return found

    desk.ready()
    desk.after(1.1)
    assert answers_after(9.9, 0.2) == [True, False], "a question that is not answered"
    desk.after(0.0, say.Pong())
    assert answers_after(0.0) == [True]
    desk.scan(7)
    assert answers_after(14.9, 0.2) == [True, False], "a cloud that does not come"
    desk.machine.room = False
    failed(desk.after(0.0, WorkerFailure("a")), "a")
    assert answers_after(0.0) == [True], "it is known not to be there"


def test_memory_is_looked_at_twice_a_second_and_a_compiler_may_take_more(desk: Desk) -> None:
    desk.memory_mb = 1500.0
    assert desk.after(0.0) is None, "it may compile kernels"
    desk.memory_mb = 1000.0
    desk.ready()
    begun = len(desk.asked)
    for _ in range(24):
        assert desk.after(0.25, *([say.Pong()] if desk.told() else [])) is None
    assert 10 <= len(desk.asked) - begun <= 12
    desk.memory_mb = None
    assert desk.after(0.5) is None, "it has just ended, which the pipe will say"
    desk.memory_mb = 1001.0
    assert failed(desk.after(0.5), "1001 MB") is None
    desk.memory_mb = 1501.0
    assert failed(desk.after(0.5), "1501 MB") is None


@pytest.mark.parametrize(("used_s", "on"), [(0.09, False), (0.11, True)])
def test_the_first_start_gets_on_if_it_takes_a_twentieth_of_a_processor(desk: Desk, used_s: float, on: bool) -> None:
    desk.time.sleep_s(1.9)
    desk.cpu_s += used_s
    assert not desk.worker.gets_on(), "it was only just started"
    desk.time.sleep_s(0.1)
    desk.worker.poll()
    assert desk.worker.gets_on() == on
    assert not desk.worker.gets_on(), "it was only just asked"


def test_only_the_first_start_gets_on(desk: Desk) -> None:
    def gets_on() -> bool:
        desk.cpu_s += 5.0
        desk.time.sleep_s(5.0)
        return desk.worker.gets_on()

    assert gets_on()
    desk.after(0.0, WorkerFailure("once"))
    assert not gets_on(), "a start that failed before may fail for ever"
    desk.worker.change(desk.worker.order)
    assert gets_on()
    desk.ready()
    assert not gets_on(), "it is no start any more"


def test_a_scan_in_work_is_processed_again_once_and_then_given_up(desk: Desk) -> None:
    desk.ready()
    desk.scan(7)
    assert failed(desk.after(0.0, WorkerFailure("a")), "a") is None
    desk.ready()
    assert failed(desk.after(0.0, WorkerFailure("b")), "b") == 7
    desk.told()
    desk.ready()
    assert desk.told() == [], "nobody asks for it any more"
    assert desk.told_of(1, RIGHT) is None


def test_a_scan_that_is_lost_before_its_frames_are_there_is_told_when_they_are(desk: Desk) -> None:
    desk.ready()
    for scan, said, why in ((7, [WorkerFailure("a"), WorkerFailure("b")], "b"), (8, [News(2, UNFIT)], "pushed")):
        desk.worker.begin(scan)
        assert [failed(desk.after(0.0, one), "") for one in said] == [None] * len(said)
        desk.ready()
        desk.worker.finish()
        assert say.Finish() not in desk.told()
        assert failed(desk.worker.poll(), why) == scan
        assert desk.after(20.0, say.Pong()) is None, "nothing more is awaited"


def test_frames_that_come_while_a_process_is_new_are_told_all_at_once(desk: Desk) -> None:
    """Frame 1 would be the first it hears of."""
    desk.ready()
    desk.worker.begin(7)
    desk.worker.frame("left", 0)
    desk.after(0.0, WorkerFailure("a"))
    desk.told()
    desk.worker.frame("right", 0)
    assert desk.told() == []
    desk.worker.finish()
    assert desk.told() == [begin(1), *frames(), say.Finish()]
    desk.worker.begin(8)
    desk.worker.frame("left", 0)
    assert desk.told() == [begin(2), say.FrameStored("left", 0)]


def test_after_four_starts_without_a_cloud_it_stays_down_until_the_next_scan(desk: Desk) -> None:
    for _ in range(3):
        failed(desk.after(0.0, WorkerFailure("a")), "a")
    desk.worker.begin(7)
    assert failed(desk.after(0.0, WorkerFailure("a")), "4 times") is None
    assert (desk.worker.pid, desk.worker.poll(), len(desk.machine.started)) == (None, None, 4)
    desk.worker.finish()
    assert failed(desk.worker.poll(), "4 times") == 7, "told when somebody waits for its points"
    assert desk.worker.poll() is None
    desk.worker.begin(8)
    assert len(desk.machine.started) == 5
    failed(desk.after(0.0, WorkerFailure("a")), "")


def test_a_full_cloud_makes_good_for_the_failures_before_and_a_coarse_one_does_not(desk: Desk) -> None:
    for full, fact in ((False, COARSE), (True, FULL)):
        for _ in range(2):
            desk.after(0.0, WorkerFailure("a"))
        desk.ready()
        desk.worker.begin(7)
        desk.told_of(desk.worker._ticket, fact)
        assert desk.worker._fruitless == (0 if full else 2)
        desk.worker.change(desk.worker.order)


def test_a_machine_without_room_for_a_process_says_so_and_is_asked_again(desk: Desk) -> None:
    desk.machine.room = False
    assert failed(desk.after(0.0, WorkerFailure("a")), "a") is None
    assert len(desk.machine.started) == 1
    assert failed(desk.worker.poll(), "Cannot allocate memory") is None
    desk.machine.room = True
    failed(desk.worker.poll(), "")
    assert (desk.worker.pid, desk.worker.poll(), desk.worker.restarts) == (4711, None, 3)


def test_another_order_starts_another_process_in_which_no_scan_is_in_work(desk: Desk) -> None:
    desk.ready()
    desk.worker.begin(7)
    order = WorkOrder(synthetic.calibration(), synthetic.WATER, build_sequence(32))
    with FrameStore(N + 1, 300, 400) as other:
        desk.worker.change(order, other)
        known = (build_sequence(32), order.noise, (other.name, N + 1, 300, 400), desk.machine.started[0].arguments[5])
        assert desk.child.arguments[2:6] == known
    assert desk.child.arguments[6] == 1000.0
    assert (desk.worker.order, desk.worker.restarts) == (order, 0)
    assert desk.told_of(1, RIGHT) is None


def whole(desk: Desk) -> None:
    desk.ready()
    desk.scan(7)
    desk.told_of(1, FULL)
    desk.told()


@pytest.mark.parametrize("with_cloud", [False, True])
def test_a_second_exposure_follows_the_first_without_its_frames(desk: Desk, with_cloud: bool) -> None:
    whole(desk)
    desk.worker.begin_second(7, SECOND)
    desk.worker.finish()
    assert desk.told() == [begin(2, SECOND, second=True), say.Finish()]
    bracket = Bracket(FOUND if with_cloud else None, SAID, (SAID,), 0.5)
    assert desk.told_of(2, PROGRESS, bracket) == News(7, bracket)
    assert (desk.worker.full is not None) == with_cloud
    assert desk.told() == [say.CloudCopied(2)]
    assert desk.after(3600.0, say.Pong()) is None, "nothing more is awaited"
    assert desk.worker.restarts == 0


def test_a_process_that_does_not_know_the_first_exposure_is_told_of_it(desk: Desk) -> None:
    whole(desk)
    desk.worker.begin_second(7, SECOND)
    desk.worker.frame("left", 0)
    desk.after(0.0, WorkerFailure("a"))
    desk.told()
    desk.worker.finish()
    assert desk.told() == [begin(2), *frames(), begin(2, SECOND, second=True), *frames(), say.Finish()]
    desk.worker.drop()
    desk.told()
    desk.worker.begin_second(7, SECOND)
    assert desk.told() == [begin(3), *frames(), begin(3, SECOND, second=True)]
    desk.worker.reprocess(8)
    assert desk.told() == [begin(4), begin(4), *frames(), say.Finish()], "another scan has no first exposure"


def test_a_process_that_still_loads_is_waited_for_and_has_compiled_before(desk: Desk) -> None:
    desk.memory_mb = 1400.0
    assert desk.after(1.5) is None, "it may compile"
    desk.memory_mb = 900.0
    desk.ready()
    for _ in range(20):
        desk.cpu_s += 2.0
        assert desk.after(3.0) is None, "it loads, and reads no messages"
    # A scan in work keeps it from loading; so its memory is bounded before it has loaded.
    desk.memory_mb = 1400.0
    assert failed(desk.after(1.5), "1400 MB") is None
    desk.memory_mb = 100.0
    desk.ready()
    assert desk.after(1.5) is None, "it is asked"
    desk.cpu_s += 2.0
    assert desk.after(6.0) is None, "it computes"
    assert failed(desk.after(6.0), "sent nothing") is None, "it hangs"


def test_a_process_that_loads_for_ever_is_started_again(desk: Desk) -> None:
    desk.ready()
    assert desk.after(1.1) is None, "it is asked"
    for waited_s, event in ((59.9, type(None)), (0.2, WorkerFailure)):
        desk.cpu_s += 300.0
        assert isinstance(desk.after(waited_s), event), "it does not answer"


PICTURE = np.full((300, 400), 9, np.uint8)


def test_one_live_picture_at_a_time_is_handed_over_and_its_answer_says_when_it_was_taken(desk: Desk) -> None:
    assert not desk.worker.look(PICTURE, 3), "not before it is ready"
    desk.ready()
    assert desk.worker.look(PICTURE, 3)
    assert desk.told() == [say.LookAt(desk.time.ns, (300, 400), 3)]
    taken_ns = desk.time.ns
    desk.time.sleep_s(1.0)
    assert not desk.worker.look(PICTURE, 3), "the first one is still looked at"
    assert desk.told() == []
    answer = LiveGuidance(LOST, taken_ns, 0.1)
    assert desk.after(0.2, answer) == answer
    assert desk.after(0.0, answer) is None, "said at once again"
    assert desk.worker.look(PICTURE, 3)
    assert desk.told() == [say.LookAt(desk.time.ns, (300, 400), 3)]
    assert desk.after(0.0, answer) is None, "said twice"
    desk.time.sleep_s(5.1)
    assert desk.worker.look(PICTURE, 3), "an answer that does not come is not waited for for ever"
    assert failed(desk.after(0.0, Ends(1)), "code 1") is None
    assert not desk.worker.look(PICTURE, 3)
    desk.ready()
    assert desk.worker.look(PICTURE, 3), "a new process owes no answer"


def test_looking_takes_a_third_of_a_processor_at_most(desk: Desk) -> None:
    """0.3 s in every 0.9 s, and not more often than twice and a half a second."""
    desk.ready()
    for took_s, cpu_s, too_early_s, enough_s in ((0.3, 0.3, 0.55, 0.1), (0.1, 0.01, 0.0, 0.35)):
        assert desk.worker.look(PICTURE, 3)
        desk.after(took_s, LiveGuidance(None, desk.time.ns, cpu_s))
        desk.time.sleep_s(too_early_s)
        assert not desk.worker.look(PICTURE, 3)
        desk.time.sleep_s(enough_s)
    assert desk.worker.look(PICTURE, 3)


def test_a_scan_that_begins_awaits_no_guidance_and_none_is_asked_for_while_its_points_are_computed(desk: Desk) -> None:
    desk.ready()
    assert desk.worker.look(PICTURE, 3)
    desk.worker.begin(7)
    assert desk.after(0.0, LiveGuidance(LOST, desk.time.ns, 0.1)) is None, "of the place before"
    desk.worker.finish()
    assert not desk.worker.look(PICTURE, 3)
    assert desk.told_of(1, FULL) is not None
    assert desk.worker.look(PICTURE, 3)
