"""Owns a virtual machine: QEMU by software emulation, its monitor, its console, the agent inside, and its two screens.

Either the kernel is given to it, or its firmware finds a boot loader on the disk as a PC's does.
"""

from __future__ import annotations

import json
import re
import socket
import subprocess
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from tests.boot.keyboard import keys_of

GPU = "gpu0"
PROJECTOR, DISPLAY = 0, 1
CONNECT_TIMEOUT_S = 30.0
TYPING_S = 0.15
_SCANOUT = re.compile(rb"virtio_gpu_cmd_set_scanout id (\d+), res (0x[0-9a-f]+)")
_FLUSH = re.compile(rb"virtio_gpu_cmd_res_flush res (0x[0-9a-f]+)")


@dataclass(frozen=True, slots=True)
class Given:
    """A kernel from outside the disk, as no PC has it: for what a test adds."""

    kernel: Path
    initrd: Path
    command_line: str

    @property
    def arguments(self) -> list[str]:
        return ["-kernel", str(self.kernel), "-initrd", str(self.initrd), "-append", self.command_line]


@dataclass(frozen=True, slots=True)
class Uefi:
    code: Path
    variables: Path

    @property
    def arguments(self) -> list[str]:
        flash = "if=pflash,format=raw,file="
        return ["-drive", f"{flash}{self.code},readonly=on", "-drive", f"{flash}{self.variables}"]


@dataclass(frozen=True, slots=True)
class Boot:
    disk: Path
    starts: Given | Uefi
    model: str


class Gone(Exception):
    """The machine, or the agent in it, does not answer."""


def _connect(path: Path, deadline: float) -> socket.socket:
    while True:
        made = socket.socket(socket.AF_UNIX)
        try:
            made.connect(str(path))
        except OSError as error:
            made.close()
            if time.monotonic() > deadline:
                raise Gone(f"{path.name}: {error}") from error
            time.sleep(0.05)
        else:
            return made


class Monitor:
    """QEMU's machine protocol, one command at a time."""

    def __init__(self, path: Path) -> None:
        self._socket = _connect(path, time.monotonic() + CONNECT_TIMEOUT_S)
        self._socket.settimeout(30.0)
        self._lines = self._socket.makefile("rb")
        self._lock = threading.Lock()
        self.events: list[str] = []
        self._lines.readline()
        self.do("qmp_capabilities")

    def do(self, command: str, **arguments: Any) -> Any:
        with self._lock:
            try:
                self._socket.sendall(json.dumps({"execute": command, "arguments": arguments}).encode() + b"\n")
                while True:
                    line = self._lines.readline()
                    if not line:
                        raise Gone(f"the machine ended during {command}")
                    answer = json.loads(line)
                    if "error" in answer:
                        raise Gone(f"{command}: {answer['error']['desc']}")
                    if "return" in answer:
                        return answer["return"]
                    self.events.append(str(answer.get("event")))
            except OSError as error:
                raise Gone(f"{command}: {error}") from error

    def close(self) -> None:
        self._socket.close()


class Machine:
    """A running machine. A context manager; at its end the machine is switched off.

    ``flipped(head)`` is called, in a thread of its own, at each picture that the guest's kernel flushes to a head.
    """

    def __init__(self, boot: Boot, folder: Path, flipped: Callable[[int], None]) -> None:
        self._boot, self._folder, self._flipped = boot, folder, flipped
        self._process: subprocess.Popen[bytes] | None = None
        self._number = 0
        self._greeted = False
        self._asking = threading.Lock()
        """One question at a time, whoever asks."""
        self._resources: dict[int, bytes] = {}
        self.console = folder / "console.log"

    def __enter__(self) -> Self:
        b, f = self._boot, self._folder
        command = [
            *("qemu-system-x86_64", "-nodefaults", "-no-user-config", "-display", "none", "-machine", "q35"),
            *("-accel", "tcg,thread=multi,tb-size=1024", "-cpu", b.model, "-smp", "2"),
            *("-m", "2048", *b.starts.arguments),
            *("-drive", f"file={b.disk},id=disk,if=virtio,format=qcow2,discard=unmap"),
            *("-device", f"virtio-gpu-pci,id={GPU},max_outputs=2"),
            *("-netdev", "user,id=net", "-device", "virtio-net-pci,netdev=net,romfile="),
            *("-chardev", f"file,id=console,path={self.console}", "-serial", "chardev:console"),
            *("-device", "virtio-serial-pci", "-chardev", f"socket,id=agent,path={f / 'agent'},server=on,wait=off"),
            *("-device", "virtserialport,chardev=agent,name=kingfisher.agent", "-device", "virtio-rng-pci"),
            *("-qmp", f"unix:{f / 'monitor'},server=on,wait=off", "-qmp", f"unix:{f / 'camera'},server=on,wait=off"),
            *("-trace", "virtio_gpu_cmd_set_scanout", "-trace", "virtio_gpu_cmd_res_flush"),
        ]
        self._process = subprocess.Popen(command, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL)
        self._watcher = threading.Thread(target=self._watch, name="scan-out", daemon=True)
        self._watcher.start()
        self.monitor = Monitor(f / "monitor")
        self._camera = Monitor(f / "camera")
        self._agent = _connect(f / "agent", time.monotonic() + CONNECT_TIMEOUT_S)
        self._answers = self._agent.makefile("rb")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process is not None:
            self._process.terminate()
            try:
                self._process.wait(20.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait(20.0)
        for end in (self.monitor, self._camera, self._agent):
            end.close()

    def _watch(self) -> None:
        assert self._process is not None
        assert self._process.stderr is not None
        other = (self._folder / "qemu.log").open("wb")
        with other:
            for line in self._process.stderr:
                if found := _SCANOUT.search(line):
                    self._resources[int(found[1])] = found[2]
                elif found := _FLUSH.search(line):
                    for head, resource in self._resources.items():
                        if resource == found[1]:
                            self._flipped(head)
                else:
                    other.write(line)
                    other.flush()

    def screen(self, head: int) -> NDArray[np.uint8]:
        """(h, w, 3) uint8 RGB of what a head shows now. Raises Gone."""
        path = Path(f"/dev/shm/kingfisher-{self._folder.name}-{head}.ppm")
        self._camera.do("screendump", filename=str(path), device=GPU, head=head)
        picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
        path.unlink()
        if picture is None:
            raise Gone(f"head {head} gave no picture")
        return np.ascontiguousarray(picture[:, :, ::-1], np.uint8)

    def press(self, *keys: str) -> None:
        self.monitor.do("send-key", keys=[{"type": "qcode", "data": key} for key in keys])

    def type(self, text: str) -> None:
        """A text on its keyboard, slowly enough for a console. Raises Gone."""
        for chord in keys_of(text):
            self.press(*chord)
            time.sleep(TYPING_S)

    def written_bytes(self) -> int:
        (disk,) = (one for one in self.monitor.do("query-blockstats") if one["device"] == "disk")
        return int(disk["stats"]["wr_bytes"])

    @property
    def restarts(self) -> int:
        """How often the machine was reset since it was switched on. Raises Gone."""
        self.monitor.do("query-status")  # what it tells unasked is heard with an answer
        return self.monitor.events.count("RESET")

    def wait_for_agent(self, timeout_s: float) -> None:
        """Until the agent has said hello, as it does once after each start of the machine. Raises Gone."""
        end_s = time.monotonic() + timeout_s
        while not self._greeted:
            with self._asking:
                if not self._greeted:  # whoever asked meanwhile may have heard it
                    self._line(max(0.1, end_s - time.monotonic()))

    def reset(self) -> None:
        """The reset button: nothing is told to the system inside, nothing is written any more. Raises Gone."""
        self._greeted = False
        self.monitor.do("system_reset")

    def run(self, command: str, timeout_s: float = 60.0) -> str:
        """What a shell command inside prints. Raises Gone if it fails, or the machine does not answer."""
        code, text = self.try_run(command, timeout_s)
        if code:
            raise Gone(f"{command!r} ended with {code}: {text}")
        return text

    def try_run(self, command: str, timeout_s: float = 60.0) -> tuple[int, str]:
        """Exit code and output of a shell command inside; 124 after the time limit. Raises Gone."""
        with self._asking:
            self._number += 1
            order = {"id": self._number, "run": command, "timeout_s": timeout_s}
            self._agent.sendall(json.dumps(order).encode() + b"\n")
            while True:
                answer = self._line(timeout_s + 60.0)
                if answer.get("id") == self._number:
                    return int(answer["rc"]), str(answer["out"])
                if "hello" in answer:
                    raise Gone(f"the machine started again before it answered {command!r}")

    def _line(self, timeout_s: float) -> dict[str, Any]:
        self._agent.settimeout(timeout_s)
        try:
            line = self._answers.readline()
        except OSError as error:
            self._answers = self._agent.makefile("rb")
            raise Gone(f"the agent is silent for {timeout_s:g} s") from error
        if not line:
            raise Gone("the machine has ended")
        try:
            found: dict[str, Any] = json.loads(line)
        except ValueError:  # half an answer of before a reset, with what came next
            found = {"hello": 0} if b'"hello"' in line else {}
        if "hello" in found:
            self._greeted = True
        return found
