"""Programs of others that know the standards and nothing of us: Aravis as client, Wireshark as listener, GenApi as reader."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

import hw_sim.devices
from hw_sim.devices import feature_xml
from hw_sim.devices.makers import MAKERS
from hw_sim.wires.umockdev.testbed import Testbed
from hw_sim.wires.umockdev.usbfs import Urb, UsbDevice
from hw_sim.wires.umockdev.usbmon import Usbmon
from hw_sim.world import World
from tests.libraries.client import Client
from tests.libraries.test_devices import triggered

pytestmark = pytest.mark.foreign

XML = Path(hw_sim.devices.__file__).with_name("u3v_camera.xml")
COMMANDS = {
    0x0800: "readmem_cmd",
    0x0801: "readmem_ack",
    0x0802: "writemem_cmd",
    0x0803: "writemem_ack",
    0x0805: "pending",
}
FIELDS = {
    "readmem_cmd": "u3v.scd_readmem_cmd", "readmem_ack": "u3v.scd_ack_readmem_ack", "writemem_cmd": "u3v.scd_writemem_cmd",
    "writemem_ack": "u3v.scd_writemem_ack", "pending": "u3v.ccd_pending_ack", "leader": "u3v.stream_leader",
    "payload": "u3v.stream_payload", "trailer": "u3v.stream_trailer",
}  # fmt: skip
TIMEOUT_S = 120


def foreign(bed: Testbed | None, *command: object) -> str:
    """What a foreign program prints. Skips where it is not installed; fails where it fails."""
    words = [str(word) for word in command]
    if shutil.which(words[0]) is None:
        pytest.skip(f"{words[0]} is not installed; ./dev test --stage=foreign installs it")
    done = subprocess.run(
        words,
        env={**os.environ, **(bed.environment if bed is not None else {})},
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    assert done.returncode == 0, f"{words}: {done.returncode}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
    return done.stdout


def guid(world: World, side: str) -> str:
    """How Aravis calls a camera: vendor, and the GUID that the standard makes its USB serial number."""
    number = world.cameras[side].identity.guid
    return f"Kingfisher-{number}-{number}"


class Count:
    """Our own count of what goes over the bus, by the first bytes of each transfer."""

    def __init__(self) -> None:
        self.met: Counter[str] = Counter()

    def record(self, event: str, device: UsbDevice, urb: Urb) -> None:
        if urb.setup or event != ("C" if urb.is_in else "S") or (urb.is_in and not urb.done):
            return
        data = bytes(urb.data[:12])
        kind = {b"U3VC": "command", b"U3VL": "leader", b"U3VT": "trailer"}.get(data[:4], "payload")
        self.met[COMMANDS[int.from_bytes(data[6:8], "little")] if kind == "command" else kind] += 1


@pytest.fixture
def heard(world: World, tmp_path: Path) -> Iterator[tuple[Testbed, Count, Path]]:
    """A test bed with two listeners: our own count, and a capture for Wireshark."""
    count, capture = Count(), tmp_path / "bus.pcap"
    with Usbmon(capture) as monitor:

        def both(event: str, device: UsbDevice, urb: Urb) -> None:
            monitor.record(event, device, urb)
            count.record(event, device, urb)

        with Testbed(world, both) as bed:
            yield bed, count, capture


def test_wireshark_understands_every_packet_of_our_driver(world: World, heard: tuple[Testbed, Count, Path]) -> None:
    bed, count, capture = heard
    triggered(world)
    with Client(bed, "cameras", 400, 300, 8, "KF-CAM-L", "KF-CAM-R") as client:
        client.expect("cpu_s", timeout_s=90)
    assert foreign(None, "tshark", "-r", capture, "-Y", "_ws.malformed || _ws.expert.severity == error") == ""
    found: Counter[str] = Counter()
    fields = [word for field in FIELDS.values() for word in ("-e", field)]
    for line in foreign(None, "tshark", "-r", capture, "-Y", "u3v", "-T", "fields", *fields).splitlines():
        for name, value in zip(FIELDS, line.split("\t"), strict=False):
            found[name] += bool(value)
    assert min(found["leader"], found["trailer"]) >= 16
    assert found["pending"] >= 2, "AcquisitionStart takes longer than the response time"
    assert found == count.met


def test_aravis_finds_both_cameras_and_passes_its_own_tests_on_them(world: World, bed: Testbed, tmp_path: Path) -> None:
    """Loading, properties, single and continuous acquisition at two rates, software trigger."""
    listed = foreign(bed, "arv-tool-0.8").splitlines()
    assert sorted(listed) == sorted(f"{guid(world, side)} (USB3)" for side in ("left", "right"))
    own = tmp_path / "arv-test.cfg"
    # arv-test 0.8.26 compares with version 1.0 of the schema whatever is asked for; ours is 1.1, and is checked below.
    own.write_text("[Kingfisher:KFC1920]\nSchema=Ignore\nSensorSize=400;300\nChunksSupport=false\n")
    said = foreign(bed, "arv-test-0.8", "-s", "sync", "-c", own)
    results = re.findall(r"^(\w+:\w+)\s+(SUCCESS|FAILURE|IGNORED)", said, re.MULTILINE)
    assert len(results) == 2 * 15, said
    assert {result for _, result in results} == {"SUCCESS"}, said


@pytest.mark.parametrize("personality", ["usual", *MAKERS])
def test_the_description_is_valid_by_the_schema_of_genapi(tmp_path: Path, personality: str) -> None:
    xml = XML
    if personality in MAKERS:
        xml = tmp_path / f"{personality}.xml"
        xml.write_bytes(feature_xml.description(MAKERS[personality], 0x20_1000))
    schema = tmp_path / "GenApiSchema_Version_1_1.xsd"
    program = shutil.which("arv-test-0.8")
    if program is None:
        pytest.skip("arv-test-0.8, which carries the schema, is not installed; ./dev test --stage=foreign installs it")
    schema.write_text(foreign(None, "gresource", "extract", program, f"/org/aravis/{schema.name}"))
    assert foreign(None, "xmllint", "--noout", "--schema", schema, xml) == "", "and nothing to say"


def test_two_implementations_of_genapi_read_the_same(world: World, bed: Testbed) -> None:
    """What Aravis has set, the reference implementation reads over our driver; and both read the same everywhere."""
    name = guid(world, "left")
    foreign(bed, "arv-tool-0.8", "-n", name, "control", "Width=320", "ExposureTime=7500", "Gain=6", "TriggerMode=On")
    said = foreign(bed, "arv-tool-0.8", "-n", name, "values")
    by_aravis = dict(re.findall(r"\[R[OW]\] '(\w+)' = (.*)$", said, re.MULTILINE))
    assert len(by_aravis) > 25
    with Client(bed, "features", "KF-CAM-L", *by_aravis) as client:
        heard = client.expect("xml")
    assert hashlib.sha256(heard["xml"].encode()).digest() == hashlib.sha256(XML.read_bytes()).digest()
    by_genapi = heard["values"]
    assert (by_genapi["Width"], by_genapi["TriggerMode"]) == ("320", "On")
    assert float(by_genapi["ExposureTime"]) == 7500
    for feature, text in by_aravis.items():
        assert _same(text, by_genapi[feature]), f"{feature}: Aravis {text}, GenApi {by_genapi[feature]}"


def _same(aravis: str, reference: str) -> bool:
    """Aravis quotes strings and adds units; a temperature may have changed in its last digit meanwhile."""
    if aravis.startswith("'"):
        return aravis == f"'{reference}'"
    if aravis in ("true", "false"):
        return (aravis == "true") == (reference in ("1", "true"))
    return float(aravis.split()[0]) == pytest.approx(float(reference), abs=0.3, rel=1e-5)
