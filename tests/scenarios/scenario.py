"""A whole dive as a text that an operator can read: a world, what breaks, key presses, what is to be seen, what is left.

    # comment
    world object=plane texture=checker           before: options of the simulated world (docs/protocols/world.md)
    rig limits.case_warm_c=25                    before: a value of the rig file
    given nonsense in calibration/current.json   before: a file below the storage root
    given fault camera.left slow                 before: what is broken when the power comes on
    given disk 40                                before: the storage is a disk of its own, of so many MB
    given calibrated                             before: a calibration in water that is exactly right (of the nominal rig)
    power cut                                    in the dive: the machine is off at that moment; what follows is the next start
    ends * is gone *                             in the dive: the program ends with these words; what follows is the next start
    ...                                          the dive: a diver's script (docs/protocols/world.md)
    after saved 1                                afterwards: how many scans lie there; each must be whole
    after rejected 1
    after verdict motion failed in 000002        or: passed
    after damaged 000007                         and no other
    after dated 2026-11-20T10:00 in 000001       how its date begins, which somebody kept; undated: nobody did
    after salinity 35 in 000001                  g/kg, of the water that it was measured in

Every scan that the screen called SAVED must be there and whole, whether the text says so or not.
"""

from __future__ import annotations

import fnmatch
import re
import signal
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from appliance.calibrate.calibrations import Calibrations
from appliance.cli.simrig import default_sim_rig
from appliance.instrument.service.app import run
from appliance.store.config import load_rig
from appliance.store.instrument import Instrument
from appliance.store.library import Library, LibraryFolder
from appliance.store.manifest import ScanRecord

SMALL = {"width_px": "400", "height_px": "300", "truth": "nominal", "object": "plane", "stills": "true"}
SHELVES = {"saved": LibraryFolder.SCANS, "rejected": LibraryFolder.REJECTED, "set-aside": LibraryFolder.SET_ASIDE}
PATTERNS = {
    "world": r"world( \w+=\S+)+",
    "rig": r"rig( [\w.]+=\S+)+",
    "given": r"given (nonsense in \S+|fault .+|disk \d+|calibrated)",
    "after": r"after ((saved|rejected|set-aside) \d+|verdict [\w-]+ (passed|failed) in \d{6}|damaged \d{6}|(dated|undated|salinity) \S+ in \d{6})",
}


@dataclass(frozen=True, slots=True)
class Scenario:
    """A text, taken apart."""

    world: Mapping[str, str]
    rig: Mapping[str, str]
    given: tuple[str, ...]
    script: str
    """The diver's part; every line where it stands in the file."""
    after: tuple[tuple[str, ...], ...]

    def given_words(self, begin: str) -> list[str]:
        """Return what follows ``begin`` in each line about what was before."""
        return [said.removeprefix(begin).strip() for said in self.given if said.startswith(begin)]

    @property
    def starts(self) -> list[tuple[str, str | None]]:
        """The diver's part of each start, each line where it stands in the file, and with which words the program ends;
        ``None``: the power is cut or, after the last part, switched off."""
        parts: list[tuple[list[str], str | None]] = []
        lines: list[str] = []
        for line in self.script.split("\n"):
            verb, _, words = " ".join(line.split("#", 1)[0].split()).partition(" ")
            lines.append("" if verb == "ends" else line)
            if verb == "ends" or (verb, words) == ("power", "cut"):
                parts.append((lines, words if verb == "ends" else None))
                lines = [""] * len(lines)
        return [("\n".join(part), ends) for part, ends in [*parts, (lines, None)]]


def parse(text: str) -> Scenario:
    """Raises ValueError for a line before or after the dive that is not understood."""
    found: dict[str, list[str]] = {verb: [] for verb in PATTERNS}
    script: list[str] = []
    for number, line in enumerate(text.splitlines(), 1):
        said = " ".join(line.split("#", 1)[0].split())
        verb = said.partition(" ")[0]
        if verb in PATTERNS and not re.fullmatch(PATTERNS[verb], said):
            raise ValueError(f"line {number}: '{said}' is not understood; allowed: {PATTERNS[verb]}")
        if verb in PATTERNS:
            found[verb].append(said.partition(" ")[2])
        script.append("" if verb in PATTERNS else line)
    world, rig = (
        dict(pair.split("=", 1) for said in found[verb] for pair in said.split()) for verb in ("world", "rig")
    )
    after = tuple(tuple(said.split()) for said in found["after"])
    return Scenario(world, rig, tuple(found["given"]), "\n".join(script), after)


def play(scenario: Scenario, folder: Path) -> Library:
    """Dive, from power on to power off, and look at what is left. Raises what the script or the service raises."""
    root = folder / "root"
    for size_mb in scenario.given_words("disk"):
        _mount(root, size_mb)
    for name in scenario.given_words("nonsense in"):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(b'{"nonsense": \x00')
    script, rig_file = folder / "dive.script", folder / "rig.toml"
    rig_file.write_text(_rig_text(scenario), encoding="utf-8")
    rig = load_rig(rig_file)
    if "calibrated" in scenario.given:
        exact = replace(Instrument(rig).design(), method="bundle", made_at="2026-11-20T10:00:00+00:00")
        Calibrations(root, rig.rig.serial).install(exact, "2026-11-20")
    options = {**rig.rig.wires_options, "script": str(script), "status": str(root / "run" / "status.json")}
    *cut_short, (last, _) = scenario.starts
    for part, ends in cut_short:
        script.write_text(part, encoding="utf-8")
        _cut_short(rig_file, options, root, ends)
    script.write_text(last, encoding="utf-8")
    rig = replace(rig, rig=replace(rig.rig, wires_options=options), storage=replace(rig.storage, root=root))
    assert run(rig) == 0
    return Library(root)


def _cut_short(rig_file: Path, options: Mapping[str, Any], root: Path, ends: str | None) -> None:
    """One start in a process of its own. It ends as a machine does that loses its power, or by itself with these words."""
    text = _set(rig_file.read_text(encoding="utf-8"), "storage", "root", str(root))
    for name in ("script", "status"):
        text = _set(text, "rig.wires_options", name, str(options[name]))
    once = rig_file.with_name("once.toml")
    once.write_text(text, encoding="utf-8")
    started = subprocess.run(
        [sys.executable, "-m", "appliance.cli", "run", "--rig", str(once)],
        capture_output=True, text=True, timeout=280, check=False,
    )  # fmt: skip
    if ends is None:
        assert started.returncode == -signal.SIGKILL, started.stderr[-2000:]
    else:
        assert started.returncode > 0, started.stderr[-2000:]
        assert fnmatch.fnmatchcase(" ".join(started.stderr.split()), f"*{ends}*"), started.stderr[-2000:]
    (root / "run" / "status.json").unlink(missing_ok=True)  # it lies in memory on the instrument


def _mount(root: Path, size_mb: str) -> None:
    """A disk in memory; it goes with the last one who uses it. Skipped where this user may not mount one."""
    root.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size_mb}m", "none", str(root)]
    mounted = subprocess.run(mount, capture_output=True, timeout=20, check=False)
    if mounted.returncode != 0:
        pytest.skip(f"no disk can be mounted: {mounted.stderr.decode().strip()}")


def _record(library: Library, scan_id: str) -> ScanRecord:
    manifest = library.entry(scan_id).manifest
    assert manifest is not None, f"scan {scan_id} has no readable manifest"
    return manifest.record


def judge(scenario: Scenario, library: Library) -> list[str]:
    """What the disk holds otherwise than the text says, and which scans that were kept are not whole."""
    damaged = {entry.scan_id for entry in library.entries() if not library.verify(entry.scan_id).ok}
    expected = {words[1] for words in scenario.after if words[0] == "damaged"}
    wrong = [f"{scan_id} is not whole" for scan_id in damaged - expected]
    wrong += [f"{scan_id} is not damaged" for scan_id in expected - damaged]
    for words in scenario.after:
        match words:
            case ("damaged", _):
                pass
            case ("verdict", name, wanted, "in", scan_id):
                verdicts = {verdict.name: verdict for verdict in _record(library, scan_id).verdicts}
                if name not in verdicts or verdicts[name].passed is not (wanted == "passed"):
                    wrong.append(f"{' '.join(words)}: {verdicts.get(name, sorted(verdicts))}")
            case ("dated" | "undated" as said, date, "in", scan_id):
                record = _record(library, scan_id)
                if record.clock_trusted is not (said == "dated") or not str(record.wall_time).startswith(date):
                    wrong.append(f"{' '.join(words)}: {record.wall_time}, {record.clock_trusted}")
            case ("salinity", psu, "in", scan_id):
                water = _record(library, scan_id).water
                if water["salinity_psu"] != float(psu):
                    wrong.append(f"{' '.join(words)}: {water}")
            case (shelf, number):
                found = [entry.scan_id for entry in library.entries(SHELVES[shelf])]
                if len(found) != int(number):
                    wrong.append(f"{' '.join(words)}: there are {found}")
    return wrong


def _rig_text(scenario: Scenario) -> str:
    """The simulator's small rig with the changes, section by section."""
    text = default_sim_rig().with_name("small.toml").read_text(encoding="utf-8")
    for key, value in scenario.rig.items():
        section, _, name = key.rpartition(".")
        text = _set(text, section, name, value)
    faults = {"faults": repr(scenario.given_words("fault"))}
    for name, value in {**SMALL, **faults, **scenario.world}.items():
        text = _set(text, "rig.wires_options", name, value)
    return text


def _set(text: str, section: str, name: str, value: str) -> str:
    head = f"[{section}]"
    assert re.search(rf"^{re.escape(head)}", text, re.M), f"the rig file has no {head}"
    written = value if re.fullmatch(r"[-+\d.e]+|true|false|\[.*\]|\{.*\}", value) else f'"{value}"'
    before, after = text.split(head, 1)
    body, bracket, rest = after.partition("\n[")
    body = re.sub(rf"^{re.escape(name)}\s*=.*\n?", "", body, flags=re.M).rstrip("\n")
    return f"{before}{head}{body}\n{name} = {written}\n{bracket}{rest}"
