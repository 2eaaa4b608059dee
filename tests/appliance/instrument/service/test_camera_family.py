"""A camera of another family is one file, and its name in the rig file: this file is one, with the test that runs it."""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.cli.simrig import default_sim_rig
from appliance.instrument.capture.scan import ScanRecorder, ScanSettings
from appliance.instrument.capture.store import FrameStore
from appliance.instrument.service.air_live import open_devices
from appliance.instrument.service.checkup import check
from appliance.instrument.service.devices import Devices
from appliance.measure.light.patterns import build_sequence
from appliance.store.config import ConfigError, Rig, parse_rig
from drivers import api, camera_families
from drivers.camera import UsbVisionCamera
from drivers.rig import open_camera as open_by_kind
from drivers.rig import open_wires
from tests.support.rendered import pictures


class Grey:
    """A camera that sees the same grey everywhere, at the times of another one."""

    def __init__(self, camera: UsbVisionCamera) -> None:
        self._camera = camera

    def __getattr__(self, name: str) -> Any:
        return getattr(self._camera, name)

    @property
    def identity(self) -> api.CameraIdentity:
        return replace(self._camera.identity, model="grey")

    def health(self) -> api.Health:
        return replace(self._camera.health(), summary="grey")

    def next_frame(self, slot: NDArray[np.uint8], timeout_s: float) -> api.Frame:
        frame = self._camera.next_frame(slot, timeout_s)
        slot[:] = GREY_DN
        return frame


@contextmanager
def open_camera(spec: api.CameraSpec, wires: api.Wires) -> Iterator[api.Camera]:
    with UsbVisionCamera.open(spec, wires.usb_backend, wires.clock) as camera:
        yield cast("api.Camera", Grey(camera))


KIND, GREY_DN = Path(__file__).stem, 77
SMALL = default_sim_rig().with_name("small.toml")


@pytest.fixture
def family(monkeypatch: pytest.MonkeyPatch) -> None:
    """This file lies in the package of families, as a new one would."""
    monkeypatch.setattr(camera_families, "__path__", [*camera_families.__path__, str(Path(__file__).parent)])


def rig_of(kind: str | None, root: Path) -> Rig:
    text = re.sub(r"(?m)^root = .*", f'root = "{root}"', SMALL.read_text(encoding="utf-8"))
    assert text.count('kind = "usb3vision"') == 1
    text = re.sub(r'(?m)^kind = "usb3vision".*', "" if kind is None else f'kind = "{kind}"', text)
    rig = parse_rig(text)
    options = {"object": "plane", "noise": False, "stills": True, "idle_speed": 2.0}
    return replace(rig, rig=replace(rig.rig, wires_options={**rig.rig.wires_options, **options}))


@pytest.mark.usefixtures("family")
def test_a_scan_is_captured_with_a_family_that_is_one_file_and_a_name_in_the_rig_file(tmp_path: Path) -> None:
    rig, sequence = rig_of(KIND, tmp_path), build_sequence(64)
    exposure_us = int(1000.0 * rig.camera.left.exposure_ms)
    settings = ScanSettings(rig.projector.refresh_hz, exposure_us, rig.board.trigger_delay_us)

    def load(projector: api.Projector) -> None:
        projector.load([*pictures(sequence), np.zeros((768, 1024), np.uint8)])
        projector.show(len(sequence))

    with ExitStack() as stack:
        wires = stack.enter_context(open_wires(rig.rig.wires, rig.rig.wires_options))
        devices = stack.enter_context(Devices(rig, wires, load))
        grabbers, board, projector = open_devices(devices, wires.clock)
        store = stack.enter_context(FrameStore(len(sequence), 300, 400))
        recorder = ScanRecorder(grabbers, board, projector, wires.clock, settings)
        report = recorder.record(sequence, store, lambda side, index: None, lambda: None)
        assert report.fault is None
        assert all(np.all(store.frames(side) == GREY_DN) for side in ("left", "right"))


@pytest.mark.usefixtures("family")
def test_checking_the_devices_asks_the_family(tmp_path: Path) -> None:
    said = {health.device: health.summary for health in check(rig_of(KIND, tmp_path))}
    assert said["camera.left"] == said["camera.right"] == "grey"


@pytest.mark.parametrize("kind", ["gige", "usb3vision ", "..api", "os"])
def test_a_family_that_is_not_there_is_refused_by_name_and_nothing_is_imported(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(ConfigError, match="allowed: aravis, usb3vision") as caught:
        rig_of(kind, tmp_path)
    assert caught.value.key == "camera.kind"
    asked: list[str] = []
    with monkeypatch.context() as patched:
        patched.setattr(importlib, "import_module", asked.append)
        with pytest.raises(api.DeviceRefused, match="allowed: aravis, usb3vision"):
            open_by_kind(api.CameraSpec("camera.left", "KF-CAM-L"), None, kind)  # type: ignore[arg-type]  # is not reached
    assert asked == []
