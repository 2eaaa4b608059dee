"""Which connector, mode and CRTC is taken, and what is said when there is none."""

from __future__ import annotations

import pytest

from drivers.api import DeviceGone, DeviceRefused
from drivers.output.card import Connector
from drivers.output.choice import assign_crtcs, choose_connector, choose_mode
from drivers.output.drm import Mode
from drivers.output.spec import OutputKind, OutputSpec

SPEC = OutputSpec(OutputKind.KMS, "/dev/dri/card0", "HDMI-A-1", 1024, 768, 60.0)


def mode(width: int, height: int, hz: float, preferred: bool = False, progressive: bool = True) -> Mode:
    return Mode(width, height, hz, preferred, progressive, bytes(68))


def connector(name: str, *modes: Mode, connected: bool = True) -> Connector:
    return Connector(1, name, connected, modes, (), {})


@pytest.mark.parametrize(
    ("modes", "chosen"),
    [
        ([mode(1024, 768, 59.5, preferred=True), mode(1024, 768, 60.004), mode(1920, 1080, 60.0)], 1),
        ([mode(1024, 768, 59.5), mode(1024, 768, 60.5, preferred=True), mode(1024, 768, 60.5)], 1),
        ([mode(1024, 768, 59.0)], 0),
        ([mode(1024, 768, 58.99)], None),
        ([mode(1024, 768, 61.0)], 0),
        ([mode(1024, 768, 61.01)], None),
        ([mode(1024, 600, 60.0), mode(1280, 768, 60.0)], None),
        ([mode(1024, 768, 60.0, progressive=False)], None),
    ],
    ids=["nearest", "preferred of those as near", "59", "below", "61", "above", "half of the size", "interlaced"],
)
def test_a_mode_of_that_size_within_one_hertz_is_chosen(modes: list[Mode], chosen: int | None) -> None:
    plugged = connector("HDMI-A-1", *modes)
    if chosen is not None:
        assert choose_mode("projector", SPEC, plugged) is modes[chosen]
        return
    with pytest.raises(DeviceRefused, match="1024×768 at 60 Hz") as refused:
        choose_mode("projector", SPEC, plugged)
    assert ", ".join(map(str, modes)) in refused.value.message


def test_the_connector_of_that_name_is_taken_empty_or_not_and_gone_where_nothing_is_plugged_in() -> None:
    offered = [connector("DP-1"), connector("HDMI-A-1", connected=False)]
    assert choose_connector("projector", SPEC, offered) is offered[1]
    with pytest.raises(DeviceGone, match="HDMI-A-1"):
        choose_mode("projector", SPEC, offered[1])
    for others, said in (
        ([], "none"),
        ([connector("DP-1"), connector("VGA-1", connected=False)], r"DP-1 .*, VGA-1 \(empty\)"),
    ):
        with pytest.raises(DeviceRefused, match=rf"HDMI-A-1 is not on /dev/dri/card0; it has {said}"):
            choose_connector("projector", SPEC, others)


@pytest.mark.parametrize(
    ("possible", "assigned"),
    [
        ([(1, 2), (1, 2)], (1, 2)),
        ([(1, 2), (1,)], (2, 1)),  # the greedy choice would leave the second head dark
        ([(1, 2, 3), (1,), (1, 2)], (3, 1, 2)),
        ([(1,), (1,)], None),
        ([()], None),
    ],
)
def test_two_heads_never_share_a_crtc(possible: list[tuple[int, ...]], assigned: tuple[int, ...] | None) -> None:
    assert assign_crtcs(possible) == assigned
