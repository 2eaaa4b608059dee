"""A person before the simulated instrument: real key events in, real windows out, on a virtual screen."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
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
from hw_sim.window import open_windows
from hw_sim.wires import open as open_wires
from hw_sim.world import World, WorldOptions
from tests.hw_sim.devices.host import CardHost, stripes
from tests.integration.dived import SMALL, Service
from tests.support.x11 import Xvfb, XWindow, xvfb

pytestmark = pytest.mark.skipif(
    shutil.which("Xvfb") is None, reason="Xvfb is not installed: apt-get install --no-install-recommends xvfb"
)
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


def tap(screen: Xvfb, key: str, hold_s: float = 0.4) -> None:
    screen.key(key, True)
    time.sleep(hold_s)
    screen.key(key, False)


def near(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
    """Mean difference in DN."""
    return float(np.abs(a.astype(int) - b).mean())


# --------------------------------------------------------------------------------------- a whole dive


@contextmanager
def windowed(root: Path, display: str | None, *options: str) -> Iterator[Service]:
    """``kingfisher sim --window`` in a process of its own."""
    env = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    env |= {} if display is None else {"DISPLAY": display}
    words = ("--rig", str(SMALL), "--window", *options)
    service = Service(root, *words, env=env, stderr=subprocess.PIPE, text=True)
    try:
        yield service
    finally:
        if service.process.poll() is None:
            service.process.kill()
            service.process.wait(30)


def reaches(service: Service, state: str) -> None:
    until(lambda: service.status().get("state") == state or service.process.poll() is not None, state)
    assert service.process.poll() is None, f"ended instead of {state}"


def ended(service: Service) -> tuple[int, str]:
    """Return exit code and what was said on stderr."""
    said = str(service.process.communicate(timeout=60)[1])
    return int(service.process.returncode), said


def test_a_dive_by_keyboard(screen: Xvfb, tmp_path: Path) -> None:
    root = tmp_path / "dive"
    with windowed(root, screen.name, "--truth", "nominal", "--seed", "5") as it:
        reaches(it, "AIM")
        screen.point(window(screen, DISPLAY))
        until(lambda: np.median(picture(screen, PROJECTOR)[:, :, 1]) > 240, "the projector lights the scene")
        until(lambda: picture(screen, CAMERAS).max() > 100, "the cameras see it")
        aim = picture(screen, DISPLAY)
        assert aim[60:300].mean() > 10, "the live views"
        assert (picture(screen, PROJECTOR)[:, :, ~GREEN] == 0).all(), "its light is green"

        tap(screen, "s")
        fringes = until(lambda: shown_stripes(picture(screen, PROJECTOR)), "fringes on the projector")
        assert len(fringes) == 2, "dark and bright"
        reaches(it, "REVIEW")
        until(lambda: near(picture(screen, DISPLAY), aim) > 20, "another screen")
        time.sleep(1.0)  # so long, most times, for the numbers of the full cloud
        review = picture(screen, DISPLAY)
        left = cv2.cvtColor(review[60:300, :520], cv2.COLOR_RGB2HSV)
        assert (left[:, :, 1] > 120).mean() > 0.1, "the cloud, coloured by distance"
        assert picture(screen, PROJECTOR).max() < 20, "no light after the scan"

        tap(screen, "Return")
        until(lambda: it.status().get("state") == "AIM", "kept")
        tap(screen, "BackSpace")  # UNCALIBRATED: seen
        until(lambda: it.status().get("keys", {}).get("back") == "HOLD: OFF", "seen")
        tap(screen, "BackSpace", hold_s=1.2)
        until(lambda: (it.status().get("question") or {}).get("selected") == "STAY ON", "held long enough to be asked")
        tap(screen, "Down")
        until(lambda: (it.status().get("question") or {}).get("selected") == "SWITCH OFF", "the other answer")
        tap(screen, "Return")
        code, said = ended(it)
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


def shown_stripes(shown: NDArray[np.uint8]) -> set[bool]:
    """Whether dark and bright are both there: a pattern, and neither the white nor the black one."""
    green = shown[:, :, 1]
    return {True, False} if (green > 180).mean() > 0.2 and (green < 60).mean() > 0.2 else set()


def test_ctrl_c_in_the_terminal_ends_the_service_cleanly(screen: Xvfb, tmp_path: Path) -> None:
    with windowed(tmp_path / "quit", screen.name, "--size", "160x120") as it:
        reaches(it, "AIM")
        window(screen, DISPLAY)
        it.process.send_signal(signal.SIGINT)
        code, said = ended(it)
    assert code == 0, said
    assert "AIM → SHUTDOWN (StopRequested)" in said
    assert "S, Enter: scan/OK" in said, "which keys there are"
    assert "Traceback" not in said
    until(lambda: not screen.windows, "no window stays")


def test_without_a_display_server_one_line_says_what_to_do(tmp_path: Path) -> None:
    with windowed(tmp_path / "none", None) as it:
        code, said = ended(it)
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


def test_the_cross_of_any_window_asks_to_quit_as_the_key_does(screen: Xvfb, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = threading.Event()
    with desk(screen, monkeypatch, asked.set):
        screen.close_window(window(screen, PROJECTOR))
        assert asked.wait(60), "nobody is asked"
        asked.clear()
        screen.point(window(screen, DISPLAY))
        tap(screen, "q", 0.05)
        assert asked.wait(60), "nor by the key"
