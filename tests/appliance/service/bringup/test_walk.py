"""The walk through the twelve steps: which comes next, what is kept of each, and what ends it; steps are values here."""

from __future__ import annotations

import datetime
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import appliance
from appliance.bringup.finding import BringupError, Finding
from appliance.bringup.guide import NAMES, OF_THE_PROJECTOR, GuideStep, StepOutcome, step_of
from appliance.bringup.guide_state import STATE, GuideState, StepRecord
from appliance.bringup.person import GivenUp
from appliance.bringup.rig_edit import KeyValue
from appliance.config import load_rig
from appliance.service.bringup import folder as folders
from appliance.service.bringup import guide
from appliance.service.bringup.folder import GuideFolder, checksum
from appliance.service.bringup.guide import GuideOptions, Walked
from appliance.service.bringup.workplace import Workplace
from appliance.storage.lock import holder
from drivers.api import DeviceGone
from tests.appliance.service.bringup.scripted import RIG_FILE, AskedPerson, Told, workplace
from tests.drivers.clock import SteppedClock

GOOD, BAD = Finding("rate", True, "60 Hz"), Finding("rate", False, "59 Hz", "60 Hz", "choose a mode of 60 Hz")
PNG = b"\x89PNG dark"
Outcomes = Callable[[GuideStep, Workplace], Mapping[str, StepOutcome]]


def good(step: GuideStep, at: Workplace) -> Mapping[str, StepOutcome]:
    """Every step is good, takes a second, and has a picture."""
    at.wires.clock.sleep_s(1.0)
    names = OF_THE_PROJECTOR if step.name in OF_THE_PROJECTOR else (step.name,)
    return {name: StepOutcome((GOOD,), {}, {f"{name}.png": ("It", PNG)}) for name in names}


def bad(*names: str) -> Outcomes:
    def outcomes(step: GuideStep, at: Workplace) -> Mapping[str, StepOutcome]:
        found = good(step, at)
        return {name: replace(one, findings=(BAD,)) if name in names else one for name, one in found.items()}

    return outcomes


class Bench:
    """One rig file and one folder, which are walked again and again."""

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


def test_all_twelve_are_walked_in_order_and_kept_with_their_pictures(bench: Bench) -> None:
    walked = bench.walk()
    assert walked.good
    assert walked.stopped is None
    # Five of one measurement are done by the first of them.
    assert walked.done == tuple(bench.told) == (*NAMES[:5], *OF_THE_PROJECTOR, *NAMES[10:])
    assert list(walked.steps) == list(NAMES)
    out = bench.place.folder
    assert set(walked.written) == {out / f"{name}.png" for name in NAMES} | {out / STATE, out / "bringup.html"}
    assert len(walked.written) == len(set(walked.written))
    record = walked.steps["pad"]
    assert (record.when, record.duration_s, record.good) == ("2031-05-06T07:08:09+00:00", 1.0, True)
    assert record.inputs["keys.product_id"] == 0x4B46
    state = bench.place.read()
    assert state.rig_sha256 == checksum(bench.rig_file.read_text(encoding="utf-8"))
    assert bench.walk().done == ()
    assert (out / "pad.png").read_bytes() == PNG


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


def test_a_key_that_changed_makes_what_rests_on_it_be_done_again(bench: Bench) -> None:
    bench.walk()
    bench.change("product_id = 0x4B46", "product_id = 0x4B47")
    assert bench.walk().done == ("pad",)


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


def test_a_step_that_needs_others_says_which(bench: Bench) -> None:
    walked = bench.walk(only=("vsync",))
    assert (walked.done, walked.good) == ((), False)
    assert walked.stopped == "step vsync needs board, which is not good; do that first"
    walked = bench.walk(only=("trigger",))
    assert walked.stopped == "step trigger needs board, vsync, cameras, which are not good; do that first"


def test_who_gives_up_keeps_what_was_done(bench: Bench) -> None:
    def leaving(step: GuideStep, at: Workplace) -> Mapping[str, StepOutcome]:
        if step.name == "vsync":
            raise GivenUp("call again to go on here")
        return good(step, at)

    walked = bench.walk(leaving)
    assert (walked.good, walked.stopped, walked.done) == (False, "call again to go on here", ("board", "pad"))
    assert list(bench.place.read().steps) == ["board", "pad"]


def test_what_was_told_is_kept_already(bench: Bench) -> None:
    def watching(step: GuideStep, at: Workplace) -> Mapping[str, StepOutcome]:
        assert list(bench.place.read().steps) == bench.told
        return good(step, at)

    bench.walk(watching)
    assert len(bench.told) == 12


@pytest.mark.parametrize(("plane_mm", "wanted_mm"), [(None, 500.0), (420.0, 420.0)])
def test_a_step_works_with_the_rig_files_distance_or_the_callers_and_his_minutes(
    bench: Bench, plane_mm: float | None, wanted_mm: float
) -> None:
    seen: list[tuple[float, float]] = []

    def looking(step: GuideStep, at: Workplace) -> Mapping[str, StepOutcome]:
        seen.append((at.plane_mm, at.minutes))
        return good(step, at)

    bench.walk(looking, plane_mm=plane_mm, minutes=3.0, only=("board",))
    assert seen == [(wanted_mm, 3.0)]
    assert GuideOptions().minutes == 10.0


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


# ------------------------------------------------------------------------------------------- folder


def record(name: str, **pictures: str) -> GuideState:
    outcome = StepOutcome((GOOD,), {}, {file: (caption, PNG) for file, caption in pictures.items()})
    return GuideState().with_step(name, StepRecord.of(outcome, "", 1.0, {}))


def test_a_folder_that_is_new_has_an_empty_state_and_the_page_shows_the_pictures(tmp_path: Path) -> None:
    place = GuideFolder(tmp_path / "a" / "b")
    place.prepare()
    assert place.read() == GuideState()
    assert place.keep(StepOutcome((GOOD,), {}, {"dark.png": ("Dark", PNG)})) == [place.folder / "dark.png"]
    state = record("cameras", **{"dark.png": "Dark", "gone.png": "Taken away"})
    written = place.write(state, RIG_FILE.read_text(encoding="utf-8"))
    assert [path.name for path in written] == ["bringup.json", "bringup.html"]
    assert place.read() == state
    assert (place.folder / "bringup.html").read_text(encoding="utf-8").count("data:image/png") == 1
    assert place._pictures(state) == {"dark.png": PNG}


def test_a_pictures_name_leads_nowhere_else(tmp_path: Path) -> None:
    (tmp_path / "secret.png").write_bytes(PNG)
    place = GuideFolder(tmp_path / "out")
    place.prepare()
    assert place._pictures(record("cameras", **{"../secret.png": "?", str(tmp_path / "secret.png"): "?"})) == {}


@pytest.mark.parametrize("over_bytes", [0, 1])
def test_a_state_of_more_than_16_mb_is_none(tmp_path: Path, over_bytes: int) -> None:
    place = GuideFolder(tmp_path)
    data = json.dumps(json.loads(GuideState().as_bytes())).encode()
    (tmp_path / STATE).write_bytes(data.ljust(16_000_000 + over_bytes))
    if over_bytes:
        with pytest.raises(
            BringupError, match=r"bringup\.json: is no state of a bring-up \(16000001 bytes\); move it away"
        ):
            place.read()
    else:
        assert place.read() == GuideState()
    assert folders.MOST_BYTES == 16_000_000


def test_a_checksum_is_sha_256_of_the_text() -> None:
    assert checksum("µ\n") == "31edfb4669cf541ed79a81f47ec93fdafce1dd0fb8a03d429f3775db20f75288"


# ---------------------------------------------------------------------------------------- whole call


def test_a_call_holds_the_instrument_and_tells_what_is_on_its_buses(tmp_path: Path) -> None:
    rig_file = tmp_path / "rig.toml"
    text = RIG_FILE.read_text(encoding="utf-8").replace("/var/tmp/kingfisher-sim", str(tmp_path / "root"))
    rig_file.write_text(text.replace("[rig.wires_options]", '[rig.wires_options]\nfaults = ["keypad off"]', 1))
    told: list[tuple[str, bool]] = []
    walked = guide.walk(
        rig_file, tmp_path / "out", GuideOptions(only=("pad",)), AskedPerson(), Told(),
        lambda name, one: told.append((name, holder(tmp_path / "root") is not None and one.good)),
    )  # fmt: skip
    assert holder(tmp_path / "root") is None
    assert (walked.good, walked.done, told) == (False, ("pad",), [("pad", False)])
    assert "no key pad 1209:4b46" in walked.steps["pad"].findings[0].said
    state = GuideFolder(tmp_path / "out").read()
    assert state.rig_file == str(rig_file)
    assert state.about["Versions"][0] == f"kingfisher {appliance.__version__}"
    assert state.about["Versions"][3] == "instrument Kingfisher, simulated, KF-SIM"
    assert len(state.about["Versions"]) == 4
    for title, said in (
        ("Cameras on the buses", "KF-CAM-L"),
        ("HID devices", ""),
        ("Serial ports", ""),
        ("Video", "HDMI"),
    ):
        assert said in "".join(state.about[title]), title
