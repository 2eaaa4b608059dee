"""When the service cannot start, the diver's display says why and what to do, and everything else is dark."""

from __future__ import annotations

import ast
import fcntl
import json
import os
import pty
import struct
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import reduce
from operator import xor
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.store.config import default_rig_path
from drivers.board.line import Kind, Sentence, format_line, parse_line
from hw_sim.devices.card import Card
from hw_sim.devices.card_file import CardFile
from hw_sim.devices.head import Output
from kingfisher_safe import cause, devices
from kingfisher_safe.cause import Cause
from kingfisher_safe.main import WAITS_S, Screens, Tries, stay
from kingfisher_safe.page import Picture, draw
from kingfisher_safe.panel import Console, Panel
from tests.systemd import safe_pages

SYSTEMD = Path(__file__).parents[2] / "systemd"
DISPLAY, PROJECTOR = "DP-1", "HDMI-A-1"


def shown_on(card: Card, output: Output) -> NDArray[np.uint8]:
    """(h, w, 3) of what a monitor gets; empty for nothing of ours."""
    crtc = next(each.crtc for each in card.connectors.values() if each.output is output)
    if crtc is None or crtc.framebuffer is None:
        return np.empty((0, 0, 3), np.uint8)
    return crtc.image()[:, :, :3]


def page(width_px: int, height_px: int) -> Picture:
    return draw(safe_pages.PAGES["safe-config.en"], width_px, height_px)


def golden(name: str) -> NDArray[np.uint8]:
    picture = cv2.imread(str(safe_pages.FOLDER / f"{name}.png"))
    assert picture is not None
    return np.asarray(picture, np.uint8)


@pytest.fixture(params=[False, True], ids=["scans out memory", "scans out a copy"])
def card(request: pytest.FixtureRequest) -> Card:
    return Card(lambda: None, copies=request.param)


def test_the_page_is_on_the_divers_display_and_the_projector_is_dark(card: Card) -> None:
    panel = Panel(CardFile(card))
    assert panel.show(page, DISPLAY, PROJECTOR) == (DISPLAY,)
    np.testing.assert_array_equal(shown_on(card, Output.DISPLAY), golden("safe-config.en"))
    assert shown_on(card, Output.PROJECTOR).max() == 0
    panel.show(lambda w, h: draw(safe_pages.PAGES["safe-hang.de"], w, h), DISPLAY, PROJECTOR)
    np.testing.assert_array_equal(shown_on(card, Output.DISPLAY), golden("safe-hang.de"))
    assert len(card.framebuffers) == 2, "one a head, however long it lasts"
    panel.close()
    assert shown_on(card, Output.DISPLAY).size == 0, "the service may have the card again"


@pytest.mark.parametrize(
    ("display", "projector", "shows"), [(None, None, [DISPLAY, PROJECTOR]), ("DP-2", PROJECTOR, [DISPLAY])]
)
def test_a_display_that_the_rig_file_does_not_name_shows_it_too(
    display: str | None, projector: str | None, shows: list[str]
) -> None:
    card = Card(lambda: None)
    assert sorted(Panel(CardFile(card)).show(page, display, projector)) == shows
    assert bool(shown_on(card, Output.PROJECTOR).any()) == (PROJECTOR in shows)


@pytest.mark.parametrize("name", sorted(safe_pages.PAGES))
def test_the_pages_are_those_of_the_pictures(name: str) -> None:
    drawn = safe_pages.as_array(draw(safe_pages.PAGES[name], *safe_pages.SIZE_PX))
    np.testing.assert_array_equal(drawn, golden(name))


@pytest.mark.parametrize("language", ["en", "de"])
@pytest.mark.parametrize("key", sorted(cause.KEYS))
def test_every_word_fits(key: str, language: str) -> None:
    """On the display with the fewest letters in a line and lines on the page."""
    words = cause.notice(Cause(key, "x" * 600), language, 600)
    whole, longer = (safe_pages.as_array(draw(words, 800, height_px)) for height_px in (480, 880))
    # With more room below, nothing of headline, action and scans changes: they were whole.
    text_height = int(np.flatnonzero((longer == (0xC0, 0xC0, 0xC0)).all(axis=2).any(axis=1))[0])
    assert text_height < 480 - 20 * 4
    np.testing.assert_array_equal(whole[:text_height], longer[:text_height])
    edge = whole[480 // 5 :, -2 * 4 :].any(axis=(1, 2))  # below the red band; a dot is 4 px
    assert edge.sum() <= 4  # the rule above the keys reaches it, no letter does


def test_a_console_takes_the_page_where_there_is_no_card(tmp_path: Path) -> None:
    facts = tmp_path / "fb0"
    facts.mkdir()
    for name, value in (("virtual_size", "800,480"), ("bits_per_pixel", "32"), ("stride", "3328")):
        (facts / name).write_text(f"{value}\n")
    memory = tmp_path / "memory"
    memory.write_bytes(bytes(3328 * 480))
    there = Screens([str(tmp_path / "no-card")], DISPLAY, PROJECTOR, open_console=lambda: Console(memory, facts))
    assert there.show(page) == ("console",)
    seen = np.frombuffer(memory.read_bytes(), np.uint8).reshape(480, 832, 4)[:, :800, :3]
    np.testing.assert_array_equal(seen, golden("safe-config.en"))
    (facts / "bits_per_pixel").write_text("16\n")
    with pytest.raises(OSError, match="16 bits"):
        Console(memory, facts)


EXITED = "kingfisher.service: Main process exited, code=exited, status=1/FAILURE"


LOOP = [
    "kingfisher: uncalibrated", "ValueError: no such crystal", EXITED, "kingfisher.service: Failed with result 'exit-code'.",
    "kingfisher.service: Scheduled restart job, restart counter is at 5.",
    "Stopped kingfisher.service - Kingfisher, the software of an underwater 3D scanner.",
    "kingfisher.service: Start request repeated too quickly.", "kingfisher.service: Triggering OnFailure= dependencies.",
]  # fmt: skip
HUNG = [
    "kingfisher.service: Watchdog timeout (limit 20s)!", "Fatal Python error: Aborted",
    'Current thread 0x1 (most recent call first):',
    '  File "/opt/kingfisher/current/lib/python3.11/site-packages/appliance/instrument/service/status.py", line 7 in update',
    "kingfisher.service: Main process exited, code=dumped, status=6/ABRT",
]  # fmt: skip


@pytest.mark.parametrize(
    ("journal", "key", "detail"),
    [
        (LOOP, "program", "ValueError: no such crystal"), (HUNG, "hang", 'in "appliance/instrument/service/status.py", line 7 in update'),
        (["x", "kingfisher.service: Main process exited, code=killed, status=9/KILL"], "killed", "by signal 9/KILL; x"),
        (["kingfisher.service: Main process exited, code=dumped, status=11/SEGV"], "killed", "11/SEGV"),
        (["kingfisher.service: Main process exited, code=exited, status=203/EXEC"], "missing", "203/EXEC"),
        (["kingfisher.service: A process of this unit has been killed by the OOM killer."], "memory", "OOM"),
        ([], "unknown", "the journal says nothing"),
    ],
)  # fmt: skip
def test_what_systemd_saw_is_said_in_the_divers_words(
    tmp_path: Path, journal: list[str], key: str, detail: str
) -> None:
    why = cause.cause(tmp_path / "none", "kingfisher.service", journal)
    assert (why.key, detail in why.detail) == (key, True), why


def test_the_services_own_words_come_first_and_a_lost_disk_before_all(tmp_path: Path) -> None:
    left = tmp_path / "last-words.json"
    left.write_text(json.dumps({"kind": "config", "text": "camera.left.exposure_ms 25 > 16.6"}))
    assert cause.cause(left, "kingfisher.service", [EXITED]) == Cause("config", "camera.left.exposure_ms 25 > 16.6")
    assert cause.cause(left, "var-lib-kingfisher.mount", [EXITED]).key == "disk"
    left.write_bytes(os.urandom(2000))
    assert cause.cause(left, "kingfisher.service", [EXITED]).key == "program"


@pytest.mark.parametrize(
    ("pad", "identity"), [("0x0007", (0x1209, 7)), ('"7"', (0x1209, 0x4B46)), ("0x4B46", (0x1209, 0x4B46))]
)
def test_a_rig_file_that_is_wrong_in_one_place_still_names_the_rest(
    tmp_path: Path, pad: str, identity: tuple[int, int]
) -> None:
    rig = tmp_path / "rig.toml"
    shipped = default_rig_path().read_text().replace("exposure_ms = 12.0", "exposure_ms = 99.0")
    rig.write_text(shipped.replace('"en"', '"de"').replace("product_id = 0x4B46", f"product_id = {pad}"))
    known = cause.Outputs(("/dev/dri/card0",), DISPLAY, PROJECTOR, "/dev/kingfisher-board", "de")
    assert cause.outputs(rig) == replace(known, keys=identity)
    rig.write_text("[display\n")
    assert cause.outputs(rig).display is None


class DeafBoard(threading.Thread):
    """The board's end of a serial line: its heart beats on, and it hears the first ``deaf`` commands not at all."""

    def __init__(self, end: int, deaf: int) -> None:
        super().__init__(daemon=True)
        self._end, self._deaf, self.heard = end, deaf, list[Sentence]()

    def run(self) -> None:
        rest = b""
        while len(self.heard) < 2:
            *lines, rest = (rest + os.read(self._end, 4096)).split(b"\r\n")
            for sentence in [parse_line(each + b"\r\n") for each in lines]:
                self._deaf -= 1
                if self._deaf < 0:
                    self.heard.append(sentence)
                    answer = Sentence(Kind.ACKNOWLEDGE, sentence.sequence, sentence.verb, sentence.fields)
                    os.write(self._end, b"$R,7,HB,1,2,0,0*F00D\r\n" + format_line(answer))


@pytest.fixture
def line() -> Iterator[tuple[int, Path]]:
    """The board's end of a serial line, and where the other one is."""
    ours, theirs = pty.openpty()
    yield ours, Path(os.ttyname(theirs))
    os.close(ours)
    os.close(theirs)


@pytest.mark.parametrize("deaf", [0, 1])
def test_the_board_is_told_to_stop_and_to_switch_the_lasers_off(line: tuple[int, Path], deaf: int) -> None:
    board = DeafBoard(line[0], deaf)
    board.start()
    assert devices.lights_off(line[1])
    board.join(10)
    assert [(each.verb, *each.fields) for each in board.heard] == [("STOP",), ("LASER", "0", "0")]


def test_a_board_that_is_not_there_or_does_not_answer_is_no_reason_to_wait(
    line: tuple[int, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert devices.ANSWER_S * devices.TRIES * len(devices.COMMANDS) < 5.0
    monkeypatch.setattr(devices, "ANSWER_S", 0.02)
    assert (devices.lights_off(tmp_path / "none"), devices.lights_off(line[1])) == (False, False)


def report(keys: int, faulty: int = 0) -> bytes:
    body = bytes([1, keys, 0, faulty, 0, 0, 3])
    return body + bytes([reduce(xor, body, 0xA5)])


class Pad:
    """A key pad behind a pipe."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "hidraw0"
        os.mkfifo(self.path)
        self._end = os.open(self.path, os.O_RDWR | os.O_NONBLOCK)

    def _unread(self) -> bool:
        return bool(struct.unpack("i", fcntl.ioctl(self._end, termios.FIONREAD, bytes(4)))[0])

    def send(self, *reports: bytes) -> None:
        def sending() -> None:
            for each in reports:
                time.sleep(0.05)
                end_s = time.monotonic() + 10.0
                while self._unread() and time.monotonic() < end_s:  # a real pad hands over one report at a time
                    time.sleep(0.005)
                os.write(self._end, each)

        threading.Thread(target=sending, daemon=True).start()


@pytest.fixture
def pad(tmp_path: Path) -> Pad:
    return Pad(tmp_path)


@pytest.fixture
def keys(pad: Pad) -> Iterator[devices.Keys]:
    made = devices.Keys(lambda: pad.path)
    yield made
    made.close()


def screens() -> Screens:
    card = Card(lambda: None)
    return Screens(["card"], DISPLAY, PROJECTOR, open_card=lambda _: CardFile(card))


KEYS = {"scan": (1,), "back": (2,), "up": (4,), "down": (8,), "hold": (2,) * 8}


def test_scan_is_a_new_press_of_that_key_and_nothing_else(pad: Pad, keys: devices.Keys) -> None:
    pad.send(report(1), report(1))  # held since before: perhaps stuck
    assert keys.pressed(0.4) is None
    pad.send(report(1, faulty=1), report(1)[:-1] + b"\0", report(1)[:5])
    assert keys.pressed(0.6) is None
    pad.send(report(0), report(1))
    assert keys.pressed(5.0) == "scan"
    for mask, name in ((2, "back"), (4, "up"), (8, "down")):
        pad.send(report(0), report(mask))
        assert keys.pressed(5.0) == name


def test_back_is_told_as_held_after_a_while_and_only_once(
    pad: Pad, keys: devices.Keys, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(devices, "OFF_S", 0.4)
    monkeypatch.setattr(devices, "SILENCE_S", 0.2)

    def said(seconds: float) -> list[str]:
        end_s, names = time.monotonic() + seconds, list[str | None]()
        while (left_s := end_s - time.monotonic()) > 0.0:
            names.append(keys.pressed(left_s))
        return [name for name in names if name is not None]

    pad.send(*[report(2)] * 12)  # down since before
    assert said(0.8) == []
    pad.send(report(0), *[report(2)] * 4, report(0), *[report(2)] * 4, report(0))  # brushed, twice
    assert said(0.8) == ["back", "back"]
    pad.send(*[report(10)] * 12)  # with another key: a hand on the pad
    assert "hold" not in said(0.8)
    pad.send(report(0), report(2))  # then silence
    assert said(0.5) == ["back"]
    pad.send(*[report(2)] * 4)
    assert said(0.4) == []
    pad.send(report(0), *[report(2)] * 20)
    assert said(1.2) == ["back", "hold"]


@pytest.mark.parametrize(
    ("pressed", "ask_s", "ends"),
    [
        ("scan", 60.0, "start"),
        ("hold scan scan", 60.0, "start"),  # stays on; the next press starts the service as on the page itself
        ("hold down scan", 60.0, "off"),
        ("hold down up scan scan", 60.0, "start"),
        ("hold down back hold scan scan", 60.0, "start"),  # asked anew, it is STAY ON that is selected
        ("back down up scan", 60.0, "start"),
        ("hold down scan", 0.0, "start"),  # a question without an answer goes away
    ],
)
def test_switching_off_is_asked_back_and_staying_on_is_selected(
    tmp_path: Path, pad: Pad, keys: devices.Keys, pressed: str, ask_s: float, ends: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(devices, "OFF_S", 0.25)
    monkeypatch.setattr("kingfisher_safe.main.ASK_OFF_S", ask_s)
    pad.send(report(0), *(report(mask) for key in pressed.split() for mask in (*KEYS[key], 0)))
    assert stay(safe_pages.CONFIG, screens(), "en", Tries(tmp_path), keys) == ends
    assert Tries(tmp_path).wait_s() == WAITS_S[0], "the key costs nothing of the budget"


def test_while_it_is_asked_back_the_time_does_not_come(
    tmp_path: Path, pad: Pad, keys: devices.Keys, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(devices, "OFF_S", 0.25)
    monkeypatch.setattr("kingfisher_safe.main.WAITS_S", (1,))
    pad.send(report(0), *[report(2)] * 8, *[report(0)] * 25, report(8), report(0), report(1))
    assert stay(safe_pages.CONFIG, screens(), "en", Tries(tmp_path), keys) == "off"


def test_without_a_key_it_is_tried_a_few_times_and_then_no_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("kingfisher_safe.main.WAITS_S", (0, 0))
    monkeypatch.setattr("kingfisher_safe.main.LOOK_S", 0.01)
    tries = Tries(tmp_path)
    for _ in range(2):
        assert stay(safe_pages.HANG, screens(), "en", tries, devices.Keys(lambda: None)) == "time"
    assert Tries(tmp_path).wait_s() is None
    assert "BY ITSELF" not in cause.notice(safe_pages.HANG, "en", Tries(tmp_path).wait_s()).keys


def test_the_pad_is_found_by_its_identity_where_no_rule_names_it(tmp_path: Path) -> None:
    dev, there = tmp_path / "dev", tmp_path / "sys"
    for name, identity in (("hidraw0", "0003:0000046D:0000C31C"), ("hidraw1", "0003:00001209:00004B46")):
        (there / name / "device").mkdir(parents=True)
        (there / name / "device" / "uevent").write_text(f"DRIVER=hid-generic\nHID_ID={identity}\n")
    asked = (0x1209, 0x4B46), (0x046D, 0xC31C), (0x1209, 0x4B47)
    assert [devices.find_keys(one, dev, there) for one in asked] == [dev / "hidraw1", dev / "hidraw0", None]
    assert devices.find_keys((0x1209, 0x4B46), dev, tmp_path / "nothing") is None


def test_it_needs_the_standard_library_alone() -> None:
    drm = SYSTEMD.parent / "drivers" / "output" / "drm.py"
    files = [*SYSTEMD.glob("kingfisher_*/*.py"), SYSTEMD / "safe-screen", drm]
    assert len(files) > 12
    allowed = {*sys.stdlib_module_names, "kingfisher_safe", "kingfisher_setup", "kingfisher_transfer"}
    for file in files:
        for node in ast.walk(ast.parse(file.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in names:
                of_driver = name.startswith("drivers.output") or (
                    file.name == "panel.py" and name.startswith("drivers")
                )
                assert name.partition(".")[0] in allowed or of_driver, f"{file.name}: {name}"


@pytest.mark.skipif(not Path("/usr/bin/python3").exists(), reason="no /usr/bin/python3: apt-get install python3")
def test_it_starts_with_the_systems_python_and_no_package(tmp_path: Path) -> None:
    """The real program: no rig file, no card, no key pad here. It says so, and goes on waiting for a display."""
    process = subprocess.Popen(
        ["/usr/bin/python3", "-I", "-S", SYSTEMD / "safe-screen"], stderr=subprocess.PIPE, text=True,
        env={"RUNTIME_DIRECTORY": str(tmp_path), "PATH": "/usr/bin:/bin"},
    )  # fmt: skip
    try:
        assert process.stderr is not None
        said = [process.stderr.readline() for _ in range(2)]
        assert ("lasers" in said[0], "shown on" in said[1], process.poll()) == (True, True, None)
    finally:
        process.kill()
        process.wait(10)
