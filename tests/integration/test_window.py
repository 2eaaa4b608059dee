"""A person before the simulated instrument: real key events in, real windows out, on a virtual screen."""

from __future__ import annotations

import os
import shutil
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

from appliance.store.library import Library
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
Picture = NDArray[np.uint8]


@pytest.fixture(scope="module")
def screen(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Xvfb]:
    with xvfb(tmp_path_factory.mktemp("screen")) as made:
        yield made


def until(predicate: Callable[[], Any], what: str, timeout_s: float = 60.0) -> Any:
    """The first true value of ``predicate()``."""
    end_s = time.monotonic() + timeout_s
    while not (value := predicate()):
        assert time.monotonic() < end_s, f"{what}: not within {timeout_s:g} s"
        time.sleep(0.05)
    return value


def window(screen: Xvfb, title: str) -> XWindow:
    (found,) = until(lambda: [w for t, w in screen.windows.items() if t.startswith(title)], title)
    only: XWindow = found
    return only


def picture(screen: Xvfb, title: str) -> Picture:
    return screen.picture(window(screen, title))


def tap(screen: Xvfb, key: str, hold_s: float = 0.4) -> None:
    screen.key(key, True)
    time.sleep(hold_s)
    screen.key(key, False)


def striped(shown: Picture) -> bool:
    """Whether dark and bright are both there: a pattern, and neither the white nor the black one."""
    green = shown[:, :, 1]
    return bool((green > 180).mean() > 0.2 and (green < 60).mean() > 0.2)


def hues(image: Picture) -> NDArray[np.float64]:
    """Shares of the colours among what is coloured at all: the cloud, by distance."""
    hue, saturation, _ = np.moveaxis(cv2.cvtColor(image, cv2.COLOR_RGB2HSV), -1, 0)
    assert (saturation > 120).mean() > 0.1, "no cloud"
    found = np.bincount(hue[saturation > 120] // 12, minlength=15)
    return np.asarray(found / found.sum())


# --------------------------------------------------------------------------------------- a whole dive


@contextmanager
def windowed(root: Path, display: str | None, *options: str) -> Iterator[Service]:
    """``kingfisher sim --window`` in a process of its own."""
    env = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    env |= {} if display is None else {"DISPLAY": display}
    service = Service(
        root, "--rig", str(SMALL), "--window", *options, env=env, stderr=subprocess.PIPE, text=True
    )  # fmt: skip
    try:
        yield service
    finally:
        if service.process.poll() is None:
            service.process.kill()
            service.process.wait(30)


def reaches(service: Service, state: str) -> None:
    until(lambda: service.status().get("state") == state or service.process.poll() is not None, state)
    assert service.process.poll() is None, f"ended instead of {state}"


def test_a_scan_by_keyboard_is_seen_in_the_windows_and_a_key_ends_the_service(screen: Xvfb, tmp_path: Path) -> None:
    root = tmp_path / "dive"
    with windowed(root, screen.name, "truth=nominal", "seed=5") as it:
        reaches(it, "AIM")
        screen.point(window(screen, DISPLAY))
        until(lambda: np.median(picture(screen, PROJECTOR)[:, :, 1]) > 240, "the projector lights the scene")
        until(lambda: picture(screen, CAMERAS).max() > 100, "the cameras see it")
        assert picture(screen, DISPLAY)[60:300].mean() > 10, "the live views"
        assert (picture(screen, PROJECTOR)[:, :, ~GREEN] == 0).all(), "its light is green"

        tap(screen, "s")
        until(lambda: striped(picture(screen, PROJECTOR)), "fringes on the projector")
        reaches(it, "REVIEW")
        time.sleep(1.0)  # so long, most times, for the numbers of the full cloud
        review = picture(screen, DISPLAY)
        assert picture(screen, PROJECTOR).max() < 20, "no light after the scan"

        tap(screen, "Return")
        until(lambda: it.status().get("state") == "AIM", "kept")
        tap(screen, "q", 0.05)
        said = str(it.process.communicate(timeout=60)[1])
    assert it.process.returncode == 0, said
    assert ("AIM → SHUTDOWN (StopRequested)" in said, "Traceback" in said) == (True, False)
    assert "S, Enter: scan/OK" in said, "which keys there are"
    until(lambda: not screen.windows, "no window stays")
    library = Library(root)
    (entry,) = library.entries()
    assert library.verify(entry.scan_id).ok
    kept = cv2.imread(str(entry.folder / "preview.png"))
    assert kept is not None
    # The preview is the cloud alone, as it was to be seen in the window.
    off = hues(np.asarray(kept[:, :, ::-1], np.uint8)) - hues(review[60:300, :520])
    assert np.abs(off).sum() < 0.5, "the same colours"


def test_without_a_display_server_one_line_says_what_to_do(tmp_path: Path) -> None:
    with windowed(tmp_path / "none", None) as it:
        said = str(it.process.communicate(timeout=60)[1])
    (error,) = [line for line in said.splitlines() if "uncalibrated" not in line]
    assert (it.process.returncode, error.startswith("kingfisher: window: cannot be opened")) == (1, True)
    assert all(word in error for word in ("DISPLAY", "xvfb-run"))


# ------------------------------------------------------------------------------- windows of a bare world


def ramp() -> Picture:
    """Every pixel unlike its neighbours."""
    rows, columns = np.mgrid[:480, :800]
    return np.asarray((rows * 7 + columns * 13) % 256, np.uint8)


def test_the_windows_show_what_is_scanned_out_and_the_cross_of_any_or_the_key_asks_to_quit(
    screen: Xvfb, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before a world whose projector and display are lit by a host of the test's own."""
    monkeypatch.setenv("DISPLAY", screen.name)
    asked, options = threading.Event(), WorldOptions(world="desk", width_px=160, height_px=120, object="plane")
    with World(options) as world, open_wires({"world": "desk"}) as wires:
        card = wires.open_card("/dev/dri/card0")
        for kind, image in ((11, stripes(64)), (10, ramp())):
            head = CardHost(card, kind)
            head.set_mode(head.buffer(image))
        with open_windows(world, asked.set):
            display = world.scanned_out("display")
            assert np.array_equal(display, np.repeat(ramp()[:, :, None], 3, 2)), "what the host wanted"
            until(lambda: np.array_equal(picture(screen, DISPLAY), display), "every pixel of the display")
            halved = world.scanned_out("projector").astype(float).reshape(384, 2, 512, 2).mean((1, 3))
            until(lambda: picture(screen, PROJECTOR).any(), "the projector")
            shown = picture(screen, PROJECTOR)
            assert np.abs(shown[:, :, 1] - halved).max() <= 1.0
            assert (shown[:, :, ~GREEN] == 0).all()

            screen.close_window(window(screen, PROJECTOR))
            assert asked.wait(60), "nobody is asked"
            asked.clear()
            screen.point(window(screen, DISPLAY))
            tap(screen, "q", 0.05)
            assert asked.wait(60), "nor by the key"
