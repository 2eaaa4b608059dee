"""The walks of CONTRIBUTING.md are true: the files are there, they are few, and they are those that the examples touch."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from appliance.machine.alerts import RULES
from appliance.processing.judges import JUDGES
from appliance.scan.fault import FaultCode

ROOT = Path(__file__).parents[1]
MOST = {
    "A family of cameras": 3,
    "A verdict": 3,
    "A sequence of patterns": 1,
    "A screen with a state of its own": 10,
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


def naming(pattern: str) -> set[str]:
    """The product's files that name something outside of strings and comments."""
    found = set()
    for path in product_files():
        tree = ast.parse(path.read_text(encoding="utf-8"))
        names = {ast.unparse(node) for node in ast.walk(tree) if isinstance(node, ast.Name | ast.Attribute)}
        names |= {node.name for node in ast.walk(tree) if isinstance(node, ast.ClassDef | ast.FunctionDef)}
        names |= {alias.name for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) for alias in node.names}
        if any(re.fullmatch(pattern, name) for name in names):
            found.add(str(path.relative_to(ROOT)))
    return found


def test_every_walk_is_listed_and_short() -> None:
    assert {name: len(files) <= MOST[name] for name, files in walks().items()} == dict.fromkeys(MOST, True)


@pytest.mark.parametrize("walk", sorted(MOST))
def test_the_files_of_a_walk_are_there(walk: str) -> None:
    files = walks()[walk]
    assert files
    for name in files:
        assert (ROOT / name.replace("/<name>.py", "")).exists(), name


def test_a_judge_is_named_in_the_table_and_nowhere_above() -> None:
    above = {name for name in naming("judge_water") if not name.startswith("appliance/verdict/")}
    assert above == {"appliance/processing/judges.py"}
    assert "water" in {judge.name for judge in JUDGES}


def test_a_screen_is_named_in_the_files_of_its_walk() -> None:
    named = naming(r"State\.COOLING|COOLING|CoolingView|cooling")
    shared = {name for name in walks()["A screen with a state of its own"] if "<name>" not in name}
    assert shared <= named, "a file of the walk that the example does not touch"
    own = {"appliance/machine/safety.py", "appliance/screens/stops.py"}
    enters = {"appliance/machine/scanning.py", "appliance/machine/alerts.py"}
    assert named - shared - own <= enters, "a file that the example touches is missing from the walk"


def test_every_fault_has_its_row() -> None:
    assert set(RULES) == set(FaultCode)
