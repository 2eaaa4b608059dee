"""A child process: its life, what it takes of the machine, and how it keeps that small."""

from __future__ import annotations

import gc
import mmap
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pytest

from appliance.base.process_start import BLAS_THREADS
from appliance.instrument.worker.child import ChildGone, ChildProcess, cpu_s, own_memory_mb
from appliance.instrument.worker.memory import COMPILER, unwritten


def echo(pipe: Connection, first: str) -> None:
    """Say ``first``, then every message again; close the pipe and end on the word, or hang."""
    pipe.send(first)
    while True:
        match pipe.recv():
            case "end":
                pipe.close()
                time.sleep(0.1)
                os._exit(7)
            case "hang":
                pipe.close()
                time.sleep(60.0)
            case message:
                pipe.send(message)


@pytest.fixture
def child() -> Iterator[ChildProcess]:
    made = ChildProcess("kf-test", echo)
    made.start("hello")
    yield made
    made.stop()


def open_descriptors() -> set[str]:
    return {one.name for one in Path("/proc/self/fd").iterdir()}


def heard(child: ChildProcess) -> object:
    until_s = time.monotonic() + 60.0
    while (message := child.receive()) is None:
        assert time.monotonic() < until_s
        time.sleep(0.005)
    return message


def test_it_lives_says_and_ends(child: ChildProcess) -> None:
    assert heard(child) == "hello"
    child.send({"a": 1})
    assert heard(child) == {"a": 1}
    assert child.receive() is None, "nothing more, and nobody waits for it"
    process, pid = child._process, child.pid
    assert process is not None
    assert pid is not None
    assert (process.name, process.daemon) == ("kf-test", True), "nothing waits for it when the program ends"
    child.send("end")
    with pytest.raises(ChildGone, match="code 7"):
        heard(child)
    child.send("nobody listens any more")
    child.stop()
    assert (child.runs, child.pid, child.receive()) == (False, None, None)
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_a_process_that_cannot_be_started_leaves_nothing_behind() -> None:
    child = ChildProcess("kf-test", echo)
    descriptors = open_descriptors()
    with pytest.raises(TypeError, match="pickle") as refused:
        child.start(threading.Lock())
    assert (child.runs, child.pid) == (False, None)
    assert open_descriptors() == descriptors, "however long somebody keeps the error"
    del refused
    child.send("nobody is there")
    assert child.receive() is None


def test_one_that_hangs_is_killed(child: ChildProcess) -> None:
    assert heard(child) == "hello"
    pid = child.pid
    assert pid is not None
    child.send("hang")
    child.stop(0.2)
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def tell_what_it_costs(pipe: Connection, _: object) -> None:
    """Say how many threads the process has after a product of matrices, and how many objects the collector leaves alone."""
    large = np.ones((400, 400))
    assert (large @ large)[0, 0] == 400.0
    pipe.send((len(list(Path("/proc/self/task").iterdir())), gc.get_freeze_count(), gc.isenabled()))


def test_it_turns_in_no_busy_loop_and_collects_no_imports(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(BLAS_THREADS, raising=False)
    child = ChildProcess("kf-test", tell_what_it_costs)
    # The argument's class is NumPy's, which must not be imported before the number of threads is known.
    child.start(np.float32(1.0))
    try:
        said = heard(child)
    finally:
        child.stop()
    assert isinstance(said, tuple)
    assert (said[0], said[1] > 10_000, said[2]) == (1, True, True)


PROGRAM = """
from pathlib import Path
from multiprocessing.shared_memory import SharedMemory
import llvmlite.binding as llvm
import numpy as np
from appliance.instrument.worker.memory import give_back_memory, limit_memory

def compiled():
    module = llvm.parse_assembly("define i32 @f(i32 %a) { %b = mul i32 %a, 7  ret i32 %b }")
    machine = llvm.Target.from_default_triple().create_target_machine(opt=3)
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(3))
    builder.getModulePassManager().run(module, builder)
    return machine.emit_object(module)

def file_mb():
    status = Path("/proc/self/status").read_text()
    return int(next(line.split()[1] for line in status.splitlines() if line.startswith("RssFile"))) / 1000

llvm.initialize_native_target()
llvm.initialize_native_asmprinter()
first = compiled()
before = file_mb()
give_back_memory()
after = file_mb()
print(before - after, compiled() == first)

limit_memory(100.0)
shared = SharedMemory(create=True, size=300_000_000)
shared.buf[:10] = bytes(10)
shared.close()
shared.unlink()
some = np.ones(50_000_000, np.uint8)
try:
    np.ones(200_000_000, np.uint8)
except MemoryError:
    print("refused")
"""
SMAPS = """\
7f00000000-7f00003000 r-xp 00001000 fe:00 12 /opt/lib/{name}
Size:                 12 kB
Rss:                  12 kB
Anonymous:             0 kB
7f00003000-7f00004000 r--p 00004000 fe:00 12 /opt/lib/{name}
Anonymous:             4 kB
7f00004000-7f00005000 rw-p 00005000 fe:00 12 /opt/lib/{name}
Anonymous:             0 kB
7f00005000-7f00006000 r-xp 00001000 fe:00 13 /opt/lib/other.so
Anonymous:             0 kB
7f00006000-7f00007000 r-xp 00000000 00:00 0
Anonymous:             0 kB
7f00007000-7f00009000 r--p 00006000 fe:00 12 /opt/lib/{name}
Anonymous:             0 kB
"""


def test_pages_of_the_compiler_go_and_come_back_and_the_kernel_refuses_what_is_out_of_proportion() -> None:
    ran = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=100.0, check=False)
    assert ran.returncode == 0, ran.stderr
    freed_mb, *others = ran.stdout.split()
    assert float(freed_mb) > 10.0
    assert others == ["True", "refused"]


def test_only_what_is_as_the_file_has_it_is_forgotten() -> None:
    parts = list(unwritten(SMAPS.replace("{name}", COMPILER), COMPILER))
    assert parts == [(0x7F00000000, 0x7F00003000), (0x7F00007000, 0x7F00009000)]


def test_memory_that_is_written_to_is_a_processs_own_and_shared_memory_is_not() -> None:
    before = own_memory_mb(os.getpid())
    # New from the system: of what a long run has freed, a bytearray may get memory that is counted already.
    size = 32_000_000
    with mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS) as own, mmap.mmap(-1, size) as shared:
        for start in range(0, size, 4096):
            own[start] = shared[start] = 1
        after = own_memory_mb(os.getpid())
    assert before is not None
    assert after is not None
    assert 5.0 < before < 5000.0
    assert after - before == pytest.approx(32.0, abs=8.0)


def test_processor_time_is_that_of_all_threads_in_seconds() -> None:
    used = cpu_s(os.getpid())
    assert used == pytest.approx(time.process_time(), abs=0.1)
    until = time.process_time() + 0.2
    while time.process_time() < until:
        pass
    assert (cpu_s(os.getpid()) or 0.0) - (used or 0.0) == pytest.approx(0.2, abs=0.06)


def test_a_process_that_is_not_there_any_more_takes_nothing_that_could_be_told() -> None:
    ended = subprocess.Popen(["true"])
    ended.wait(10.0)
    assert own_memory_mb(ended.pid) is cpu_s(ended.pid) is None
