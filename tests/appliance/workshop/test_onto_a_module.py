"""The commands that flash a board, as they are printed, with the real ``mpremote`` on MicroPython's own prompt."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import threading
import tty
from collections.abc import Iterator
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from appliance.store.config import load_rig
from appliance.workshop.flashing import LIBRARIES, Part, commands, firmware_files
from tests.support import micropython

pytestmark = pytest.mark.devices

SERIAL = Path(micropython.__file__).with_name("micropython_serial.mjs")
FLASH = Path(micropython.__file__).with_name("micropython_flash.py")
RIG = load_rig()


class Module:
    def __init__(self) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self._process = subprocess.Popen(
            ["node", SERIAL, micropython.MODULE, str(400 * 1024), FLASH],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0,
        )  # fmt: skip
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        wires = ((self._master, self._process.stdin.fileno()), (self._process.stdout.fileno(), self._master))
        for source, sink in wires:
            threading.Thread(target=self._relay, args=(source, sink), daemon=True).start()

    def close(self) -> None:
        self._process.kill()
        self._process.wait(10.0)
        for end in (self._slave, self._master):  # the relays wait in them
            os.close(end)

    @staticmethod
    def _relay(source: int, sink: int) -> None:
        with suppress(OSError):
            while data := os.read(source, 4096):
                os.write(sink, data)

    def typed(self, command: str, *more: str) -> str:
        """Type a command of the page here, with this module's port; return what it printed."""
        words = command.removeprefix("./dev run mpremote ").split()
        assert len(words) < len(command.split()), "a command of mpremote"
        call = [sys.executable, "-m", "mpremote", "connect", os.ttyname(self._slave), *words, *more]
        done = subprocess.run(call, capture_output=True, text=True, timeout=60.0)
        assert done.returncode == 0, f"{command}: {done.stdout}{done.stderr}"
        return done.stdout


@pytest.fixture
def module() -> Iterator[Module]:
    micropython.require()
    made = Module()
    yield made
    made.close()


@pytest.mark.parametrize("part", ["board", "keys"])
def test_the_printed_commands_bring_all_files_onto_a_module_and_may_be_repeated(
    part: Part, module: Module, tmp_path: Path
) -> None:
    folder, files = tmp_path / part, firmware_files(part, RIG)
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    for command in 2 * commands(part, folder)[1:]:
        module.typed(command)
    for name in (f"drivers/{part}/firmware/instrument.py", "main.py"):
        assert module.typed(f"./dev run mpremote cat {name}").encode() == files[name], name
    # What needs no pins runs there at once; the folder has no cache, and nothing else came along.
    said = module.typed(
        "./dev run mpremote exec",
        f"from drivers.{part}.firmware import core, instrument; import os; "
        f"print(hex(instrument.PRODUCT), len(os.listdir('drivers/{part}/firmware')), os.listdir('drivers'))",
    )
    product = RIG.board.product_id if part == "board" else RIG.keys.product_id
    assert said.strip() == f"{product:#x} {len(files) - 1} ['{part}']"


def test_the_library_is_asked_for_in_its_pinned_version(module: Module) -> None:
    asked: list[str] = []
    library = b"VERSION = 'pinned'\n"
    digest = hashlib.sha256(library).hexdigest()[:8]

    class Index(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            asked.append(self.path)
            files = {"hashes": [["usb/device/cdc.py", digest]], "version": "x"}
            answer = json.dumps(files).encode() if self.path.endswith(".json") else library
            self.send_response(200)
            self.end_headers()
            self.wfile.write(answer)

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Index)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        command = commands("board", Path("build/board"))[0]
        module.typed(command.replace(" install ", f" install --index http://127.0.0.1:{server.server_port} "))
        found = module.typed("./dev run mpremote exec", "from usb.device import cdc; print(cdc.VERSION)")
    finally:
        server.shutdown()
        server.server_close()
    name, _, version = LIBRARIES["board"].partition("@")
    assert [path for path in asked if path.endswith(f"/{name}/{version}.json")] == asked[:1]
    assert found.strip() == "pinned"
