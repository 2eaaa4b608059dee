"""A description says what it means, and each word that cannot be followed is refused with its name, its value and what would do."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from appliance.desk.foreign.description import AxisConvention, Description, parse_description, with_counts
from appliance.desk.foreign.images import natural_key
from appliance.desk.foreign.order import parse_order
from appliance.desk.foreign.problem import ForeignError

WHOLE = """
[images]
left = "left/*.png"
right = "right/*.png"
order = "bright dark gray-x*5 sine-x*4"
[projector]
width_px = 512
height_px = 384
[x]
period_px = 16
steps = 4
[cameras]
files = ["stereo.yml"]
"""


def parsed(*changes: tuple[str, str]) -> Description:
    text = WHOLE
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    return parse_description(text, Path(), "set", "set.toml")


def axis_of(*changes: tuple[str, str]) -> AxisConvention:
    axis = parsed(*changes).axis("x")
    assert axis is not None
    return axis


def test_an_order_is_what_it_spells_out() -> None:
    words = [one.word for one in parse_order("bright (gray-x ~gray-x)*2 sine-x*3 - sine-y2", "order")]
    assert words == ["bright", "gray-x", "~gray-x", "gray-x", "~gray-x", "sine-x", "sine-x", "sine-x", "-", "sine-y2"]
    numbers = [one.index for one in parse_order("(gray-x ~gray-x)*2 sine-x*3", "order")]
    assert numbers == [0, 0, 1, 1, 0, 1, 2]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("gray-x*6 wobble", "'wobble' is no image; allowed: bright, dark"),
        ("~sine-x", "'~sine-x' is no image"),
        ("bright bright", "names bright twice"),
        ("(gray-x", "an opening bracket has no closing one"),
        ("gray-x)", "a closing bracket has no opening one"),
        ("*3", "* needs a word before it and a count after it"),
        ("gray-x*0", "repeats 0 times"),
        ("sine-x0", "names period 0"),
        ("((gray-x*9)*9)*9", "*9 repeats 9 times; allowed are 1 and more, at most 400 images in all"),
        ("(gray-x*400)(gray-x*400)", "names 800 images; allowed are up to 400"),
        ("(" * 4000 + "gray-x" + ")" * 4000, "or too many words"),
        ("micro-x2", "'micro-x2' is no image"),
    ],
)
def test_an_order_that_cannot_be_read_says_where(text: str, said: str) -> None:
    with pytest.raises(ForeignError) as error:
        parse_order(text, "images.order")
    assert said in str(error.value)
    assert "images.order" in str(error.value)


def test_names_come_as_people_count() -> None:
    assert sorted(["a10", "a2", "B1", "a02b"], key=natural_key) == ["a2", "a02b", "a10", "B1"]


def test_conventions_in_one_word() -> None:
    plain = axis_of()
    assert (plain.period_px, plain.stripe_px, plain.sign) == (16.0, 16.0, 1)
    assert plain.steps_deg == ((0.0, 90.0, 180.0, 270.0),)
    assert axis_of(("steps = 4", 'steps = 4\ngray = "complementary"')).stripe_px == 8.0
    backwards = axis_of(("steps = 4", 'steps_deg = [0, 120, 240, 90]\nsign = "-"'))
    assert backwards.signed_deg == ((0.0, -120.0, -240.0, -90.0),)
    several = axis_of(("bright dark gray-x*5 sine-x*4", "sine-x*4 sine-x2*4"), ("period_px = 16", "fringes = [8, 9]"))
    assert several.periods_px[0] == 64.0
    assert several.periods_px[1] == pytest.approx(512 / 9)
    assert several.finest == 1


TWO = ("bright dark gray-x*5 sine-x*4", "gray-x*4 sine-x*4 sine-x2*4")


@pytest.mark.parametrize(
    ("changes", "wanted"),
    [
        ([TWO, ("period_px = 16", "period_px = [64, 16]\nstart_deg = [90, 30]")], {"begins_deg": (90.0, 30.0)}),
        ([TWO, ("period_px = 16", 'period_px = [64, 16]\nstart_at = "middle"')], {"begins_deg": (-2.8125, -11.25)}),
        ([TWO, ("period_px = 16", "period_px = [64, 16]\nstripe_px = 32")], {"numbered": 0, "stripe_px": 32.0}),
        ([TWO, ("period_px = 16", "period_px = [64, 16]")], {"numbered": 1, "stripe_px": 16.0}),
        ([("steps = 4", 'steps = 4\ngray = "shifted"')], {"code_offset_px": -8.0, "stripe_px": 16.0, "wraps": True}),
        ([("bright dark gray-x*5 sine-x*4", "gray-x*5 sine-x*12 sine-x2*3"), ("period_px = 16", "period_px = [64, 16]"), ("steps = 4", "steps = [12, 3]\nsign = '-'")],
         {"steps_deg": (tuple(30.0 * k for k in range(12)), (0.0, 120.0, 240.0))}),
        ([("bright dark gray-x*5 sine-x*4", "micro-x*6"), ("period_px = 16", "period_px = [16, 15, 14, 13]"), ("steps = 4", "steps = 3")],
         {"steps_deg": ((0.0, 120.0, 240.0), (0.0,), (0.0,), (0.0,)), "micro": True}),
        ([("bright dark gray-x*5 sine-x*4", "modulated-x*12 sine-x2*4"), ("period_px = 16", "fringes = [24, 1]")],
         {"carriers": (3, 0), "micro": False}),
    ],
)  # fmt: skip
def test_rarer_codes_have_a_word_each(changes: list[tuple[str, str]], wanted: dict[str, object]) -> None:
    description = parsed(*changes)
    axis = with_counts(description, description.order or ()).axes[0]
    assert {name: getattr(axis, name) for name in wanted} == wanted


@pytest.mark.parametrize(
    ("order", "said"),
    [("modulated-x*9 sine-x2*4", "9 images are modulated-x, and 12 are needed"),
     ("modulated-x*8 sine-x2*4", "8 images are modulated-x, and 12 are needed"),
     ("micro-x*6", "6 images are micro-x, and 5 are needed")],
)  # fmt: skip
def test_codes_with_too_few_images_say_how_many(order: str, said: str) -> None:
    description = parsed(("bright dark gray-x*5 sine-x*4", order), ("period_px = 16", "fringes = [24, 1]"))
    with pytest.raises(ForeignError, match=said):
        with_counts(description, description.order or ())


def test_of_two_cameras_the_pattern_is_what_the_code_covers() -> None:
    both = parsed()
    alone = parsed(('right = "right/*.png"\n', ""))
    extents = [one.extent_px(with_counts(one, one.order or ()).axes[0]) for one in (both, alone)]
    assert extents == [(0.0, 512.0), (0.0, 512.0)]
    both, alone = (replace(one, axes=(replace(one.axes[0], size_px=100.0, bits=5),)) for one in (both, alone))
    assert [both.extent_px(both.axes[0]), alone.extent_px(alone.axes[0])] == [(0.0, 512.0), (0.0, 100.0)]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("steps = 4", "steps = 2"), "x.steps is 2; allowed: a whole number 3..16"),
        (("steps = 4", 'steps = "4"'), "x.steps is '4'; allowed: a whole number 3..16; write one of these"),
        (("steps = 4", "steps = 4\nsteps_deg = [0, 1, 2]"), "are both given"),
        (("steps = 4", "steps_deg = [0, 90]"), "x.steps_deg is [0, 90]; allowed: 3 to 16 steps"),
        (("steps = 4", 'steps = 4\nsign = "minus"'), "x.sign is 'minus'; allowed: +, -"),
        (("steps = 4", "steps = 4\ngray = [1]"), "x.gray is [1]; allowed: ordinary, complementary, shifted"),
        (("steps = 4", "steps = 4\nstripe_px = 32"), "x.stripe_px is 32; allowed: up to the coarsest period, 16 px"),
        (("steps = 4", "step = 4"), "x.step: unknown key; did you mean steps?"),
        (("period_px = 16", ""), "x.period_px or x.fringes"),
        (("period_px = 16", "period_px = nan"), "x.period_px is nan; allowed: a number"),
        (("period_px = 16", "period_px = 65537"), "x.period_px is 65537; allowed: a number 2..65536"),
        (("period_px = 16", f"period_px = {[*range(2, 19)]}"), "allowed: up to 16 periods; leave some out"),
        (("period_px = 16", "period_px = [16, 8, 16]"), "x.period_px is [16, 8, 16]; allowed: different periods"),
        (("[x]", "[y]"), "[x] is missing, but the images include gray-x"),
        (("[cameras]", "[y]\nperiod_px = 4\nsteps = 3\n[cameras]"), "[y] is given, but no image of y"),
        (("gray-x*5 ", ""), "the fringe order is unknown"),
        (("sine-x*4", "sine-x*4 sine-x2*4"), "x has 1 periods, and its images are of 2"),
        (("[projector]", "[screen]"), "screen: unknown key"),
        (("width_px = 512", 'width_px = "512"'), "projector.width_px is '512'; allowed: a whole number"),
        (('left = "left/*.png"', "left = 3"), "images.left is 3; allowed: a name, also with wildcards"),
        (('order = "', 'channel = "cyan"\norder = "'), "images.channel is 'cyan'; allowed: grey, red, green, blue"),
        (("[cameras]", "[range]\nnear_mm = 500\nfar_mm = 400\n[cameras]"), "range.near_mm is 500; allowed: less than far_mm = 400"),
        (("[cameras]", "[water]\n[cameras]"), "water.index or water.temperature_c: give one of them"),
        (("[cameras]", "[ports]\ndistance_mm = 30\nthickness_mm = 5\n[cameras]"), "ports.glass_index is missing"),
        (("[images]", "[images"), "correct that line (TOML 1.0)"),
        (('left = "left/*.png"\nright', 'both = "*.png"\nsides = "left*2 up*2"\n# right'), "images.sides is 'left*2 up*2'"),
        (('left = "left/*.png"', 'both = "*.png"'), "give names for both together, or for each"),
        (('left = "left/*.png"', 'left.bright = "a.png"'), "images.left and images.right name different kinds of images"),
    ],
)  # fmt: skip
def test_a_word_that_cannot_be_followed_is_named(change: tuple[str, str], said: str) -> None:
    with pytest.raises(ForeignError) as error:
        parsed(change)
    assert str(error.value).startswith("set.toml: ")
    assert said in str(error.value)
