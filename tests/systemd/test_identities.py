"""The device rules are those of the rig file: other identities are looked for, and an unreadable file changes nothing."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from kingfisher_setup import identities, main, placed, versions
from kingfisher_setup.errors import SetupError
from kingfisher_setup.layout import Layout
from tests.systemd.installation import Installation

ROOT = Path(__file__).parents[2]
SHIPPED = (ROOT / "systemd" / "70-kingfisher.rules").read_text()
RIG = (ROOT / "appliance" / "rigs" / "kingfisher.toml").read_text()
RULES = "etc/udev/rules.d/70-kingfisher.rules"


def looked_for(rules: str) -> dict[str, set[str]]:
    """Return which ``vendor:product`` each kind of line matches, read as udev does: by key, not by place."""
    found: dict[str, set[str]] = {}
    for line in rules.splitlines():
        match = dict(re.findall(r'ATTRS?\{(idVendor|idProduct)\}=="([^"]*)"', line))
        if match and not line.startswith("#"):
            subsystem = re.findall(r'SUBSYSTEM=="(\w+)"', line)[0]
            found.setdefault(subsystem, set()).add(f"{match['idVendor']}:{match['idProduct']}")
    return found


@pytest.fixture
def layout(tmp_path: Path) -> Layout:
    layout = Layout(tmp_path)
    installation = Installation(layout)
    installation.add("1.0", "one")
    (layout.version("1.0") / "systemd" / "70-kingfisher.rules").write_text(SHIPPED)
    layout.rig.parent.mkdir(parents=True)
    layout.rig.write_text(RIG)
    return layout


def test_with_the_packaged_rig_file_the_rules_are_the_shipped_ones(layout: Layout) -> None:
    versions.switch(layout, "1.0")
    assert layout.at(RULES).read_text() == SHIPPED
    assert looked_for(SHIPPED) == {"usb": {"1209:4b42", "1209:4b46"}, "tty": {"1209:4b42"}, "hidraw": {"1209:4b46"}}


def test_an_installation_looks_for_what_the_rig_file_names(layout: Layout) -> None:
    # The board gets the number that was the pad's: neither may end up as the other.
    changed = RIG.replace("product_id = 0x4B46", "product_id = 0x0007").replace(
        "product_id = 0x4B42", "product_id = 0x4B46"
    )
    layout.rig.write_text(changed.replace("vendor_id = 0x1209 ", "vendor_id = 0xCAFE "))
    versions.switch(layout, "1.0")
    found = looked_for(layout.at(RULES).read_text())
    assert found == {"usb": {"cafe:4b46", "cafe:0007"}, "tty": {"cafe:4b46"}, "hidraw": {"cafe:0007"}}
    assert re.sub('=="[0-9a-f]{4}"', "", layout.at(RULES).read_text()) == re.sub('=="[0-9a-f]{4}"', "", SHIPPED)


def test_on_demand_they_follow_a_changed_rig_file(layout: Layout, capsys: pytest.CaptureFixture[str]) -> None:
    versions.switch(layout, "1.0")
    layout.rig.write_text(RIG.replace("0x4B42", "0x0042"))
    main.rules(layout)
    assert looked_for(layout.at(RULES).read_text())["tty"] == {"1209:0042"}
    assert "board 1209:0042, keys 1209:4b46: the rules name them now" in capsys.readouterr().out
    main.rules(layout)
    assert "named them already" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("rig", "said"),
    [
        (RIG.replace("0x4B42", "0x14B42"), "board.product_id 84802; allowed: 0..0xffff"),
        (RIG.replace("product_id = 0x4B46", "product_id = true"), "keys.product_id True"),
        (RIG.replace("[keys]", "[pad]"), r"there is no table \[keys\]"),
        ("[board\n", "correct the rig file"),
    ],
)
def test_a_wrong_rig_file_is_refused_on_demand_and_never_stops_a_change_of_versions(
    layout: Layout, rig: str, said: str
) -> None:
    layout.rig.write_text(rig)
    with pytest.raises(SetupError, match=said):
        identities.named(layout.rig)
    placed.place(layout, "1.0")
    assert layout.at(RULES).read_text() == SHIPPED


def test_without_an_installation_there_is_nothing_to_make_them_from(tmp_path: Path) -> None:
    with pytest.raises(SetupError, match="nothing is installed"):
        main.rules(Layout(tmp_path))


def test_the_rig_files_defaults_are_the_shipped_rules() -> None:
    from appliance.config import default_rig_path, load_rig, parse_rig

    rig = load_rig(default_rig_path())
    written = {table: (part.vendor_id, part.product_id) for table, part in (("board", rig.board), ("keys", rig.keys))}
    assert written == dict(identities.SHIPPED)
    without = re.sub(r"(?m)^(vendor|product)_id = 0x4?(1209|B42).*\n", "", RIG.partition("[keys]")[0])
    assert parse_rig(without + "[keys]" + RIG.partition("[keys]")[2]).board == rig.board
