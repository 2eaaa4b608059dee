"""The walks of CONTRIBUTING.md are true: the files are there, they are few, and they are those that the examples touch."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
from functools import cache
from pathlib import Path

import pytest

from appliance.desk.export.formats import FORMATS, Format
from appliance.instrument.machine.alerts import RULES, Rule
from appliance.measure.fault import FaultCode
from appliance.measure.judges import JUDGES, Judge
from appliance.measure.light.patterns import PatternSequence
from drivers.camera_families import families

ROOT = Path(__file__).parents[1]
MOST = {
    "A family of cameras": 3,
    "A verdict": 3,
    "A sequence of patterns": 1,
    "A screen with a state of its own": 8,
    "A step of the guided bring-up": 2,
    "A format of clouds or meshes": 2,
    "A fault": 2,
}


def walks() -> dict[str, list[str]]:
    """Each walk's files in order, by its name."""
    text = (
        (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").partition("### What to touch")[2].partition("\n## ")[0]
    )
    parts = re.split(r"^\*\*(.+?)\*\*", text, flags=re.MULTILINE)
    return {
        name: re.findall(r"^\d+\. `([^`]+)`", body, re.MULTILINE)
        for name, body in zip(parts[1::2], parts[2::2], strict=True)
    }


def product_files() -> list[Path]:
    return [path for package in ("appliance", "drivers") for path in sorted((ROOT / package).rglob("*.py"))]


@cache
def names() -> dict[str, frozenset[str]]:
    """What each of the product's files names outside of strings and comments."""
    found = {}
    for path in product_files():
        named: set[str] = set()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            match node:
                case ast.Name() | ast.Attribute():
                    named.add(ast.unparse(node))
                case ast.ClassDef() | ast.FunctionDef():
                    named.add(node.name)
                case ast.ImportFrom():
                    named |= {alias.name for alias in node.names}
                case _:
                    pass
        found[str(path.relative_to(ROOT))] = frozenset(named)
    return found


def naming(pattern: str) -> set[str]:
    """The product's files that name something."""
    return {path for path, named in names().items() if any(re.fullmatch(pattern, name) for name in named)}


def source_of(made: object) -> Path:
    """The file of a class or a function."""
    return Path(inspect.getsourcefile(made) or "")  # type: ignore[arg-type]


def test_every_walk_is_listed_and_short() -> None:
    assert {name: len(files) <= MOST[name] for name, files in walks().items()} == dict.fromkeys(MOST, True)


@pytest.mark.parametrize("walk", sorted(MOST))
def test_the_files_of_a_walk_are_there(walk: str) -> None:
    files = walks()[walk]
    assert files
    for name in files:
        assert (ROOT / name.replace("/<name>.py", "")).exists(), name


def test_a_screen_is_named_in_the_files_of_its_walk() -> None:
    named = naming(r"State\.COOLING|COOLING|CoolingView|cooling")
    shared = {name for name in walks()["A screen with a state of its own"] if "<name>" not in name}
    assert shared <= named, "a file of the walk that the example does not touch"
    own = {"appliance/instrument/machine/safety.py", "appliance/instrument/screens/progress.py"}
    enters = {"appliance/instrument/machine/scanning.py", "appliance/instrument/machine/leading.py"}
    assert named - shared - own <= enters, "a file that the example touches is missing from the walk"


def test_a_verdict_is_named_in_the_files_of_its_walk_and_its_judge_in_no_other() -> None:
    """By its judge, which has a row in one table, and by its fault, which has a row in another."""
    folder, judges, alerts = walks()["A verdict"]
    assert folder == "appliance/measure/verdicts/<name>.py"
    assert (ROOT / judges, ROOT / alerts) == (source_of(Judge), source_of(Rule))
    assert {name for name in naming("judge_water") if not name.startswith("appliance/measure/verdicts/")} == {judges}
    assert "water" in {judge.name for judge in JUDGES}
    assert alerts in naming(r"FaultCode\.WATER_DIRTY")


def test_a_sequence_promises_what_it_is_where_it_is_built() -> None:
    (only,) = walks()["A sequence of patterns"]
    assert ROOT / only == source_of(PatternSequence)
    assert only in naming("PERIODS_PX")


def test_families_of_cameras_are_looked_for_in_the_folder_of_their_walk() -> None:
    (only,) = walks()["A family of cameras"]
    assert (ROOT / only).parent == source_of(families).parent


def test_a_fault_has_its_name_and_its_row_in_the_files_of_its_walk() -> None:
    name, row = walks()["A fault"]
    assert (ROOT / name, ROOT / row) == (source_of(FaultCode), source_of(Rule))
    assert row in naming(r"FaultCode\.LEAK")


def test_a_step_of_the_bring_up_is_named_in_its_row_and_nowhere_above() -> None:
    folder, rows = walks()["A step of the guided bring-up"]
    assert folder == "appliance/workshop/<name>.py"
    assert naming(r"pad\.do") == {rows}


def test_a_format_is_named_in_its_row_and_writes_what_the_row_says() -> None:
    folder, rows = walks()["A format of clouds or meshes"]
    assert source_of(Format) == ROOT / rows
    assert naming("encode_las|laspy") == {folder.replace("<name>", "las")}
    for one in FORMATS:
        module = importlib.import_module(f"appliance.desk.export.{one.module}")
        assert one.contents == tuple(
            name for name in ("points", "grid", "scans", "mesh") if hasattr(module, f"write_{name}")
        )


def test_every_fault_has_its_row() -> None:
    assert set(RULES) == set(FaultCode)
