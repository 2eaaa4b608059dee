"""A wrong rig file is refused in one line that says which key, which value, what is allowed and what to do."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from appliance.measure.light.volume import STANDARD
from appliance.store.config import ConfigError, default_rig_path, load_rig, parse_rig, rig_text
from appliance.store.instrument import Instrument

PACKAGED = default_rig_path().read_text(encoding="utf-8")


def changed(old: str, new: str) -> str:
    assert old in PACKAGED, old
    return PACKAGED.replace(old, new, 1)


def refusal(text: str) -> ConfigError:
    with pytest.raises(ConfigError) as caught:
        parse_rig(text, "rig.toml")
    return caught.value


def test_the_packaged_rig_is_the_instrument_of_the_paper() -> None:
    rig = load_rig()
    assert (rig.camera.left.width_px, rig.camera.left.height_px) == (1600, 1200)
    assert (rig.projector.width_px, rig.projector.height_px) == (1024, 768)
    assert rig.scan.period_px == 16
    assert rig.storage.root == Path("/var/lib/kingfisher")


@pytest.mark.parametrize(
    ("old", "new", "key", "words"),
    [
        ("exposure_ms = 12.0", "exposure_ms = 25", "camera.left.exposure_ms", "25 > 16.6; allowed: 0.05..16.6 ms; correct it in rig.toml"),
        ("[scan]", "[scan]\nzzzz = 1", "scan.zzzz", "known are: period_px, shortest_exposure_ms"),
        ("exposure_ms = 12.0", "exposure_m = 12.0", "camera.left.exposure_m", "did you mean camera.left.exposure_ms?"),
        ("[scan]", "[scam]", "scam", "did you mean scan?"),
        ('name = "Kingfisher"', 'name = "K"\nexposure_ms = 3', "rig.exposure_ms", "camera.left.exposure_ms"),
        ("gain_db = 0.0", "gain_db = true", "camera.left.gain_db", "0..48 dB"),
        ("gain_db = 0.0", "gain_db = nan", "camera.left.gain_db", "finite"),
        ("gain_db = 0.0", 'gain_db = "0.0"', "camera.left.gain_db", '"0.0"'),
        ("gain_db = 0.0\n", "", "camera.left.gain_db", "missing"),
        ("width_px = 1600", "width_px = 1600.5", "camera.left.width_px", "64..8192 px"),
        ("period_px = 16 ", "period_px = 24 ", "scan.period_px", "16, 32 or 64"),
        ('language = "en"', 'language = "fr"', "display.language", "'en' or 'de'"),
        ('"drivers.native:open"', '"drivers.native"', "rig.wires", "package.module:function"),
        ('root = "/var/lib/kingfisher"', 'root = ""', "storage.root", "path"),
        ('"KF-CAM-R"', '"KF-CAM-L"', "camera.right.serial", "same as camera.left.serial"),
        # Whatever opens the devices is called with what else the file says: one from elsewhere could run anything.
        *(("drivers.native:open", wires, "rig.wires", f'rig.wires "{wires}" not registered; allowed: drivers.native:open, hw_sim.wires:open')
          for wires in ("subprocess:Popen", "os:system", "appliance.cli:main", "drivers.native:NativeWires")),
    ],
)  # fmt: skip
def test_each_wrong_value_names_its_key_and_what_is_allowed(old: str, new: str, key: str, words: str) -> None:
    error = refusal(changed(old, new))
    assert error.key == key
    assert words in str(error)
    assert "\n" not in str(error)


def test_the_diver_reads_the_language_of_the_rig_file_and_english_without_one() -> None:
    assert parse_rig(changed('language = "en"', 'language = "de"')).display.language == "de"
    line = next(line for line in PACKAGED.splitlines(keepends=True) if line.startswith("language"))
    assert parse_rig(changed(line, "")).display.language == "en"


def test_every_fault_of_a_rig_file_is_listed_not_counted() -> None:
    """Whoever writes a rig file mends all of it in one go, not one key a try."""
    everything = str(refusal(""))
    tables = ("rig", "camera", "projector", "display", "board", "keys", "scan", "storage", "water", "design")
    assert sum(f"{table} missing" in everything for table in tables) >= 8
    assert "more)" not in everything
    three = PACKAGED.replace("gain_db = 0.0", "gain_db = 99", 2).replace("period_px = 16 ", "period_px = 24 ")
    rules = changed("case_warm_c = 50.0", "case_warm_c = 61.0").replace('"KF-CAM-R"', '"KF-CAM-L"')
    for text, words in (
        (three, ("camera.left.gain_db 99 > 48", "camera.right.gain_db 99 > 48 (allowed: 0..48 dB)", "scan.period_px 24 (allowed: 16, 32 or 64)")),
        (rules, ("camera.right.serial", "limits.case_warm_c 61 >= 60 (allowed: below case_hot_c)")),
    ):  # fmt: skip
        said = str(refusal(text))
        assert all(one in said for one in words)
        assert "\n" not in said
    many = str(refusal(PACKAGED + "".join(f"key_{n} = {n}\n" for n in range(300))))
    assert (len(many) < 10_000, "and 199 more" in many) == (True, True)


def test_a_volume_that_the_cameras_do_not_look_into_is_refused() -> None:
    """A rig file of another housing that does not state its volume would draw, search and judge as the standard one."""
    said = str(refusal(changed("baseline_mm = 230.0", "baseline_mm = 120.0")))
    assert "volume.working_mm 500 does not fit [design], whose cameras' axes cross at 273 mm" in said
    assert "correct [volume] for this housing" in said
    assert refusal(changed("working_mm = 500.0", "working_mm = 570.0")).key == "volume.working_mm"


def test_a_rig_file_without_a_volume_is_of_the_standard_housing() -> None:
    without = "".join(
        part for part in PACKAGED.splitlines(keepends=True)
        if not part.startswith(("[volume]", "nearest_mm", "working_mm", "farthest_mm"))
    )  # fmt: skip
    assert Instrument(parse_rig(without)).volume == STANDARD == Instrument(parse_rig(PACKAGED)).volume
    assert parse_rig(without).optical_hash == parse_rig(PACKAGED).optical_hash


def test_a_hash_knows_values_and_not_their_spelling_and_the_optical_one_only_those_of_a_calibration() -> None:
    rig = parse_rig(PACKAGED)
    assert len(rig.rig_hash) == 64
    respelled = changed("exposure_ms = 12.0", "exposure_ms = 12 # comment").replace("0x1209", "4617")
    for text, same, optically in (
        (respelled, True, True), (changed("exposure_ms = 12.0", "exposure_ms = 12.5"), False, True),
        (changed('"KF-CAM-R"', '"KF-CAM-X"'), False, False), (changed("width_px = 1600", "width_px = 800"), False, False),
    ):  # fmt: skip
        other = parse_rig(text)
        assert (other.rig_hash == rig.rig_hash, other.optical_hash == rig.optical_hash) == (same, optically)


FEATURES = """
trigger_source = "Line3"
pixel_format = "Mono12p"
offset_x_px = 16
[camera.left.features]
TriggerOverlap = "ReadOut"
BlackLevelSelector = "All"
BlackLevel = 1.0
"?GammaEnable" = false
[camera.right]
"""


def test_what_a_makers_cameras_need_keeps_its_order_and_its_kinds_also_when_it_is_written_down() -> None:
    rig = parse_rig(changed("[camera.right]\n", FEATURES))
    for one in (rig, parse_rig(rig_text(rig))):
        left = one.camera.left
        said = left.trigger_source, left.pixel_format, left.offset_x_px, left.offset_y_px
        assert said == ("Line3", "Mono12p", 16, None)
        assert list(left.features.items()) == [
            ("TriggerOverlap", "ReadOut"), ("BlackLevelSelector", "All"), ("BlackLevel", 1.0), ("?GammaEnable", False),
        ]  # fmt: skip
        assert isinstance(left.features["?GammaEnable"], bool)
        assert one.rig_hash == rig.rig_hash
    plain = parse_rig(changed("[camera.right]\n", FEATURES.replace("offset_x_px = 16", "")))
    assert plain.optical_hash == parse_rig(default_rig_path().read_text(encoding="utf-8")).optical_hash
    assert rig.optical_hash != plain.optical_hash, "another part of the lens's picture"
    words = str(refusal(changed("[camera.right]\n", FEATURES.replace("Mono12p", "Mono16"))))
    assert "camera.left.pixel_format" in words
    assert "Mono12Packed" in words


def test_a_missing_file_names_the_path_and_whatever_one_holds_is_one_config_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere\.toml.*--rig"):
        load_rig(tmp_path / "nowhere.toml")
    for raw in (b"\xff\xfe", b"", b"x = " + b"[" * 3000, b"x = " + b"9" * 6000, b"\x00"):
        (tmp_path / "rig.toml").write_bytes(raw)
        with pytest.raises(ConfigError):
            load_rig(tmp_path / "rig.toml")


RIG_FILES = (default_rig_path(), *sorted((Path(__file__).parents[4] / "hw_sim" / "rigs").glob("*.toml")))


@pytest.mark.parametrize("path", RIG_FILES, ids=[path.stem for path in RIG_FILES])
def test_a_rig_that_is_written_down_loads_as_the_same_rig(path: Path) -> None:
    rig = load_rig(path)
    again = parse_rig(rig_text(rig))
    assert again == rig
    assert again.rig_hash == rig.rig_hash


def test_what_options_changed_is_written_down_too_whatever_characters_are_in_it() -> None:
    options = {
        "width_px": 80, "noise": False, "faults": ["camera.left off", 'a "quoted" \\ one\n\x7f\x01'], "water": {"index": 1.34},
        "a key with blanks and ü": [1, 2.5e-07, [True, {"x": -1.0, "y z": "ω"}]], "nothing": {}, "big": 2**53,
    }  # fmt: skip
    rig = load_rig(RIG_FILES[1])
    named = replace(rig.rig, name="Eisvogel “3” 𝔘", wires_options=options)
    camera = replace(rig.camera, left=replace(rig.camera.left, width_px=80, height_px=64))
    rig = replace(rig, rig=named, camera=camera, storage=replace(rig.storage, root=Path("/a/with \\ and 'quotes'")))
    again = parse_rig(rig_text(rig))
    assert again == rig
    assert again.rig_hash == rig.rig_hash


def test_a_default_is_written_down_as_the_number_it_was() -> None:
    """A later version may have another default; a scan that was taken with this one keeps it."""
    path = RIG_FILES[-1]
    assert "full_well_e" not in path.read_text(encoding="utf-8")
    assert tomllib.loads(rig_text(load_rig(path)))["camera"]["left"]["full_well_e"] == 13_000.0
