"""The library ends of the wires: pyserial finds the port, names lead to worlds, and nothing is left behind."""

from __future__ import annotations

import threading
import time
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
import serial

from hw_sim import wires
from hw_sim.options import OptionError
from hw_sim.wires import open as open_wires
from hw_sim.world import World, WorldOptions
from tests.hw_sim.conftest import SMALL, Bench

RIGS = Path(wires.__file__).parents[1] / "rigs"


def test_the_serial_handler_is_there_only_while_wires_are_open() -> None:
    with pytest.raises(ValueError, match="kfsim"):
        serial.serial_for_url("kfsim://main/board")
    with open_wires({**SMALL, "world": "a"}), open_wires({"world": "a"}):
        serial.serial_for_url("kfsim://a/board").close()
    with pytest.raises(ValueError, match="kfsim"):
        serial.serial_for_url("kfsim://a/board")


def test_an_url_that_leads_nowhere(bench: Bench) -> None:
    for url in ("kfsim://nowhere/board", f"kfsim://{bench.name}/bored"):
        with pytest.raises(serial.SerialException, match="No such file or directory"):
            serial.serial_for_url(url)


def test_a_port_is_opened_once(bench: Bench) -> None:
    url = f"kfsim://{bench.name}/board"
    with pytest.raises(serial.SerialException, match="busy"):
        serial.serial_for_url(url)
    bench.board.port.close()
    bench.board.port.close()
    with pytest.raises(serial.SerialException):
        bench.board.port.read(1)
    serial.serial_for_url(url).close()


def test_reading_waits_in_world_time_and_gives_what_there_is(bench: Bench) -> None:
    port = bench.board.port
    port.reset_input_buffer()
    port.timeout = 0.2
    start_ns = bench.wires.clock.now_ns()
    assert port.read(100_000) is not None
    assert 0.2 <= (bench.wires.clock.now_ns() - start_ns) / 1e9 < 0.3
    port.timeout = 0
    port.reset_input_buffer()
    assert port.read(10) == b""
    port.write(b"$C,7,PING*B7B3\r\n")
    assert port.in_waiting > 10
    assert port.read(5) == b"$A,7,"


def test_a_reader_can_be_called_off(bench: Bench) -> None:
    port = bench.board.port
    port.timeout = None
    threading.Timer(0.1, port.cancel_read).start()
    start_s = time.monotonic()
    port.read(1_000_000)
    assert time.monotonic() - start_s < 2.0


def test_when_the_world_ends_the_port_is_gone(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench()
    bench.close()
    with pytest.raises(serial.SerialException, match="returned no data"):
        bench.board.port.read(1)
    with pytest.raises(serial.SerialException, match="write failed"):
        bench.board.port.write(b"x")


def test_a_second_world_needs_another_name(bench: Bench) -> None:
    with (
        pytest.raises(ValueError, match=f"already a world named '{bench.name}'"),
        World(WorldOptions(world=bench.name, **SMALL)),
    ):
        pass


def test_worlds_live_side_by_side(make_bench: Callable[..., Bench]) -> None:
    one, two = make_bench(), make_bench()
    one.board.ask("LASER", 1, 0)
    assert one.world.board.lasers_on == (True, False)
    assert two.world.board.lasers_on == (False, False)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"sede": 3}, "'sede'; did you mean 'seed'"),
        ({"pace": "warp"}, "pace 'warp'; allowed are lockstep, realtime"),
        ({"width_px": 10}, "camera size 10x1200; allowed are"),
        ({"idle_speed": 0.0}, "idle_speed 0; allowed are"),
        ({"object": "whale"}, "object 'whale'; allowed are"),
        ({"script": "dive.txt"}, "a diver needs the option status"),
    ],
)
def test_wrong_options_are_refused_with_what_is_allowed(options: dict[str, object], said: str) -> None:
    with pytest.raises(OptionError) as caught, open_wires(options):
        pass
    assert said in str(caught.value)


def test_faults_may_be_options(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench(faults=["leak wrong", "keypad off"])
    assert bench.wires.hidraw.enumerate() == []
    assert "LEAK=1" in bench.board.ask("SENSE")


def test_a_world_that_was_refused_is_not_found_by_the_next_who_asks_for_its_name() -> None:
    """It was, and its time stood still: whoever waited for one of its devices waited for ever."""
    with (
        pytest.raises(ValueError, match=r"camera\.left explode"),
        open_wires({**SMALL, "faults": ["camera.left explode"]}),
    ):
        pass
    with open_wires(SMALL) as next_wires:
        start_ns = next_wires.clock.now_ns()
        time.sleep(0.1)
        assert next_wires.clock.now_ns() - start_ns > 50_000_000, "its time passes"


def test_a_world_that_fails_says_so(make_bench: Callable[..., Bench], monkeypatch: pytest.MonkeyPatch) -> None:
    bench = make_bench()

    def broken(*_: object) -> None:
        raise ZeroDivisionError("no light")

    monkeypatch.setattr(bench.world._renderer, "expose", broken)
    bench.camera()
    bench.board.ask("LIVE", 1, 500, 8000)
    deadline_s = time.monotonic() + 5
    while not bench.world.time.closed and time.monotonic() < deadline_s:
        bench.wires.clock.sleep_s(0.01)
    with pytest.raises(ZeroDivisionError, match="no light"):
        bench.close()


@pytest.mark.parametrize("name", ["full", "small"])
def test_the_simulated_rigs_differ_from_the_instrument_only_in_what_is_simulated(name: str) -> None:
    instrument = tomllib.loads((RIGS.parents[1] / "appliance" / "rigs" / "kingfisher.toml").read_text())
    rig = tomllib.loads((RIGS / f"{name}.toml").read_text())
    assert rig["rig"]["wires"] == "hw_sim.wires:open"
    assert rig["board"]["url"] == "kfsim://main/board"
    differing = {
        f"{table}.{key}"
        for table, values in instrument.items()
        for key, value in values.items()
        if rig[table].get(key) != value and not isinstance(value, dict)
    }
    allowed = {"rig.name", "rig.serial", "rig.wires", "board.url", "storage.root"}
    assert differing - allowed <= ({"design.pixel_um"} if name == "small" else set())
    cameras = [rig["camera"][side] for side in ("left", "right")]
    options = rig["rig"].get("wires_options", {})
    for camera in cameras:
        assert camera["width_px"] == options.get("width_px", 1600)
        assert camera["height_px"] == options.get("height_px", 1200)
        assert camera["width_px"] * rig["design"]["pixel_um"] == pytest.approx(1600 * 4.5)
