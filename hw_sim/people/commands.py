"""The commands of scripts and of the console: faults, repairs, and changes of the scene.

A value is written as ``name=amount`` words, a vector as ``x,y,z``; ``off`` stands for the value's defaults.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import cv2

from hw_sim.faults import parse
from hw_sim.light.daylight import Daylight
from hw_sim.mount_shift import parse as parse_knock
from hw_sim.objects.motion import Motion
from hw_sim.optics.beamer import Beamer
from hw_sim.optics.fog import Fog
from hw_sim.people import computer
from hw_sim.timing import calendar
from hw_sim.water.drift import Drift
from hw_sim.water.medium import Water

if TYPE_CHECKING:
    from hw_sim.world import World

Value = TypeVar("Value")

SURROUNDINGS = {"motion": Motion(), "water": Water(), "daylight": Daylight(), "drift": Drift(), "fog": Fog()}
"""Commands that change the scene's field of the same name, with its defaults."""
HELP: Mapping[str, tuple[str, str]] = {
    "fault": ("SENTENCE", "cause a fault: fault camera.left off, fault board wrong how=reset"),
    "mend": ("THING", "repair one fault only: mend laser.left off, mend projector wrong"),
    "clear": ("", "repair everything that is broken"),
    "cap": ("left|right|both on|off", "put a cap on a camera's lens, or take it off"),
    "projector": ("AMOUNTS", "change the projector's settings: projector mirrored=false gamma=off latency_blanks=1"),
    "worker": ("kill|hang", "kill or stop the process that computes points"),
    "power": ("cut", "end the service at once, as by a loss of power; start the simulator again afterwards"),
    "disk": (
        "off|on|fill|spare",
        "off: the scan folder refuses writes until on; fill: a small disk is filled; spare: it is freed",
    ),
    "date": (
        "1970-01-01T00:00:07|+S|-S|kept|lost",
        "the computer's clock: set it, shift it by seconds, keep it by a time server, or not",
    ),
    "object": (
        "NAME [X Y Z RX RY RZ]",
        "plane ballbar frustum pipe shell stones board; mm and degrees in the rig frame",
    ),
    "texture": ("NAME", "none slight strong checker"),
    "water": ("AMOUNTS | off", "water attenuation_per_m=2 backscatter=0.1"),
    "motion": ("AMOUNTS | off", "of the hands during a scan: motion velocity_mm_s=10,0,0 tremor_mm=0.1,0.1,0.1"),
    "daylight": ("AMOUNTS | off", "daylight flicker_depth=0.5 caustics=0.3 torch=0.5"),
    "drift": ("AMOUNTS | off", "drift particles_per_l=20 bubbles=5 fish=1"),
    "fog": ("AMOUNTS | off", "on a window: fog left=0.5 x=0.3 y=0.4 radius=0.12"),
    "knock": ("CAMERA AMOUNTS", "move a camera in its mount, permanently: knock right pitch_deg=0.03"),
    "screenshot": ("PATH", "write the display as a PNG"),
}
"""Verb → (arguments, help text)."""


class CommandError(Exception):
    """A command failed; the text has the reason."""


def check(verb: str, arguments: tuple[str, ...]) -> bool:
    """Return True if that is a command. Raises ValueError for one that can never be executed."""
    match verb, arguments:
        case "fault", (_, *_):
            parse(" ".join(arguments))
        case "mend", (_, _):
            pass
        case "cap", (("left" | "right" | "both"), ("on" | "off")):
            pass
        case "projector", (_, *_):
            adjusted(Beamer(), arguments)
        case (("worker" | "disk" | "power"), _):
            computer.check((verb, *arguments))
        case "date", (word,):
            calendar.check(word)
        case "object", (_, *pose) if len(pose) in (0, 6):
            [float(number) for number in pose]
        case "knock", (_, *_):
            parse_knock(" ".join(arguments))
        case _ if verb in SURROUNDINGS:
            changed(SURROUNDINGS[verb], verb, arguments)
        case (("screenshot" | "texture"), (_,)) | ("clear", ()):
            pass
        case _:
            return False
    return True


def do(world: World, verb: str, arguments: tuple[str, ...], status: Path) -> None:
    """Execute a command that ``check`` accepts. Raises CommandError, ValueError or OSError if it fails."""
    match verb:
        case "fault":
            world.fault(" ".join(arguments))
        case "mend":
            world.mend(*arguments)
        case "clear":
            world.clear_faults()
        case "cap":
            sides = {"left", "right"} if arguments[0] == "both" else {arguments[0]}
            capped = world.scene.capped
            world.set_caps(*(capped | sides if arguments[1] == "on" else capped - sides))
        case "projector":
            world.set_projector(adjusted(world.projector_truth.beamer, arguments))
        case "worker" | "disk" | "power":
            computer.happen((verb, *arguments), status)
        case "date":
            world.calendar.change(arguments[0])
        case "object":
            world.set_object(arguments[0], [float(n) for n in arguments[1:]] or None)
        case "texture":
            world.set_scene(replace(world.scene, texture=arguments[0]))
        case "knock":
            world.knock(parse_knock(" ".join(arguments)))
        case "screenshot":
            picture = world.scanned_out("display")
            # OpenCV writes blue first.
            if not cv2.imwrite(arguments[0], cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)):
                raise CommandError("the image cannot be written")
        case _:
            world.set_scene(replace(world.scene, **{verb: changed(getattr(world.scene, verb), verb, arguments)}))


def adjusted(beamer: Beamer, assignments: Sequence[str]) -> Beamer:
    """Return a projector changed by ``assignments`` like ``gamma=2.2``, with values as in a rig file.

    ``off`` is the usual projector. Raises ValueError.
    """
    usual = Beamer(beamer.kind)
    amounts: dict[str, Any] = {}
    for word in assignments:
        name, sign, text = word.partition("=")
        names = {field.name for field in fields(usual)}
        if not sign or name not in names:
            raise ValueError(
                f"projector: '{word}' is not understood; allowed are any of {', '.join(sorted(names))} = value, "
                "or = off"
            )
        try:
            value = getattr(usual, name) if text == "off" else tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            value = text
        amounts[name] = tuple(value) if isinstance(value, list) else value
    return replace(beamer, **amounts)


def changed(value: Value, subject: str, assignments: Sequence[str]) -> Value:
    """Return a frozen dataclass with the named amounts changed. Raises ValueError.

    ``subject`` is its name in the error.
    """
    if not is_dataclass(value) or isinstance(value, type):
        raise TypeError(f"{subject}: {value!r} has no amounts")
    if tuple(assignments) == ("off",):
        return type(value)()
    defaults = {f.name: getattr(value, f.name) for f in fields(value)}
    amounts: dict[str, Any] = {}
    for word in assignments:
        name, sign, text = word.partition("=")
        if name not in defaults or not sign:
            raise ValueError(
                f"{subject}: '{word}' is not understood; allowed are off, or any of {', '.join(defaults)} = amount"
            )
        amounts[name] = _amount(f"{subject} {name}", text, defaults[name])
    if not amounts:
        raise ValueError(f"{subject}: no amount; give off, or any of {', '.join(defaults)} = amount")
    return replace(value, **amounts)


def _amount(what: str, text: str, like: object) -> float | int | tuple[float, ...]:
    try:
        if isinstance(like, tuple):
            # The default's type determines the form of the amount.
            return tuple(float(part) for part in text.split(","))
        return int(text) if isinstance(like, int) else float(text)
    except ValueError:
        kind = {tuple: "numbers with commas between them", int: "a whole number"}.get(type(like), "a number")
        raise ValueError(f"{what} = '{text}'; give {kind}") from None
