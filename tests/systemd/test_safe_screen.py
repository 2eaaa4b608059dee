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
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

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


def shown_on(card: Card, output: Output) -> NDArray[np.uint8] | None:
    """(h, w, 3) of what a monitor gets, ``None`` for nothing of ours."""
    connector = next(each for each in card.connectors.values() if each.output is output)
    crtc = connector.crtc
    return None if crtc is None or crtc.framebuffer is None else crtc.image()[:, :, :3]


def page(width_px: int, height_px: int) -> Picture:
    return draw(safe_pages.PAGES["safe-config.en"], width_px, height_px)


# --------------------------------------------------------------------------------- what is shown


@pytest.fixture(params=[False, True], ids=["scans out memory", "scans out a copy"])
def card(request: pytest.FixtureRequest) -> Card:
    return Card(lambda: None, copies=request.param)


def test_the_page_is_on_the_divers_display_and_the_projector_is_dark(card: Card) -> None:
    panel = Panel(CardFile(card))
    assert panel.show(page, DISPLAY, PROJECTOR) == (DISPLAY,)
    display, projector = shown_on(card, Output.DISPLAY), shown_on(card, Output.PROJECTOR)
    assert display is not None
    assert projector is not None
    golden = cv2.imread(str(safe_pages.FOLDER / "safe-config.en.png"))
    assert golden is not None
    np.testing.assert_array_equal(display, golden)
    assert projector.max() == 0
    panel.close()
    assert shown_on(card, Output.DISPLAY) is None  # the service may have the card again


def test_where_nobody_knows_which_display_is_the_divers_all_show_it() -> None:
    card = Card(lambda: None)
    assert sorted(Panel(CardFile(card)).show(page, None, None)) == [DISPLAY, PROJECTOR]


def test_a_display_in_another_socket_is_found_and_the_projector_still_stays_dark() -> None:
    card = Card(lambda: None)
    assert Panel(CardFile(card)).show(page, "DP-2", PROJECTOR) == (DISPLAY,)
    projector = shown_on(card, Output.PROJECTOR)
    assert projector is not None
    assert projector.max() == 0


def test_another_page_replaces_the_first_on_the_same_buffer(card: Card) -> None:
    panel = Panel(CardFile(card))
    panel.show(page, DISPLAY, PROJECTOR)
    panel.show(lambda w, h: draw(safe_pages.PAGES["safe-hang.de"], w, h), DISPLAY, PROJECTOR)
    display = shown_on(card, Output.DISPLAY)
    assert display is not None
    np.testing.assert_array_equal(display, cv2.imread(str(safe_pages.FOLDER / "safe-hang.de.png")))
    assert len(card.framebuffers) == 2  # one a head, however long it lasts


@pytest.mark.parametrize("name", sorted(safe_pages.PAGES))
def test_the_pages_are_those_of_the_pictures(name: str) -> None:
    drawn = safe_pages.as_array(draw(safe_pages.PAGES[name], *safe_pages.SIZE_PX))
    np.testing.assert_array_equal(drawn, cv2.imread(str(safe_pages.FOLDER / f"{name}.png")))


@pytest.mark.parametrize("language", ["en", "de"])
@pytest.mark.parametrize("size_px", [(800, 480), (1024, 600), (640, 480)])
@pytest.mark.parametrize("key", sorted(cause.KEYS))
def test_every_word_fits(key: str, language: str, size_px: tuple[int, int]) -> None:
    words = cause.notice(Cause(key, "x" * 600), language, 600)
    whole = safe_pages.as_array(draw(words, *size_px))
    wider = safe_pages.as_array(draw(words, size_px[0], size_px[1] + 400))
    # With more room below, nothing of headline, action and scans changes: they were whole.
    dot = size_px[0] // 200
    text_height = int(np.flatnonzero((wider == (0xC0, 0xC0, 0xC0)).all(axis=2).any(axis=1))[0])
    assert text_height < size_px[1] - 20 * dot
    np.testing.assert_array_equal(whole[:text_height], wider[:text_height])
    edge = whole[size_px[1] // 5 :, -2 * dot :].any(axis=(1, 2))  # below the red band
    assert edge.sum() <= dot  # the rule above the keys reaches it, no letter does


def test_a_console_takes_the_page_where_there_is_no_card(tmp_path: Path) -> None:
    facts = tmp_path / "fb0"
    facts.mkdir()
    for name, value in (("virtual_size", "800,480"), ("bits_per_pixel", "32"), ("stride", "3328")):
        (facts / name).write_text(f"{value}\n")
    memory = tmp_path / "memory"
    memory.write_bytes(bytes(3328 * 480))
    screens = Screens([str(tmp_path / "no-card")], DISPLAY, PROJECTOR, open_console=lambda: Console(memory, facts))
    assert screens.show(page) == ("console",)
    seen = np.frombuffer(memory.read_bytes(), np.uint8).reshape(480, 832, 4)[:, :800, :3]
    np.testing.assert_array_equal(seen, cv2.imread(str(safe_pages.FOLDER / "safe-config.en.png")))
    (facts / "bits_per_pixel").write_text("16\n")
    with pytest.raises(OSError, match="16 bits"):
        Console(memory, facts)


# --------------------------------------------------------------------------------------- why


EXITED = "kingfisher.service: Main process exited, code=exited, status=1/FAILURE"


@pytest.mark.parametrize(
    ("journal", "key", "detail"),
    [
        (["kingfisher: uncalibrated", "ValueError: no such crystal", EXITED], "program", "ValueError: no such crystal"),
        (
            [
                "ValueError: no such crystal", EXITED, "kingfisher.service: Failed with result 'exit-code'.",
                "kingfisher.service: Scheduled restart job, restart counter is at 5.",
                "Stopped kingfisher.service - Kingfisher, the software of an underwater 3D scanner.",
                "kingfisher.service: Start request repeated too quickly.",
                "Failed to start kingfisher.service - Kingfisher, the software of an underwater 3D scanner.",
                "kingfisher.service: Triggering OnFailure= dependencies.",
            ],
            "program", "ValueError: no such crystal",
        ),
        (["x", "kingfisher.service: Main process exited, code=killed, status=9/KILL"], "killed", "by signal 9/KILL; x"),
        (["kingfisher.service: Main process exited, code=dumped, status=11/SEGV"], "killed", "11/SEGV"),
        (
            [
                "kingfisher.service: Watchdog timeout (limit 20s)!", "Fatal Python error: Aborted",
                'Current thread 0x1 (most recent call first):',
                '  File "/opt/kingfisher/current/lib/python3.11/site-packages/appliance/storage/status.py", line 7 in update',
                "kingfisher.service: Main process exited, code=dumped, status=6/ABRT",
            ],
            "hang", 'in "appliance/storage/status.py", line 7 in update',
        ),
        (["kingfisher.service: Main process exited, code=exited, status=203/EXEC"], "missing", "203/EXEC"),
        (["kingfisher.service: A process of this unit has been killed by the OOM killer."], "memory", "OOM"),
        ([], "unknown", "the journal says nothing"),
    ],
)  # fmt: skip
def test_what_systemd_saw_is_said_in_the_divers_words(
    tmp_path: Path, journal: list[str], key: str, detail: str
) -> None:
    why = cause.cause(tmp_path / "none", "kingfisher.service", journal)
    assert why.key == key
    assert detail in why.detail


def test_the_services_own_words_come_first_and_a_lost_disk_before_all(tmp_path: Path) -> None:
    left = tmp_path / "last-words.json"
    left.write_text(json.dumps({"kind": "config", "text": "camera.left.exposure_ms 25 > 16.6"}))
    assert cause.cause(left, "kingfisher.service", [EXITED]) == Cause("config", "camera.left.exposure_ms 25 > 16.6")
    assert cause.cause(left, "var-lib-kingfisher.mount", [EXITED]).key == "disk"
    left.write_bytes(os.urandom(2000))
    assert cause.cause(left, "kingfisher.service", [EXITED]).key == "program"


def test_a_rig_file_that_is_wrong_in_one_place_still_names_the_displays(tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    shipped = (SYSTEMD.parent / "appliance" / "rigs" / "kingfisher.toml").read_text()
    rig.write_text(shipped.replace("exposure_ms = 12.0", "exposure_ms = 99.0").replace('"en"', '"de"'))
    assert cause.outputs(rig) == cause.Outputs(("/dev/dri/card0",), DISPLAY, PROJECTOR, "/dev/kingfisher-board", "de")
    rig.write_text("[display\n")
    assert cause.outputs(rig).display is None


# -------------------------------------------------------------------------- lasers, key, time


@pytest.mark.parametrize("deaf", [0, 1])
def test_the_board_is_told_to_stop_and_to_switch_the_lasers_off(deaf: int) -> None:
    ours, theirs = pty.openpty()
    heard: list[Sentence] = []

    def board() -> None:
        rest, ignored = b"", deaf
        while len(heard) < 2:
            rest += os.read(ours, 4096)
            while b"\r\n" in rest:
                line, _, rest = rest.partition(b"\r\n")
                sentence = parse_line(line + b"\r\n")
                if ignored:
                    ignored -= 1
                    continue
                heard.append(sentence)
                os.write(ours, b"$R,7,HB,1,2,0,0*F00D\r\n")  # its heart beats on
                os.write(
                    ours, format_line(Sentence(Kind.ACKNOWLEDGE, sentence.sequence, sentence.verb, sentence.fields))
                )

    answering = threading.Thread(target=board, daemon=True)
    answering.start()
    assert devices.lights_off(Path(os.ttyname(theirs)))
    answering.join(10)
    assert [(each.verb, *each.fields) for each in heard] == [("STOP",), ("LASER", "0", "0")]
    os.close(ours)
    os.close(theirs)


def test_a_board_that_does_not_answer_is_no_reason_to_show_nothing(tmp_path: Path) -> None:
    assert not devices.lights_off(tmp_path / "none")
    ours, theirs = pty.openpty()
    started_s = time.monotonic()
    assert not devices.lights_off(Path(os.ttyname(theirs)))
    assert time.monotonic() - started_s < 5.0
    os.close(ours)
    os.close(theirs)


def report(keys: int, counter: int = 0, faulty: int = 0) -> bytes:
    body = bytes([1, keys, counter, faulty, 0, 0, 3])
    check = 0xA5
    for byte in body:
        check ^= byte
    return body + bytes([check])


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


KEYS = {"scan": (1,), "back": (2,), "up": (4,), "down": (8,), "hold": (2,) * 8}


def stays(tmp_path: Path, *pressed: str) -> str:
    """How the page ends when these keys are pressed one after the other."""
    pad = Pad(tmp_path)
    card = Card(lambda: None)
    screens = Screens(["card"], DISPLAY, PROJECTOR, open_card=lambda _: CardFile(card))
    keys = devices.Keys(lambda: pad.path)
    pad.send(report(0), *(report(mask) for key in pressed for mask in (*KEYS[key], 0)))
    try:
        return stay(safe_pages.CONFIG, screens, "en", Tries(tmp_path), keys)
    finally:
        keys.close()


def test_scan_is_a_new_press_of_that_key_and_nothing_else(tmp_path: Path) -> None:
    pad = Pad(tmp_path)
    keys = devices.Keys(lambda: pad.path)
    pad.send(report(1), report(1))  # held since before: perhaps stuck
    assert keys.pressed(0.4) is None
    pad.send(report(1, faulty=1), report(1)[:-1] + b"\0", report(1)[:5])
    assert keys.pressed(0.6) is None
    pad.send(report(0), report(1))
    assert keys.pressed(5.0) == "scan"
    for mask, name in ((2, "back"), (4, "up"), (8, "down")):
        pad.send(report(0), report(mask))
        assert keys.pressed(5.0) == name
    keys.close()


def test_back_is_told_as_held_after_a_while_and_only_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(devices, "OFF_S", 0.4)
    monkeypatch.setattr(devices, "SILENCE_S", 0.2)
    pad = Pad(tmp_path)
    keys = devices.Keys(lambda: pad.path)

    def said(seconds: float) -> list[str]:
        end_s, names = time.monotonic() + seconds, []
        while (left_s := end_s - time.monotonic()) > 0.0:
            names += [name for name in [keys.pressed(left_s)] if name is not None]
        return names

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
    keys.close()


@pytest.mark.parametrize(
    ("pressed", "ends"),
    [
        (("hold", "scan", "scan"), "start"),  # stays on; the next press starts the service as on the page itself
        (("hold", "down", "scan"), "off"),
        (("hold", "down", "up", "scan", "scan"), "start"),
        (("hold", "back", "scan"), "start"),
        (("hold", "down", "back", "hold", "scan", "scan"), "start"),  # asked anew, it is STAY ON that is selected
        (("back", "down", "up", "scan"), "start"),
    ],
)
def test_switching_off_is_asked_back_and_staying_on_is_selected(
    tmp_path: Path, pressed: tuple[str, ...], ends: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(devices, "OFF_S", 0.25)
    assert stays(tmp_path, *pressed) == ends


def test_a_question_without_an_answer_goes_away(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(devices, "OFF_S", 0.25)
    monkeypatch.setattr("kingfisher_safe.main.ASK_OFF_S", 0.0)
    assert stays(tmp_path, "hold", "down", "scan") == "start"


def test_the_key_ends_the_page_at_once(tmp_path: Path) -> None:
    pad = Pad(tmp_path)
    card = Card(lambda: None)
    screens = Screens(["card"], DISPLAY, PROJECTOR, open_card=lambda _: CardFile(card))
    keys = devices.Keys(lambda: pad.path)
    pad.send(report(0), report(1))
    assert stay(safe_pages.CONFIG, screens, "en", Tries(tmp_path), keys) == "start"
    assert Tries(tmp_path).wait_s() == WAITS_S[0]  # the key costs nothing of the budget
    assert shown_on(card, Output.DISPLAY) is not None


def test_without_a_key_it_is_tried_a_few_times_and_then_no_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    card = Card(lambda: None)
    screens = Screens(["card"], DISPLAY, PROJECTOR, open_card=lambda _: CardFile(card))
    monkeypatch.setattr("kingfisher_safe.main.WAITS_S", (0, 0))
    monkeypatch.setattr("kingfisher_safe.main.LOOK_S", 0.01)
    tries = Tries(tmp_path)
    for _ in range(2):
        assert stay(safe_pages.HANG, screens, "en", tries, devices.Keys(lambda: None)) == "time"
    assert Tries(tmp_path).wait_s() is None
    assert "BY ITSELF" not in cause.notice(safe_pages.HANG, "en", Tries(tmp_path).wait_s()).keys


def test_the_pad_is_found_by_its_identity_where_no_rule_names_it(tmp_path: Path) -> None:
    other, ours = tmp_path / "sys" / "hidraw0" / "device", tmp_path / "sys" / "hidraw1" / "device"
    for folder, identity in ((other, "0003:0000046D:0000C31C"), (ours, "0003:00001209:00004B46")):
        folder.mkdir(parents=True)
        (folder / "uevent").write_text(f"DRIVER=hid-generic\nHID_ID={identity}\n")
    dev, sys_class = tmp_path / "dev", tmp_path / "sys"
    assert devices.find_keys((0x1209, 0x4B46), dev, sys_class) == dev / "hidraw1"
    assert devices.find_keys((0x046D, 0xC31C), dev, sys_class) == dev / "hidraw0"
    assert devices.find_keys((0x1209, 0x4B47), dev, sys_class) is None
    assert devices.find_keys((0x1209, 0x4B46), dev, tmp_path / "nothing") is None


@pytest.mark.parametrize(
    ("written", "identity"),
    [
        ("product_id = 0x0007", (0x1209, 7)),
        ("", (0x1209, 0x4B46)),
        ('product_id = "7"', (0x1209, 0x4B46)),
    ],
)
def test_the_pads_identity_is_the_rig_files_and_a_wrong_one_costs_no_display(
    tmp_path: Path, written: str, identity: tuple[int, int]
) -> None:
    rig = tmp_path / "rig.toml"
    shipped = (SYSTEMD.parent / "appliance" / "rigs" / "kingfisher.toml").read_text()
    rig.write_text(shipped.replace("product_id = 0x4B46", written))
    found = cause.outputs(rig)
    assert found.keys == identity
    assert found.display == DISPLAY


# ------------------------------------------------------------------------------ what it needs


def test_it_needs_the_standard_library_alone() -> None:
    ours = {"kingfisher_safe", "kingfisher_setup", "kingfisher_transfer", "drivers"}
    files = [
        *SYSTEMD.glob("kingfisher_*/*.py"),
        SYSTEMD / "safe-screen",
        SYSTEMD.parent / "drivers" / "output" / "drm.py",
    ]
    assert len(files) > 12
    for file in files:
        for node in ast.walk(ast.parse(file.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in names:
                top = name.partition(".")[0]
                assert top in sys.stdlib_module_names or top in ours, f"{file.name}: {name}"
                assert top != "drivers" or name.startswith("drivers.output") or file.name == "panel.py", name


def test_it_starts_with_the_systems_python_and_no_package(tmp_path: Path) -> None:
    python = next((path for path in (Path("/usr/bin/python3"),) if path.exists()), None)
    if python is None:
        pytest.skip("no /usr/bin/python3: apt-get install python3")
    # The real program: no rig file, no card, no key pad here. It says so, and goes on waiting for a display.
    process = subprocess.Popen(
        [python, "-I", "-S", SYSTEMD / "safe-screen"], stderr=subprocess.PIPE, text=True,
        env={"RUNTIME_DIRECTORY": str(tmp_path), "PATH": "/usr/bin:/bin"},
    )  # fmt: skip
    try:
        assert process.stderr is not None
        said = [process.stderr.readline() for _ in range(2)]
        assert "lasers" in said[0]
        assert "shown on" in said[1]
        assert process.poll() is None
    finally:
        process.kill()
        process.wait(10)
