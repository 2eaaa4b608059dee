"""Documents point to things that exist: links, files named in code marks, commands of ./dev, the list of decisions."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from appliance.cli.verbs import VERBS, Group
from appliance.instrument.machine.states import State
from appliance.measure.fault import FaultCode

ROOT = Path(__file__).parents[1]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "systemd").glob("*.md")])
TRACKED = ("appliance", "drivers", "hw_sim", "bench", "docs", "systemd", "tests")


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("document", DOCUMENTS, ids=name_of)
def test_links_lead_somewhere(document: Path) -> None:
    links = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", document.read_text(encoding="utf-8"))
    broken = [link for link in links if "://" not in link and not (document.parent / link).exists()]
    assert not broken


@pytest.mark.parametrize("document", DOCUMENTS, ids=name_of)
def test_files_that_are_named_exist(document: Path) -> None:
    named = re.findall(rf"`((?:{'|'.join(TRACKED)})/[\w./-]+\.\w+)`", document.read_text(encoding="utf-8"))
    missing = [path for path in named if not (ROOT / path).exists()]
    assert not missing


def test_modules_that_are_named_without_their_folder_are_somewhere() -> None:
    there = [f"/{path.as_posix()}" for package in TRACKED for path in (ROOT / package).rglob("*.py")]
    gone = [
        f"{name_of(document)}: {name}"
        for document in DOCUMENTS
        for name in set(re.findall(r"`([\w/]+\.py)`", document.read_text(encoding="utf-8")))
        if not any(path.endswith(f"/{name}") for path in there)
    ]
    assert not gone


@pytest.mark.parametrize("document", DOCUMENTS, ids=name_of)
def test_commands_that_are_named_exist(document: Path) -> None:
    dispatch = (ROOT / "dev").read_text(encoding="utf-8").partition("\nmain() {")[2]
    verbs = set(re.findall(r"\b[a-z]+\b", " ".join(re.findall(r"^    ([a-z |-]+)\)", dispatch, re.MULTILINE))))
    assert {"demo", "test", "check", "bench", "help"} <= verbs
    named = set(re.findall(r"(?:^    |`)\./dev ([a-z]+)", document.read_text(encoding="utf-8"), re.MULTILINE))
    assert named <= verbs


def test_the_walk_through_a_scan_names_what_is_in_the_code() -> None:
    files = {
        path: path.read_text(encoding="utf-8")
        for package in ("appliance", "drivers")
        for path in (ROOT / package).rglob("*.py")
    }
    known = {word for text in files.values() for word in re.findall(r"\w+", text)}
    named = set(re.findall(r"`([^`\n]+)`", (ROOT / "docs" / "scan-walkthrough.md").read_text(encoding="utf-8")))
    modules = {name for name in named if name.endswith(".py")}
    names = {
        name for name in named - modules if re.fullmatch(r"[\w.]+(\([^)]*\))?", name) and not name.startswith("kf-")
    }
    assert len(modules) > 20
    assert len(names) > 20
    assert not [name for name in modules if not any(path.as_posix().endswith(f"/{name}") for path in files)]
    assert not [name for name in names if not set(re.findall(r"\w+", name.partition("(")[0])) <= known]


def test_every_decision_is_listed_once_by_its_title_and_is_short() -> None:
    folder = ROOT / "docs" / "adr"
    index = (folder / "README.md").read_text(encoding="utf-8")
    for record in sorted(folder.glob("0*.md")):
        text = record.read_text(encoding="utf-8")
        assert len(text.split()) <= 350, record.name
        if record.name != "0000-template.md":
            title = text.partition("\n")[0].removeprefix("# ")
            assert index.count(f"- [{title}]({record.name})") == 1, record.name


def test_a_number_is_a_decision_that_holds_or_a_line_of_the_history() -> None:
    folder = ROOT / "docs" / "adr"
    records = [record.name[:4] for record in folder.glob("0*.md") if record.name != "0000-template.md"]
    past = re.findall(r"^\| (\d{4}) \|", (folder / "history.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(records + past) == [f"{number:04}" for number in range(1, len(records + past) + 1)]


def test_every_scenario_is_in_the_list_of_faults() -> None:
    listed = (ROOT / "docs" / "faults.md").read_text(encoding="utf-8")
    scenarios = sorted(path.name for path in (ROOT / "tests" / "scenarios").glob("*.scn"))
    assert scenarios
    assert [name for name in scenarios if f"scenarios/{name})" not in listed] == []


DICTIONARY = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
ENTRY = re.compile(r"\| \*\*(.+)\*\* \| (.+) \| (.+) \|")


def test_the_dictionary_has_one_word_for_one_thing() -> None:
    words: list[str] = []
    replaced: list[str] = []
    for section in DICTIONARY.split("\n## "):
        rows = [row for row in section.split("\n") if row.startswith("| **")]
        entries = [entry.groups() for row in rows if (entry := ENTRY.fullmatch(row))]
        assert len(entries) == len(rows), section.partition("\n")[0]
        ours = [word.lower() for word, _, _ in entries]
        assert ours == sorted(ours), section.partition("\n")[0]
        words += ours
        for _, _, others in entries:
            replaced += [] if others == "–" else [other.lower() for other in re.split(r", (?![^(]*\))", others)]
    assert len(words) > 200
    assert [word for word in words if words.count(word) > 1] == []
    assert [other for other in replaced if replaced.count(other) > 1 or other in words] == []


def test_words_that_the_dictionary_calls_promised_are_there() -> None:
    def promised(kind: str) -> set[str]:
        row = re.search(rf"^\| {kind} \| (.+) \| \[", DICTIONARY, re.MULTILINE)
        assert row, kind
        return set(re.findall("`([^`]+)`", row[1]))

    assert promised("states") <= {state.value for state in State}
    assert promised("faults") <= {code.value for code in FaultCode}
    verbs = {verb.name for verb in VERBS}
    verbs |= {f"{group.name} {verb.name}" for group in VERBS if isinstance(group, Group) for verb in group.verbs}
    written = {words.partition(" ")[::2] for words in promised("verbs")}
    assert {f"{name} {one}".strip() for name, others in written for one in others.split("/")} <= verbs


MEASURED = (
    "accuracy", "air-calibration", "archive", "architecture", "boot", "calibration", "calibration-health", "causes",
    "compensation", "exposure", "foreign", "identity", "motion", "objects", "one-direction", "performance", "phase-bias", "ranging",
    "thermal", "turbidity", "uncertainty",
)  # fmt: skip
FIGURES = re.compile(r"\*Figures of \d{4}-\d\d-\d\d(?: to \d{4}-\d\d-\d\d)? \([0-9a-f]{8}(?: to [0-9a-f]{8})?\)\.\*")
A_NUMBER = re.compile(r"\|[^|a-zA-Z]*\d[^|]*(?=\|)")


@pytest.mark.parametrize("page", MEASURED)
def test_every_table_of_figures_says_of_which_day_and_version_it_is(page: str) -> None:
    lines = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8").splitlines()
    dated = 0
    for k, line in enumerate(lines):
        if line.startswith("|---") and lines[k - 1].startswith("|"):
            end = next((j for j in range(k, len(lines)) if not lines[j].startswith("|")), len(lines))
            rows = lines[k + 1 : end]
            below = next((text for text in lines[end:] if text.strip()), "")
            if (
                len(rows) > 1
                and all(A_NUMBER.search(row) for row in rows)
                and not lines[k - 1].startswith("| files of")
            ):
                assert FIGURES.fullmatch(below), f"{page}: {lines[k - 1]}"
            dated += FIGURES.fullmatch(below) is not None
    assert dated
