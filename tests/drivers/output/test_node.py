"""The system calls on a node behave as the scan-out code relies on; files and pipes stand in for a card."""

from __future__ import annotations

import errno
import fcntl
import mmap
import os
import select
import termios
from pathlib import Path

import pytest

from drivers.api import DeviceGone, DeviceRefused
from drivers.output import drm
from drivers.output.node import DrmNode


def test_a_card_that_is_missing_or_may_not_be_opened_is_named_with_the_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(DeviceGone, match=r"card7: .*No such file or directory"):
        DrmNode(str(tmp_path / "card7"))

    def refuse(path: str, flags: int) -> int:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr("drivers.output.node.os.open", refuse)
    with pytest.raises(DeviceRefused, match=r"card0: .*Permission denied.*group video"):
        DrmNode("/dev/dri/card0")


def test_reading_never_blocks_and_waiting_ends(tmp_path: Path) -> None:
    pipe = tmp_path / "events"
    os.mkfifo(pipe)
    node = DrmNode(str(pipe))  # for reading and writing: the writer is this descriptor itself
    with pytest.raises(BlockingIOError):
        node.read(4096)
    assert not node.wait_readable(0.05)
    writer = os.open(pipe, os.O_WRONLY | os.O_NONBLOCK)
    os.write(writer, b"event")
    assert node.wait_readable(5.0)
    request = bytearray(4)
    node.ioctl(termios.FIONREAD, request)
    assert int.from_bytes(request, "little") == 5, "an answer is written into the request"
    assert node.read(4096) == b"event"
    os.close(writer)
    node.close()


def test_a_mapping_is_shared_and_writable_and_a_node_that_is_given_back_is_open_no_more(tmp_path: Path) -> None:
    memory = tmp_path / "memory"
    memory.write_bytes(bytes(2 * mmap.ALLOCATIONGRANULARITY))
    node = DrmNode(str(memory))
    with pytest.raises(OSError, match="Inappropriate ioctl") as refused:
        node.ioctl(drm.IOCTL_GET_CAP, bytearray(16))
    assert refused.value.errno == errno.ENOTTY, "the kernel's error"
    view, descriptor = node.map(100, mmap.ALLOCATIONGRANULARITY), node._fd
    view[3] = 0x7F
    assert memory.read_bytes()[mmap.ALLOCATIONGRANULARITY + 3] == 0x7F
    assert fcntl.fcntl(descriptor, fcntl.F_GETFD) & fcntl.FD_CLOEXEC, "no child ever has it"
    node.close()
    view[4] = 1  # a mapping outlives its descriptor
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(descriptor)


@pytest.mark.parametrize(("asked_s", "waited_ms"), [(0.25, 250.0), (3.0, 3000.0), (0.0, 0.0), (-0.5, 0.0)])
def test_the_kernel_is_asked_to_wait_in_milliseconds_and_never_for_ever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, asked_s: float, waited_ms: float
) -> None:
    """A negative time means for ever to the kernel; it comes of a deadline that has just passed."""
    (tmp_path / "plain").touch()
    node = DrmNode(str(tmp_path / "plain"))
    asked: list[float] = []

    class Poll:
        def register(self, *which: int) -> None:
            asked.extend(which)

        def poll(self, timeout_ms: float) -> list[tuple[int, int]]:
            asked.append(timeout_ms)
            return []

    monkeypatch.setattr("drivers.output.node.select.poll", Poll)
    assert node.wait_readable(asked_s) is False
    assert asked == [node._fd, select.POLLIN, waited_ms]
    node.close()
