"""The walk through the twelve steps: which comes next, what is kept of each, and what ends it; steps are values here."""

from __future__ import annotations

import datetime
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from appliance.bringup.finding import BringupError, Finding
from appliance.bringup.guide import OF_THE_PROJECTOR, GuideStep, StepOutcome, step_of
from appliance.bringup.guide_state import GuideState, StepRecord
from appliance.bringup.rig_edit import KeyValue
from appliance.config import load_rig
from appliance.service.bringup import guide
from appliance.service.bringup.folder import GuideFolder
from appliance.service.bringup.guide import GuideOptions, Walked
from appliance.service.bringup.workplace import Workplace
from drivers.api import DeviceGone
from tests.appliance.service.bringup.scripted import RIG_FILE, AskedPerson, Told, workplace
from tests.drivers.clock import SteppedClock

GOOD, BAD = Finding("rate", True, "60 Hz"), Finding("rate", False, "59 Hz", "60 Hz", "choose a mode of 60 Hz")
PNG = b"\x89PNG dark"
Outcomes = Callable[[GuideStep, Workplace], Mapping[str, StepOutcome]]


def good(step: GuideStep, at: Workplace) -> Mapping[str, StepOutcome]:
    at.wires.clock.sleep_s(1.0)
    names = OF_THE_PROJECTOR if step.name in OF_THE_PROJECTOR else (step.name,)
    return {name: StepOutcome((GOOD,), {}, {f"{name}.png": ("It", PNG)}) for name in names}


def bad(*names: str) -> Outcomes:
    def outcomes(step: GuideStep, at: Workplace) -> Mapping[str, StepOutcome]:
        found = good(step, at)
        return {name: replace(one, findings=(BAD,)) if name in names else one for name, one in found.items()}

    return outcomes


class Bench:
    def __init__(self, folder: Path) -> None:
        self.rig_file = folder / "rig.toml"
        self.rig_file.write_text(RIG_FILE.read_text(encoding="utf-8"), encoding="utf-8")
        self.place = GuideFolder(folder / "out")
        self.place.prepare()
        self.told: list[str] = []

    def walk(self, outcomes: Outcomes = good, **options: Any) -> Walked:
        today = SimpleNamespace(utc=datetime.datetime(2031, 5, 6, 7, 8, 9, 500, tzinfo=datetime.UTC), kept=True)
        wires: Any = SimpleNamespace(clock=SteppedClock(), calendar=SimpleNamespace(today=lambda: today))
        self.told.clear()
        one = guide._Walk(
            self.rig_file, self.place, GuideOptions(**options), wires, AskedPerson(), Told(),
            lambda name, _record: self.told.append(name), self.place.read(), outcomes,
        )  # fmt: skip
        return one.walk()

    def change(self, pattern: str, by: str) -> None:
        text, changed = re.subn(pattern, by, self.rig_file.read_text(encoding="utf-8"), count=1)
        assert changed
        self.rig_file.write_text(text, encoding="utf-8")


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def test_the_first_that_is_not_good_ends_it_and_the_next_call_goes_on_there(bench: Bench) -> None:
    walked = bench.walk(bad("vsync"))
    assert (walked.good, walked.stopped, walked.done) == (False, None, ("board", "pad", "vsync"))
    walked = bench.walk(bad("cameras"))
    assert walked.done == ("vsync", "cameras")
    assert list(walked.steps) == ["board", "pad", "vsync", "cameras"]
    assert not walked.steps["cameras"].good
    walked = bench.walk(bad("light"))
    assert walked.done == ("cameras", "trigger", *OF_THE_PROJECTOR, "endurance"), "which needs no light"
    assert walked.stopped == "step plane needs light, which is not good; do that first"


def test_a_step_that_writes_into_the_rig_file_rests_on_the_file_as_it_is_then(bench: Bench) -> None:
    def writing(step: GuideStep, at: Workplace) -> Mapping[str, StepOutcome]:
        if step.name in OF_THE_PROJECTOR:
            bench.change("trigger_delay_us = 500", "trigger_delay_us = 900")
        written = {KeyValue("board", "trigger_delay_us"): 900}
        assert load_rig(at.rig_file) == at.rig or step.name in OF_THE_PROJECTOR
        return {name: replace(one, written=written) for name, one in good(step, at).items()}

    walked = bench.walk(writing)
    assert walked.steps["light"].inputs["board.trigger_delay_us"] == 900
    assert walked.good
    assert bench.walk().done == ()


def test_only_these_and_again_those(bench: Bench) -> None:
    bench.walk()
    assert bench.walk(again=("pad",)).done == ("pad",)
    walked = bench.walk(bad("pad"), only=("pad",))
    assert (walked.done, walked.good) == (("pad",), False)
    walked = bench.walk(only=("board",))
    assert (walked.done, walked.good) == (("board",), True), "the pad was not asked for"
    assert not bench.walk(bad("pad")).good
    assert bench.walk(only=("sides", "light")).done == OF_THE_PROJECTOR


@pytest.mark.parametrize(
    ("error", "name", "said", "remedy"),
    [
        (DeviceGone("keys", "no key pad", "Check the cable"), "keys", "no key pad", "Check the cable"),
        (BringupError("it is dark; light it"), "measurement", "it is dark", "light it"),
        (BringupError("it is dark"), "measurement", "it is dark", "see the findings before"),
    ],
)
def test_what_ends_a_step_early_is_a_finding(
    error: Exception, name: str, said: str, remedy: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_at: Workplace) -> StepOutcome:
        raise error

    monkeypatch.setattr(guide, "_ALONE", {"pad": fail, "board": lambda _at: StepOutcome((GOOD,))})
    at = workplace()[0]
    ((found,),) = (one.findings for one in guide._outcomes(step_of("pad"), at).values())
    assert (found.name, found.ok, found.said, found.remedy) == (name, False, said, remedy)
    assert guide._outcomes(step_of("board"), at) == {"board": StepOutcome((GOOD,))}


def test_a_folder_that_is_new_has_an_empty_state_and_the_page_shows_its_own_pictures(tmp_path: Path) -> None:
    (tmp_path / "secret.png").write_bytes(PNG)
    place = GuideFolder(tmp_path / "a" / "b")
    place.prepare()
    assert place.read() == GuideState()
    assert place.keep(StepOutcome((GOOD,), {}, {"dark.png": ("Dark", PNG)})) == [place.folder / "dark.png"]
    others = {"gone.png": "Taken away", "../../secret.png": "?", str(tmp_path / "secret.png"): "?"}
    outcome = StepOutcome(
        (GOOD,), {}, {file: (caption, PNG) for file, caption in ({"dark.png": "Dark"} | others).items()}
    )
    state = GuideState().with_step("cameras", StepRecord.of(outcome, "", 1.0, {}))
    written = place.write(state, RIG_FILE.read_text(encoding="utf-8"))
    assert [path.name for path in written] == ["bringup.json", "bringup.html"]
    assert place.read() == state
    assert (place.folder / "bringup.html").read_text(encoding="utf-8").count("data:image/png") == 1
    assert place._pictures(state) == {"dark.png": PNG}, "a picture's name leads nowhere else"
