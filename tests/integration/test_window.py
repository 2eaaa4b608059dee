"""A person before the simulated instrument: real key events in, real windows out, on a virtual screen."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.storage.library import Library
from hw_sim.window import WindowError, open_windows
from hw_sim.wires import open as open_wires
from hw_sim.world import World, WorldOptions
from tests.hw_sim.devices.host import CardHost, stripes
from tests.support.x11 import Xvfb, XWindow, xvfb

pytestmark = pytest.mark.skipif(
    shutil.which("Xvfb") is None, reason="Xvfb is not installed: apt-get install --no-install-recommends xvfb"
)
ROOT = Path(__file__).parents[2]
SMALL_RIG = ROOT / "hw_sim" / "rigs" / "small.toml"
DISPLAY, PROJECTOR, CAMERAS = "Kingfisher: diver's display", "Kingfisher: projector", "Kingfisher: left and right"
GREEN = np.array([False, True, False])


@pytest.fixture
def screen(tmp_path: Path) -> Iterator[Xvfb]:
    folder = tmp_path / "screen"
    folder.mkdir()
    with xvfb(folder) as made:
        yield made


def until(predicate: Callable[[], Any], what: str, timeout_s: float = 60.0) -> Any:
    """The first true value of ``predicate()``."""
    end_s = time.monotonic() + timeout_s
    while not (value := predicate()):
        assert time.monotonic() < end_s, f"{what}: not within {timeout_s:g} s"
        time.sleep(0.02)
    return value


def window(screen: Xvfb, title: str) -> XWindow:
    found = until(lambda: [w for t, w in screen.windows.items() if t.startswith(title)], title)
    assert len(found) == 1
    only: XWindow = found[0]
    return only


def picture(screen: Xvfb, title: str) -> NDArray[np.uint8]:
    return screen.picture(window(screen, title))


def tap(screen: Xvfb, key: str, hold_s: float = 0.15) -> None:
    screen.key(key, True)
    time.sleep(hold_s)
    screen.key(key, False)


def near(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
    """Mean difference in DN."""
    return float(np.abs(a.astype(int) - b).mean())


# --------------------------------------------------------------------------------------- a whole dive


class Instrument:
    """``kingfisher sim --window`` in a process of its own."""

    def __init__(self, root: Path, display: str | None, *options: str) -> None:
        self._status = root / "run" / "status.json"
        command = [sys.executable, "-m", "appliance.cli", "sim", "--rig", str(SMALL_RIG), "--root", str(root)]
        env = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
        if display is not None:
            env["DISPLAY"] = display
        self.process = subprocess.Popen(
            [*command, "--window", *options], cwd=ROOT, env=env, stderr=subprocess.PIPE, text=True
        )

    def status(self) -> dict[str, Any]:
        """The status file; empty while there is none."""
        try:
            return dict(json.loads(self._status.read_text(encoding="utf-8")))
        except (OSError, ValueError):
            return {}

    @property
    def state(self) -> str | None:
        try:
            return str(json.loads(self._status.read_text(encoding="utf-8"))["state"])
        except (OSError, ValueError, KeyError):
            return None

    def reaches(self, state: str) -> None:
        until(lambda: self.state == state or self.process.poll() is not None, state)
        assert self.process.poll() is None, f"ended instead of {state}"

    def ends(self) -> tuple[int, str]:
        """Exit code and what was said on stderr."""
        _, said = self.process.communicate(timeout=60)
        return self.process.returncode, said


@contextmanager
def instrument(root: Path, display: str | None, *options: str) -> Iterator[Instrument]:
    made = Instrument(root, display, *options)
    try:
        yield made
    finally:
        if made.process.poll() is None:
            made.process.kill()
            made.process.wait(30)


def test_a_dive_by_keyboard(screen: Xvfb, tmp_path: Path) -> None:
    root = tmp_path / "dive"
    with instrument(root, screen.name, "--truth", "nominal", "--seed", "5") as it:
        it.reaches("AIM")
        screen.point(window(screen, DISPLAY))
        until(lambda: np.median(picture(screen, PROJECTOR)[:, :, 1]) > 240, "the projector lights the scene")
        until(lambda: picture(screen, CAMERAS).max() > 100, "the cameras see it")
        aim = picture(screen, DISPLAY)
        assert aim[60:300].mean() > 10, "the live views"
        assert (picture(screen, PROJECTOR)[:, :, ~GREEN] == 0).all(), "its light is green"

        tap(screen, "s")
        fringes = until(lambda: shown_stripes(picture(screen, PROJECTOR)), "fringes on the projector")
        assert len(fringes) == 2, "dark and bright"
        it.reaches("REVIEW")
        until(lambda: near(picture(screen, DISPLAY), aim) > 20, "another screen")
        time.sleep(1.0)  # so long, most times, for the numbers of the full cloud
        review = picture(screen, DISPLAY)
        left = cv2.cvtColor(review[60:300, :520], cv2.COLOR_RGB2HSV)
        assert (left[:, :, 1] > 120).mean() > 0.1, "the cloud, coloured by distance"
        assert picture(screen, PROJECTOR).max() < 20, "no light after the scan"

        tap(screen, "Return")
        until(lambda: it.state == "AIM", "kept")
        tap(screen, "BackSpace")  # UNCALIBRATED: seen
        until(lambda: it.status().get("keys", {}).get("back") == "HOLD: OFF", "seen")
        tap(screen, "BackSpace", hold_s=1.2)
        until(lambda: (it.status().get("question") or {}).get("selected") == "STAY ON", "held long enough to be asked")
        tap(screen, "Down")
        until(lambda: (it.status().get("question") or {}).get("selected") == "SWITCH OFF", "the other answer")
        tap(screen, "Return")
        code, said = it.ends()
        assert code == 0, said
        assert "AIM → SHUTDOWN (KeyPressed)" in said, "only the answer switches off"
    until(lambda: not screen.windows, "no window stays")
    library = Library(root)
    (entry,) = library.entries()
    assert library.verify(entry.scan_id).ok
    kept = cv2.imread(str(entry.folder / "preview.png"))
    assert kept is not None
    # The preview is the cloud alone, as it was to be seen in the window, coloured by distance.
    colours = cv2.cvtColor(kept, cv2.COLOR_BGR2HSV)
    cloud = colours[:, :, 1] > 120
    assert cloud.mean() > 0.1
    seen = cv2.cvtColor(review[60:300, :520], cv2.COLOR_RGB2HSV)
    hues = [np.bincount(one[one[:, :, 1] > 120][:, 0] // 12, minlength=15) for one in (colours, seen)]
    shares = [hue / hue.sum() for hue in hues]
    assert np.abs(shares[0] - shares[1]).sum() < 0.5, "the same colours"


def test_the_mouse_holds_and_moves_the_instrument(screen: Xvfb, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DISPLAY", screen.name)
    options = WorldOptions(world="mouse", width_px=400, height_px=300, object="plane", object_pose=(0, 0, 500, 0, 0, 0))
    with World(options) as world, open_windows(world, lambda: None):
        cameras = window(screen, CAMERAS)
        screen.point(cameras)
        screen.button(1, True)
        for right in range(0, 41, 4):
            screen.point(cameras, right=right)
        until(lambda: world.scene.start_pose[0] == pytest.approx(-20.0, abs=0.6), "40 px to the right")
        screen.button(1, False)
        screen.point(cameras, right=-40)
        screen.button(4, True)
        screen.button(4, False)
        until(lambda: world.scene.start_pose[2] == pytest.approx(495.0), "one notch nearer")
        until(lambda: world.scene.motion.still, "the hands rest")
        assert world.scene.start_pose[0] == pytest.approx(-20.0, abs=0.6), "let go, the mouse moves nothing"


def shown_stripes(shown: NDArray[np.uint8]) -> set[bool]:
    """Whether dark and bright are both there: a pattern, and neither the white nor the black one."""
    green = shown[:, :, 1]
    return {True, False} if (green > 180).mean() > 0.2 and (green < 60).mean() > 0.2 else set()


@pytest.mark.dive
@pytest.mark.parametrize("how", ["q", "Ctrl-C in the terminal"])
def test_each_way_to_quit_ends_the_service_cleanly(how: str, screen: Xvfb, tmp_path: Path) -> None:
    root = tmp_path / "quit"
    with instrument(root, screen.name, "--size", "160x120") as it:
        it.reaches("AIM")
        screen.point(window(screen, DISPLAY))
        if how.startswith("Ctrl-C"):
            it.process.send_signal(signal.SIGINT)
        else:
            tap(screen, how, 0.05)
        code, said = it.ends()
    assert code == 0, said
    assert "AIM → SHUTDOWN (StopRequested)" in said
    assert "S, Enter: scan/OK" in said, "which keys there are"
    assert "Traceback" not in said
    until(lambda: not screen.windows, "no window stays")


def test_without_opengl_the_packages_are_named(screen: Xvfb, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("__EGL_VENDOR_LIBRARY_FILENAMES", "/nonexistent.json")
    wanted = pytest.raises(WindowError, match=r"window: none can be opened \(.*EGL.*install libegl1")
    with wanted, desk(screen, monkeypatch, lambda: None):
        pass


def test_without_a_display_server_one_line_says_what_to_do(tmp_path: Path) -> None:
    with instrument(tmp_path / "none", None) as it:
        code, said = it.ends()
    assert code == 1
    errors = [line for line in said.splitlines() if "uncalibrated" not in line]
    assert len(errors) == 1, said
    assert errors[0].startswith("kingfisher: window: none can be opened")
    assert "DISPLAY" in errors[0]
    assert "xvfb-run" in errors[0]


# ------------------------------------------------------------------------------- windows of a bare world


@contextmanager
def desk(
    screen: Xvfb, monkeypatch: pytest.MonkeyPatch, quit_wanted: Callable[[], None], **options: Any
) -> Iterator[World]:
    """A world with windows, its projector and its display lit by a host of the test's own."""
    monkeypatch.setenv("DISPLAY", screen.name)
    wanted = WorldOptions(world="desk", width_px=160, height_px=120, object="plane", **options)
    with World(wanted) as world, open_wires({"world": "desk"}) as wires:
        card = wires.open_card("/dev/dri/card0")
        for kind, image in ((11, stripes(64)), (10, ramp())):
            head = CardHost(card, kind)
            head.set_mode(head.buffer(image))
        with open_windows(world, quit_wanted):
            yield world


def ramp() -> NDArray[np.uint8]:
    """Every pixel unlike its neighbours."""
    rows, columns = np.mgrid[:480, :800]
    return np.asarray((rows * 7 + columns * 13) % 256, np.uint8)


def test_the_windows_show_what_is_scanned_out(screen: Xvfb, monkeypatch: pytest.MonkeyPatch) -> None:
    with desk(screen, monkeypatch, lambda: None) as world:
        display = world.scanned_out("display")
        assert np.array_equal(display, np.repeat(ramp()[:, :, None], 3, 2)), "what the host wanted"
        until(lambda: np.array_equal(picture(screen, DISPLAY), display), "every pixel of the display")
        light = world.scanned_out("projector").astype(float)
        halved = light.reshape(384, 2, 512, 2).mean((1, 3))
        until(lambda: picture(screen, PROJECTOR).any(), "the projector")
        shown = picture(screen, PROJECTOR)
        assert shown.shape == (384, 512, 3)
        assert np.abs(shown[:, :, 1] - halved).max() <= 1.0
        assert (shown[:, :, ~GREEN] == 0).all()


@pytest.mark.parametrize("idle_speed", [1.0, 0.4])
def test_a_key_is_held_as_long_as_on_the_keyboard(
    screen: Xvfb, monkeypatch: pytest.MonkeyPatch, idle_speed: float
) -> None:
    """Also in a world that is slower than the person, where a long press must not become a short one."""
    reports: list[tuple[int, int]] = []
    with desk(screen, monkeypatch, lambda: None, idle_speed=idle_speed) as world:
        with world.time.condition:
            world.keypad.listen(lambda report: reports.append((world.time_ns, report[1])))
        screen.point(window(screen, DISPLAY))
        tap(screen, "Up", hold_s=1.0)
        until(lambda: reports and reports[-1][1] == 0 and any(keys for _, keys in reports), "pressed and let go")
        world.time.sleep_s(0.1)
    held = [time_ns for time_ns, keys in reports if keys == 0x04]
    assert {keys for _, keys in reports} == {0, 0x04}
    after = [time_ns for time_ns, keys in reports if keys == 0 and time_ns > held[-1]]
    # Bounces of up to 20 ms, a tick of the windows' loop, and what the machine's other work adds.
    assert (after[0] - held[0]) / 1e9 == pytest.approx(1.0, abs=0.15)


def test_a_key_that_is_held_repeats_nothing(screen: Xvfb, monkeypatch: pytest.MonkeyPatch) -> None:
    """A keyboard repeats after some 0.5 s; the pad does not."""
    reports: list[int] = []
    with desk(screen, monkeypatch, lambda: None) as world:
        with world.time.condition:
            world.keypad.listen(lambda report: reports.append(report[1]))
        screen.point(window(screen, DISPLAY))
        screen.key("s", True)
        until(lambda: 0x01 in reports, "pressed")
        world.time.sleep_s(0.05)
        settled = len(reports)
        world.time.sleep_s(1.5)
        assert set(reports[settled:]) == {0x01}
        screen.key("s", False)


def test_the_cross_of_any_window_asks_to_quit_as_the_key_does(screen: Xvfb, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = threading.Event()
    with desk(screen, monkeypatch, asked.set):
        screen.close_window(window(screen, PROJECTOR))
        assert asked.wait(60), "nobody is asked"
        asked.clear()
        screen.point(window(screen, DISPLAY))
        tap(screen, "q", 0.05)
        assert asked.wait(60), "nor by the key"


def test_windows_that_die_end_the_service_with_a_reason(screen: Xvfb, monkeypatch: pytest.MonkeyPatch) -> None:
    ended = threading.Event()

    def kill_windows() -> None:
        with desk(screen, monkeypatch, ended.set):
            window(screen, DISPLAY)
            (child,) = children_named("hw_sim.window")
            os.kill(child, signal.SIGKILL)
            assert ended.wait(20), "nobody is told"

    with pytest.raises(WindowError, match="has ended with -9"):
        kill_windows()


def children_named(word: str) -> list[int]:
    """Processes started by this one with that word in their command line."""
    found = []
    for task in Path("/proc/self/task").iterdir():
        for child in (task / "children").read_text().split():
            if word.encode() in Path("/proc", child, "cmdline").read_bytes():
                found.append(int(child))
    return found
