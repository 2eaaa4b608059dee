"""Options of the world that make no sense are refused, each with its name and with what is allowed."""

from __future__ import annotations

from typing import Any

import pytest

from hw_sim.options import OptionError, WorldOptions, options_from


def ace(**options: Any) -> dict[str, Any]:
    return {"cameras": {"left": {"personality": "ace", **options}}}


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"sede": 3}, "did you mean 'seed'"),
        ({"pace": "warp"}, "lockstep, realtime"),
        ({"width_px": 10}, "10x1200"),
        ({"idle_speed": 0.0}, "idle_speed 0"),
        ({"object": "whale"}, "'whale'; allowed are"),
        ({"medium": "oil"}, "'oil'; allowed are water, air"),
        ({"medium": "air", "water": {"salinity_psu": 35.0}}, "leave it out"),
        ({"water": {"attenuation_per_m": -1.0}}, "attenuation_per_m = -1.0"),
        ({"imaging": {"response": "cubic"}}, "measured, linear, gamma"),
        ({"motion": {"velocity_mm_s": [1.0, 2.0]}}, "three finite numbers"),
        ({"motion": {"tremor_hz": 0.0}}, "tremor_hz = 0.0"),
        ({"fog": {"left": 1.5}}, "left = 1.5"),
        ({"daylight": {"flicker_depth": 1.5}}, "flicker_depth = 1.5"),
        ({"daylight": {"torch_direction": [0.0, 0.0, 0.0]}}, "torch_direction"),
        ({"drift": {"particles_per_l": -1.0}}, "0..2000"),
        ({"drift": {"fish": 1.5}}, "fish = 1.5"),
        ({"drift": {"up": [0.0, 0.0, 0.0]}}, "vectors other than zero"),
        ({"projector": "vidio"}, "ideal, video, pattern, repeats"),
        ({"projector": 7}, "projector = 7"),
        ({"projector": {"kind": "video", "latency_blanks": 4}}, "whole numbers 0..3"),
        ({"projector": {"kind": "pattern", "order": "RG"}}, "3 of the letters RGB"),
        ({"projector": {"kind": "repeats", "order": "GB"}}, "2 of the letters G"),
        ({"projector": {"gamma": 0.4}}, "numbers 1..3"),
        ({"projector": {"scaled": [912]}}, "240..4096"),
        ({"projector": {"mirrored": 1}}, "true and false"),
        ({"projector": {"colour_weights": [1, 2, 3]}}, "three numbers 0..1"),
        ({"projector": "video", "imaging": {"response": "linear"}}, "both define"),
        ({"outside": {"sed": 3}}, "did you mean 'seed'"),
        ({"outside": {"seed": 3, "families": ["clock"]}}, "'clock'; allowed are"),
        ({"outside": {"families": ["clocks"]}}, "without a seed"),
        ({"outside": {"seed": -1}}, "whole numbers from 0"),
        ({"outside": {"clocks": {"walk": 1.0}}}, "unknown 'walk'"),
        ({"outside": {"clocks": {"walk_us": -1.0}}}, "0..1000"),
        ({"cameras": {"left": {"personality": "leica"}}}, "usual, blackfly, ace, alvium"),
        ({"cameras": {"left": {"saved": {"Gamma": 1.0}}}}, "name one"),
        ({"cameras": {"left": {"memory_blocks": 0}}}, "1..1000"),
        ({"cameras": {"left": {"largest_transfer_bytes": 100}}}, "4096 and more"),
        (ace(saved={"TriggerOverlap": "Off"}), "'TriggerOverlap'"),
        (ace(saved={"ReversX": True}), "did you mean 'ReverseX'"),
        (ace(saved={"TriggerMode": "Sometimes"}), "Off, On"),
        (ace(saved={"TriggerMode[FrameEnd]": "On"}), "FrameBurstStart, FrameStart"),
        (ace(saved={"Gamma": 9.0}), "0.25..4"),
        (ace(saved={"ReverseX": 1}), "true and false"),
        (ace(saved={"OffsetX": 2}), "steps of 4 from 0"),
        (ace(exposure_auto="Continuous"), "exposure_auto is for the usual camera"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(options: dict[str, Any], named: str) -> None:
    with pytest.raises(OptionError) as caught:
        options_from(options).scene()
    assert named in str(caught.value)


def test_what_fits_makes_its_world() -> None:
    assert options_from({"projector": {"kind": "ideal"}}).beamer().usual
    assert not options_from({"projector": {"mirrored": True}, "imaging": {"response": "linear"}}).beamer().usual
    assert WorldOptions(object="board", medium="air").scene().water.attenuation_per_m == 0.0
