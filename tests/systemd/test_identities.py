"""The device rules are those of the rig file: other identities are looked for, and an unreadable file changes nothing."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from appliance.store.config import default_rig_path, load_rig
from kingfisher_setup import identities, main, placed, versions
from kingfisher_setup.errors import SetupError
from kingfisher_setup.layout import Layout
from tests.systemd.installation import Installation

ROOT = Path(__file__).parents[2]
SHIPPED = (ROOT / "systemd" / "70-kingfisher.rules").read_text()
RIG = default_rig_path().read_text()
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
    Installation(layout).add("1.0", "one")
    (layout.version("1.0") / "systemd" / "70-kingfisher.rules").write_text(SHIPPED)
    layout.rig.parent.mkdir(parents=True)
    layout.rig.write_text(RIG)
    return layout


def test_with_the_packaged_rig_file_the_rules_are_the_shipped_ones(layout: Layout) -> None:
    versions.switch(layout, "1.0")
    assert layout.at(RULES).read_text() == SHIPPED
    assert looked_for(SHIPPED) == {"usb": {"1209:4b42", "1209:4b46"}, "tty": {"1209:4b42"}, "hidraw": {"1209:4b46"}}
    rig = load_rig()
    written = {table: (part.vendor_id, part.product_id) for table, part in (("board", rig.board), ("keys", rig.keys))}
    assert written == dict(identities.SHIPPED)


def test_an_installation_looks_for_what_the_rig_file_names(layout: Layout, capsys: pytest.CaptureFixture[str]) -> None:
    # The board gets the number that was the pad's: neither may end up as the other.
    changed = RIG.replace("product_id = 0x4B46", "product_id = 0x0007").replace("0x4B42", "0x4B46")
    layout.rig.write_text(changed.replace("vendor_id = 0x1209 ", "vendor_id = 0xCAFE "))
    versions.switch(layout, "1.0")
    rules = layout.at(RULES).read_text()
    assert looked_for(rules) == {"usb": {"cafe:4b46", "cafe:0007"}, "tty": {"cafe:4b46"}, "hidraw": {"cafe:0007"}}
    assert re.sub('=="[0-9a-f]{4}"', "", rules) == re.sub('=="[0-9a-f]{4}"', "", SHIPPED)
    layout.rig.write_text(RIG.replace("0x4B42", "0x0042"))
    for said in ("the rules name them now", "named them already"):  # on demand they follow a changed file
        main.rules(layout)
        assert looked_for(layout.at(RULES).read_text())["tty"] == {"1209:0042"}
        assert said in capsys.readouterr().out


@pytest.mark.parametrize(
    ("rig", "named"),
    [
        (RIG.replace("0x4B42", "0x14B42"), "board.product_id 84802"),
        (RIG.replace("product_id = 0x4B46", "product_id = true"), "keys.product_id True"),
        (RIG.replace("[keys]", "[pad]"), r"\[keys\]"),
        ("[board\n", "rig file"),
    ],
)
def test_a_wrong_rig_file_is_refused_on_demand_and_never_stops_a_change_of_versions(
    layout: Layout, rig: str, named: str
) -> None:
    layout.rig.write_text(rig)
    with pytest.raises(SetupError, match=named):
        identities.named(layout.rig)
    placed.place(layout, "1.0")
    assert layout.at(RULES).read_text() == SHIPPED


def test_without_an_installation_there_is_nothing_to_make_them_from(tmp_path: Path) -> None:
    with pytest.raises(SetupError, match="nothing is installed"):
        main.rules(Layout(tmp_path))
