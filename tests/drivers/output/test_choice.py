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


def test_the_nearest_refresh_rate_wins_over_the_preferred_mode() -> None:
    modes = (mode(1024, 768, 59.5, preferred=True), mode(1024, 768, 60.004), mode(1920, 1080, 60.0))
    assert choose_mode("projector", SPEC, connector("HDMI-A-1", *modes)) is modes[1]


@pytest.mark.parametrize(("hz", "fits"), [(58.99, False), (59.0, True), (61.0, True), (61.01, False)])
def test_a_rate_may_be_one_hertz_off_and_no_more(hz: float, fits: bool) -> None:
    plugged = connector("HDMI-A-1", mode(1024, 768, hz))
    if fits:
        assert choose_mode("projector", SPEC, plugged).refresh_hz == hz
        return
    with pytest.raises(DeviceRefused, match="no mode"):
        choose_mode("projector", SPEC, plugged)


def test_of_modes_as_near_the_preferred_one_wins() -> None:
    modes = (mode(1024, 768, 59.5), mode(1024, 768, 60.5, preferred=True), mode(1024, 768, 60.5))
    assert choose_mode("projector", SPEC, connector("HDMI-A-1", *modes)) is modes[1]


@pytest.mark.parametrize("size", [(1024, 600), (1280, 768)])
def test_a_size_that_is_half_right_is_wrong(size: tuple[int, int]) -> None:
    with pytest.raises(DeviceRefused, match="no mode"):
        choose_mode("projector", SPEC, connector("HDMI-A-1", mode(*size, 60.0)))


def test_the_connector_of_that_name_is_taken_empty_or_not() -> None:
    offered = [connector("DP-1"), connector("HDMI-A-1", connected=False)]
    assert choose_connector("projector", SPEC, offered) is offered[1]
    with pytest.raises(DeviceRefused, match="it has none"):
        choose_connector("projector", SPEC, [])


def test_a_mode_that_is_not_offered_lists_those_that_are() -> None:
    offers = (mode(1024, 768, 75.03), mode(1024, 768, 60.0, progressive=False), mode(800, 600, 60.32))
    with pytest.raises(DeviceRefused) as refused:
        choose_mode("projector", SPEC, connector("HDMI-A-1", *offers))
    assert "1024×768 at 60 Hz" in refused.value.message
    assert "1024×768 75.03 Hz, 1024×768 60.00 Hz interlaced, 800×600 60.32 Hz" in refused.value.message


def test_an_empty_connector_is_gone_not_refused() -> None:
    with pytest.raises(DeviceGone, match="nothing is plugged into HDMI-A-1"):
        choose_mode("projector", SPEC, connector("HDMI-A-1", connected=False))


def test_an_unknown_connector_lists_those_that_exist() -> None:
    others = [connector("DP-1"), connector("VGA-1", connected=False)]
    with pytest.raises(DeviceRefused, match=r"HDMI-A-1 is not on /dev/dri/card0; it has DP-1 .*, VGA-1 \(empty\)"):
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
