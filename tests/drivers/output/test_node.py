"""The system calls on a node behave as the scan-out code relies on; files and pipes stand in for a card."""

from __future__ import annotations

import errno
import mmap
import os
import time
from pathlib import Path

import pytest

from drivers.api import DeviceGone
from drivers.output import drm
from drivers.output.node import DrmNode


def test_a_missing_card_is_gone_and_names_its_path(tmp_path: Path) -> None:
    with pytest.raises(DeviceGone, match=r"card7: cannot be opened \(No such file or directory\)"):
        DrmNode(str(tmp_path / "card7"))


def test_reading_never_blocks_and_waiting_ends(tmp_path: Path) -> None:
    pipe = tmp_path / "events"
    os.mkfifo(pipe)
    node = DrmNode(str(pipe))  # for reading and writing: the writer is this descriptor itself
    with pytest.raises(BlockingIOError):
        node.read(4096)
    begun_s = time.monotonic()
    assert not node.wait_readable(0.05)
    assert 0.04 <= time.monotonic() - begun_s < 2.0
    writer = os.open(pipe, os.O_WRONLY | os.O_NONBLOCK)
    os.write(writer, b"event")
    assert node.wait_readable(5.0)
    assert node.read(4096) == b"event"
    os.close(writer)
    node.close()


def test_a_mapping_is_shared_and_writable(tmp_path: Path) -> None:
    memory = tmp_path / "memory"
    memory.write_bytes(bytes(2 * mmap.ALLOCATIONGRANULARITY))
    node = DrmNode(str(memory))
    view = node.map(100, mmap.ALLOCATIONGRANULARITY)
    view[3] = 0x7F
    assert memory.read_bytes()[mmap.ALLOCATIONGRANULARITY + 3] == 0x7F
    node.close()
    view[4] = 1  # a mapping outlives its descriptor


def test_a_refused_request_is_the_kernels_error(tmp_path: Path) -> None:
    plain = tmp_path / "plain"
    plain.touch()
    node = DrmNode(str(plain))
    with pytest.raises(OSError) as refused:
        node.ioctl(drm.IOCTL_GET_CAP, bytearray(16))
    assert refused.value.errno == errno.ENOTTY
    node.close()
