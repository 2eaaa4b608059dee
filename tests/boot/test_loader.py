"""The image as a PC starts it: firmware, boot loader, its two entries. Nothing is added to the disk, the kernel or its arguments."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import pytest

from tests.boot.machine import PROJECTOR, Boot, Machine, Uefi
from tests.boot.picture import image_of

ROOT = Path(__file__).resolve().parents[2]
FIRMWARE = Path("/usr/share/OVMF")
START_S, ANSWER_S, SERVICE_S = 300.0, 60.0, 420.0
SHELL = "KF-SHELL"

pytestmark = [pytest.mark.boot, pytest.mark.long, pytest.mark.timeout(1800)]


@pytest.fixture
def pc(tmp_path: Path) -> Iterator[Machine]:
    variables = tmp_path / "variables.fd"
    shutil.copyfile(FIRMWARE / "OVMF_VARS_4M.fd", variables)
    image = image_of(ROOT)
    starts = Uefi(FIRMWARE / "OVMF_CODE_4M.fd", variables)
    artefacts = ROOT / "build" / "boot"
    artefacts.mkdir(parents=True, exist_ok=True)
    with Machine(Boot(image.overlay(tmp_path), starts, model=image.cpu), tmp_path, lambda _head: None) as made:
        yield made
        cv2.imwrite(str(artefacts / "loader-at-the-end.png"), made.screen(PROJECTOR)[:, :, ::-1])
    shutil.copyfile(made.console, artefacts / "loader-console.log")


def until(
    what: str, seen: Callable[[], object], timeout_s: float, meanwhile: Callable[[], None] = lambda: None
) -> None:
    end_s = time.monotonic() + timeout_s
    while not seen():
        assert time.monotonic() < end_s, f"no {what} within {timeout_s:g} s"
        meanwhile()
        time.sleep(0.2)


def say(pc: Machine, command: str) -> None:
    """To a shell that may not be there yet."""
    pc.type("\n")
    time.sleep(3.0)
    pc.type(f"{command}\n")


def serial(pc: Machine) -> str:
    return pc.console.read_text(encoding="utf-8", errors="replace")


def test_firmware_and_boot_loader_start_the_system_and_the_space_bar_opens_it(pc: Machine) -> None:
    # Nobody touches it: the first entry, up to a system that writes to its data partition and obeys Ctrl-Alt-Del.
    until("write to the disk", lambda: pc.written_bytes() > 0, START_S)
    time.sleep(20.0)  # the journal's way to the data partition
    pc.press("ctrl", "alt", "delete")

    # The space bar: the loader's menu, the entry above the one that is marked, a shell of root.
    # Pressed from before the restart on: the loader looks for a key once, at its start.
    until("menu", lambda: "maintenance" in serial(pc), START_S, lambda: pc.press("spc"))
    assert pc.restarts > 0
    pc.press("up")
    pc.press("ret")
    until("shell", lambda: SHELL in serial(pc), START_S, lambda: say(pc, f"echo {SHELL[:3]}'{SHELL[3:]}' >/dev/ttyS0"))
    pc.type("journalctl -b -1 -o cat -g 'command line|kingfisher' >/dev/ttyS0; echo KF'-BEFORE' >/dev/ttyS0\n")
    until("journal", lambda: "KF-BEFORE" in serial(pc), ANSWER_S)
    before = serial(pc).partition(SHELL)[2]
    assert "root=LABEL=kf-root ro" in before, before
    assert "rescue.target" not in before
    assert "Starting kingfisher.service" in before

    pc.type("grep -o 'rescue.target' /proc/cmdline >/dev/ttyS0; findmnt -no OPTIONS / >/dev/ttyS0\n")
    until("answer", lambda: "rescue.target" in serial(pc).partition("KF-BEFORE")[2], ANSWER_S)
    watch = "until systemctl is-active -q kingfisher; do sleep 1; done; echo KF-ACTIVE >/dev/ttyS0"
    pc.type(f'systemd-run -q -p DefaultDependencies=no -p IgnoreOnIsolate=yes sh -c "{watch}"\n')
    pc.type("systemctl default\n")
    until("service", lambda: "KF-ACTIVE" in serial(pc), SERVICE_S)
