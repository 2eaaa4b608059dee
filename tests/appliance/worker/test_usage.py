"""What a process takes of the machine: this one's own, as the system tells it another way, and one's that is not there any more."""

from __future__ import annotations

import mmap
import os
import subprocess
import time

import pytest

from appliance.worker.usage import cpu_s, own_memory_mb


def test_memory_that_is_written_to_is_a_processs_own_and_shared_memory_is_not() -> None:
    before = own_memory_mb(os.getpid())
    # New from the system: of what a long run has freed, a bytearray may get memory that is counted already.
    own = mmap.mmap(-1, 32_000_000, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    shared = mmap.mmap(-1, 32_000_000)
    for start in range(0, 32_000_000, 4096):
        own[start] = shared[start] = 1
    after = own_memory_mb(os.getpid())
    assert before is not None
    assert after is not None
    assert 5.0 < before < 5000.0
    assert after - before == pytest.approx(32.0, abs=8.0)
    own.close()
    shared.close()


def test_processor_time_is_that_of_all_threads_in_seconds() -> None:
    used = cpu_s(os.getpid())
    assert used is not None
    assert used == pytest.approx(time.process_time(), abs=0.1)
    until = time.process_time() + 0.2
    while time.process_time() < until:
        pass
    later = cpu_s(os.getpid())
    assert later is not None
    assert later - used == pytest.approx(0.2, abs=0.06)


def test_a_process_that_is_not_there_any_more_takes_nothing_that_could_be_told() -> None:
    ended = subprocess.Popen(["true"])
    ended.wait(10.0)
    assert own_memory_mb(ended.pid) is None
    assert cpu_s(ended.pid) is None
