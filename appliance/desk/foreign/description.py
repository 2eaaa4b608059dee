"""Description of a foreign image set: the role of each image, and the conventions of reading.

Symbols of a direction: e = p + ½ is the distance of pattern coordinate p from the edge of the pattern, in px; its phase
is φ = 2π e / period + begin. Step k shows A + B cos(φ + sign · step_k). Stripe number i of the code covers e from
offset + i · stripe to offset + (i + 1) · stripe. ``docs/foreign.md`` has the language by examples.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from appliance.base import parse_toml, read_text
from appliance.desk.foreign.order import FRINGES, MOST_IMAGES, ShownImage, Shows, number_images, parse_order, words_in
from appliance.desk.foreign.problem import ForeignError, Table
from appliance.measure import SIDES, Water

if TYPE_CHECKING:  # brings NumPy
    from appliance.desk.foreign.frames import Frame
    from appliance.measure import Port

MAX_BYTES = 1_000_000
LEAST_STEPS, MOST_STEPS = 3, 16
MOST_BITS = 16
MOST_PERIODS = 16
LEAST_PERIOD_PX, MOST_PX = 2.0, 65536.0
EACH = "each"
CHANNELS = ("grey", "red", "green", "blue", EACH)
"""Channels of colour images; ``each``: a picture is three images, one for red, green and blue each."""
HALVES = {
    "left beside right": ("left half", "right half"),
    "right beside left": ("right half", "left half"),
    "left above right": ("upper half", "lower half"),
    "right above left": ("lower half", "upper half"),
}
"""Words for pictures that show both cameras, with the half of the left camera and that of the right one."""


WORDS: Mapping[str, tuple[str, Mapping[Any, str]]] = {
    "periods_px": ("period_px", {}),
    "sign": ("sign", {1: "+", -1: "-"}),
    "from_middle": ("start_at", {False: "edge", True: "middle"}),
    "plain_binary": ("code", {False: "gray", True: "binary"}),
    "fine_first": ("code_order", {False: "coarse-first", True: "fine-first"}),
    "inverted": ("code_inverted", {}),
}
"""Keys of a direction by field of its convention, and the words for values, the usual one first, where they differ."""


@dataclass(frozen=True, slots=True)
class AxisConvention:
    """Convention by which the images of one direction are read."""

    name: str
    """``x`` (vertical stripes, varying along the columns) or ``y``."""
    size_px: float
    """Length of the pattern along it."""
    periods_px: tuple[float, ...]
    """Fringe periods; empty: stripes of the code alone."""
    steps_deg: tuple[tuple[float, ...], ...]
    """Phase steps of each period in the order of its images, without ``sign``.

    A period of one image shares mean and modulation with the first one (micro phase shifting).
    """
    sign: int = 1
    """1: a step adds to the phase; −1: it takes away."""
    start_deg: float = 0.0
    """Phase at the edge of the pattern, of all periods."""
    starts_deg: tuple[float, ...] = ()
    """Phase at that edge that each period has in addition; empty: none."""
    from_middle: bool = False
    """True if phases begin at the middle of column 0, half a px behind the edge."""
    carriers: tuple[int, ...] = ()
    """Number of steps, by period, of a carrier across that multiplies the fringes (modulated phase shifting); 0: no
    carrier; empty: no period has one."""
    bits: int = 0
    """Number of images of the code; 0: there is none."""
    stripe_px: float = 0.0
    """Width of the code's finest stripes."""
    code_offset_px: float = 0.0
    """Edge of the pattern at which stripe 0 begins."""
    plain_binary: bool = False
    """True if numbers are written in plain binary instead of Gray code."""
    fine_first: bool = False
    """True if the first image has the finest stripes."""
    inverted: bool = False
    """True if a bright stripe is a bit that is not set."""
    wraps: bool = False
    """True if stripes before the pattern's edge are drawn at the other end (shifted code)."""

    @property
    def begins_deg(self) -> tuple[float, ...]:
        """Phase of each period at the edge of the pattern."""
        starts_deg = self.starts_deg or (0.0,) * len(self.periods_px)
        half_px = 0.5 if self.from_middle else 0.0
        return tuple(
            self.start_deg + start - 360.0 * half_px / period
            for start, period in zip(starts_deg, self.periods_px, strict=True)
        )

    @property
    def numbered(self) -> int:
        """Index of the period whose fringes the code numbers: the finest, or the coarsest for wider stripes."""
        return self.finest if self.stripe_px <= 1.01 * self.period_px else self.periods_px.index(max(self.periods_px))

    @property
    def covered_px(self) -> tuple[float, float]:
        """Edges of the code."""
        length_px = self.stripe_px * 2**self.bits
        return (0.0, length_px) if self.wraps else (self.code_offset_px, self.code_offset_px + length_px)

    @property
    def micro(self) -> bool:
        """True if periods share mean and modulation."""
        return any(len(steps) == 1 for steps in self.steps_deg)

    @property
    def period_px(self) -> float:
        """The period that makes the coordinate: the finest, the only one with several steps, or the stripe."""
        return self.periods_px[0] if self.micro else min(self.periods_px, default=self.stripe_px)

    @property
    def finest(self) -> int:
        """Index of the period ``period_px``."""
        return self.periods_px.index(self.period_px)

    @property
    def signed_deg(self) -> tuple[tuple[float, ...], ...]:
        """Phase steps with their sign."""
        return tuple(tuple(self.sign * step for step in steps) for steps in self.steps_deg)


@dataclass(frozen=True, slots=True)
class ImageFiles:
    """Files of one camera's images, relative to the description."""

    patterns: tuple[str, ...]
    """Names with wildcards, in order; each stands for its files in natural order (2 before 10)."""
    kinds: tuple[str, ...] = ()
    """The kind of image that each name stands for (``gray-x``); empty where ``order`` says it."""
    sides: str = ""
    """Repeated order of sides in which the files of both cameras come, or one of ``HALVES``; empty: all are this
    camera's."""
    frames: tuple[Frame, ...] = ()
    """The images themselves, in order, where they were searched in a folder."""


@dataclass(frozen=True, slots=True)
class Description:
    """A foreign set of images, as its image set description has it."""

    name: str
    folder: Path
    """Folder to which names are relative."""
    files: dict[str, ImageFiles]
    """Files by side; without ``right`` where a projector takes its place."""
    order: tuple[ShownImage, ...] | None
    """Image roles in order; ``None``: ``files`` gives them by kind."""
    channel: str
    white: float | None
    """Grey value of saturation; ``None``: it follows from the images."""
    projector_px: tuple[int, int]
    axes: tuple[AxisConvention, ...]
    cameras: Table
    """The table of the cameras, which ``cameras.py`` reads."""
    water: Water | float | None = None
    """Water between cameras and object, or its refractive index relative to air; ``None``: it is air."""
    ports: tuple[Port, Port] | None = None
    """Ports of both cameras."""
    near_mm: float | None = None
    far_mm: float | None = None
    max_sigma_mm: float | None = None
    """Largest expected error of a point; ``None``: it follows from the size of a pixel."""

    @property
    def one_direction(self) -> bool:
        """True if the patterns vary along one direction only."""
        return len(self.axes) == 1

    @property
    def index(self) -> float:
        """Refractive index between cameras and object relative to air."""
        return 1.0 if self.water is None else self.water if isinstance(self.water, float) else self.water.index

    def extent_px(self, axis: AxisConvention) -> tuple[float, float]:
        """Return begin and end of the pattern: of two cameras, the range that the code covers."""
        return axis.covered_px if axis.bits and "right" in self.files else (0.0, axis.size_px)

    def axis(self, name: str) -> AxisConvention | None:
        """Return the convention of a direction; ``None`` where it has no images."""
        return next((axis for axis in self.axes if axis.name == name), None)

    def with_axis(self, axis: AxisConvention) -> Description:
        """Return the description with another convention for that direction."""
        return replace(self, axes=tuple(axis if old.name == axis.name else old for old in self.axes))


def word_for(field: str, value: Any) -> tuple[str, Any]:
    """Return the key of a direction for a field of its convention, and the written form of ``value``."""
    word, written = WORDS.get(field, (field, {}))
    return word, written.get(value, value)


def toml_value(value: Any, digits: int = 8) -> str:
    """Return a value as TOML text; a list of one element is that element."""
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, Sequence):
        elements = [toml_value(element, digits) for element in value]
        return elements[0] if len(elements) == 1 else f"[{', '.join(elements)}]"
    return str(value).lower() if isinstance(value, bool) else f"{value:.{digits}g}"


def equal_steps(count: int) -> tuple[float, ...]:
    """Return ``count`` steps of equal size around the circle, in degrees."""
    return tuple(360.0 * k / count for k in range(count))


def load_description(path: Path) -> Description:
    """Read and check a description. Raises ForeignError."""
    try:
        text = read_text(path, MAX_BYTES)
    except OSError as error:
        raise ForeignError(f"{path}: {error.strerror or error}; give the image set description (TOML)") from error
    except UnicodeDecodeError as error:
        raise ForeignError(f"{path}: byte {error.start} is not UTF-8; save it as UTF-8 text") from error
    return parse_description(text, path.parent, path.stem, str(path))


def parse_description(text: str, folder: Path, name: str, source: str) -> Description:
    """Read a description from ``text``; file names are relative to ``folder``.

    Raises ForeignError, which begins with ``source``.
    """
    try:
        content = parse_toml(text)
    except ValueError as error:
        raise ForeignError(f"{source}: {error}; correct that line (TOML 1.0)") from error
    try:
        return _parse_top(Table("", content), folder, name)
    except ForeignError as error:
        raise ForeignError(f"{source}: {error}") from error


def _parse_top(top: Table, folder: Path, name: str) -> Description:
    top.only("name", "images", "projector", "x", "y", "cameras", "water", "ports", "range")
    images = top.needed("images", "left", "right", "both", "sides", "order", "channel", "white")
    projector = top.needed("projector", "width_px", "height_px")
    size_px = (projector.whole("width_px", 2, int(MOST_PX)), projector.whole("height_px", 2, int(MOST_PX)))
    files = _files(images)
    order = _order(images, files)
    # The number of files of a name is not known yet: one image of each kind stands for all.
    shown = order or number_images(list(dict.fromkeys(files["left"].kinds)), "images.left")
    axes = []
    for axis_name, length in zip("xy", size_px, strict=True):
        own_images = [image for image in shown if image.axis == axis_name]
        table = top.table(axis_name, *_FRINGES, *_CODE, *_OTHERS)
        if own_images and table is None:
            raise ForeignError(f"[{axis_name}] is missing, but the images include {own_images[0].word}; add it")
        if table is not None and not own_images:
            raise ForeignError(f"[{axis_name}] is given, but no image of {axis_name}; name its images, or leave it out")
        if table is not None:
            axes.append(_axis(table, axis_name, float(length), own_images))
    if not axes:
        raise ForeignError(
            f"no image has stripes ({', '.join(sorted({image.word for image in shown}))}); name some, for example gray-x"
        )
    ranges = top.table("range", "near_mm", "far_mm", "max_sigma_mm") or Table("range.", {})
    near_mm, far_mm = (ranges.optional(key, 1.0, 1e6) for key in ("near_mm", "far_mm"))
    if near_mm is not None and far_mm is not None and near_mm >= far_mm:
        raise ForeignError(f"range.near_mm is {near_mm:g}; allowed: less than far_mm = {far_mm:g}; exchange them")
    return Description(
        top.text("name", name), folder, files, order, images.choice("channel", CHANNELS, "grey"),
        images.optional("white", 1.0, 1e6), size_px, tuple(axes), top.needed("cameras"), _water(top), _ports(top),
        near_mm, far_mm, ranges.optional("max_sigma_mm", 1e-6, 1e6),
    )  # fmt: skip


def _names(table: Table, key: str) -> tuple[str, ...]:
    value = table.content.get(key)
    items = [value] if isinstance(value, str) else value
    if not isinstance(items, list) or not items or not all(isinstance(item, str) and item for item in items):
        raise table.wrong(key, 'a name, also with wildcards ("left/*.png"), or a list of names', "correct it")
    return tuple(items)


def _files(images: Table) -> dict[str, ImageFiles]:
    """Return the files of each camera: named for each in order or by kind, or for both together."""
    if "both" not in images.content and "sides" not in images.content:
        return {side: _files_of_side(images, side) for side in SIDES if side == "left" or side in images.content}
    if "left" in images.content or "right" in images.content:
        raise ForeignError("images.both and images.left, right: give names for both together, or for each")
    sides = images.text("sides", "left right")
    if sides not in HALVES:
        turns = words_in(sides, "images.sides", 2 * MOST_IMAGES)
        if not turns or set(turns) - set(SIDES) or turns.count("left") != turns.count("right"):
            allowed = f"as many left as right: left right, or left*11 right*11; {', '.join(HALVES)}"
            raise images.wrong("sides", allowed, "correct it")
    return dict.fromkeys(SIDES, ImageFiles(_names(images, "both"), sides=sides))


def _files_of_side(images: Table, side: str) -> ImageFiles:
    value = images.content.get(side)
    if not isinstance(value, dict):
        return ImageFiles(_names(images, side))
    if not value:
        raise images.wrong(side, "names of images", "name some")
    by_kind = {word: _names(Table(f"images.{side}.", value), word) for word in value}
    kinds = tuple(word for word, names in by_kind.items() for _ in names)
    return ImageFiles(tuple(name for names in by_kind.values() for name in names), kinds)


def _order(images: Table, files: dict[str, ImageFiles]) -> tuple[ShownImage, ...] | None:
    """Return the image roles in order; ``None`` if they are given by kind."""
    kinds = {frozenset(side_files.kinds) for side_files in files.values()}
    if len(kinds) > 1:
        raise ForeignError(
            "images.left and images.right name different kinds of images, or only one is in order; name both alike"
        )
    if kinds == {frozenset()}:
        return parse_order(images.text("order"), "images.order")
    if "order" in images.content:
        raise images.wrong("order", "nothing, where images are named by kind", "take it out")
    return None


_FRINGES, _CODE = ("period_px", "fringes", "steps", "steps_deg"), ("gray", "stripe_px")
_OTHERS = ("sign", "start_deg", "start_at", "code_offset_px", "code", "code_order", "code_inverted")
_STRIPES = {"ordinary": (1.0, 0.0), "complementary": (0.5, 0.0), "shifted": (1.0, -0.5)}
"""Width and offset of the stripes of a code, in periods."""


def _axis(table: Table, name: str, size_px: float, own_images: list[ShownImage]) -> AxisConvention:
    fringed = {image.period: image.shows for image in own_images if image.shows in FRINGES}
    has_code = any(image.shows is Shows.GRAY for image in own_images)
    for is_given, keys, role in ((fringed, _FRINGES, f"sine-{name}"), (has_code, _CODE, f"gray-{name}")):
        if not is_given and (unused := [key for key in keys if key in table.content]):
            raise ForeignError(
                f"{name}.{unused[0]} is given, but no image is a {role}; name such images, or leave it out"
            )
    periods_px = _periods(table, size_px) if fringed else ()
    micro = Shows.MICRO in fringed.values()
    if not micro and max(fringed, default=-1) + 1 != len(periods_px):
        raise ForeignError(
            f"{name} has {len(periods_px)} periods, and its images are of {max(fringed) + 1}; name sine-{name}, "
            f"sine-{name}2, … for each"
        )
    if len(periods_px) == 1 and not has_code and periods_px[0] < size_px:
        raise ForeignError(
            f"{name} has one period of {periods_px[0]:g} px on {size_px:g} px and no gray-{name}: the fringe "
            "order is unknown; name the images of a code, or of further periods"
        )
    starts_deg = table.numbers("start_deg", -360.0, 360.0, default=0.0)
    if len(starts_deg) not in (1, len(periods_px)):
        raise table.wrong("start_deg", f"one number, or one for each of {len(periods_px)} periods", "correct it")
    common: tuple[float, tuple[float, ...]] = (starts_deg[0], ()) if len(starts_deg) == 1 else (0.0, starts_deg)
    width, offset = _STRIPES[gray := table.choice("gray", _STRIPES, "ordinary")]
    stripe_px = 0.0
    if has_code:
        if not fringed and "gray" in table.content:
            raise table.wrong("gray", "nothing, where there are no sine images", f"write {name}.stripe_px instead")
        stripe_px = table.number("stripe_px", 0.5, MOST_PX, width * min(periods_px) if fringed else None)
        if fringed and stripe_px > 1.01 * max(periods_px):
            raise table.wrong(
                "stripe_px",
                f"up to the coarsest period, {max(periods_px):g} px",
                "wider stripes do not give the fringe order",
            )
    chosen: dict[str, Any] = {}
    for field, (word, written) in WORDS.items():
        if written:
            choice = table.choice(word, tuple(written.values()), next(iter(written.values())))
            chosen[field] = next(value for value, text in written.items() if text == choice)
    return AxisConvention(
        name,
        size_px,
        periods_px,
        _steps(table, len(periods_px), micro) if fringed else (),
        start_deg=common[0],
        starts_deg=common[1],
        stripe_px=stripe_px,
        code_offset_px=table.number("code_offset_px", -MOST_PX, MOST_PX, offset * stripe_px),
        inverted=table.flag("code_inverted"),
        wraps=gray == "shifted",
        **chosen,
    )


def _periods(table: Table, size_px: float) -> tuple[float, ...]:
    if ("period_px" in table.content) == ("fringes" in table.content):
        raise ForeignError(
            f"{table.name}period_px or {table.name}fringes (their number across the pattern): give one of them"
        )
    if "fringes" in table.content:
        periods_px = tuple(size_px / count for count in table.numbers("fringes", 0.01, size_px / LEAST_PERIOD_PX))
    else:
        periods_px = table.numbers("period_px", LEAST_PERIOD_PX, MOST_PX)
    if len(periods_px) > MOST_PERIODS:
        raise table.wrong("period_px", f"up to {MOST_PERIODS} periods", "leave some out")
    if len(set(periods_px)) < len(periods_px):
        raise table.wrong("period_px", "different periods", "leave one out")
    return periods_px


def _steps(table: Table, periods: int, micro: bool) -> tuple[tuple[float, ...], ...]:
    """Return the steps of each period: one list is that of all.

    With micro phase shifting it is that of the first period, and the others have one step.
    """
    if "steps" in table.content and "steps_deg" in table.content:
        raise ForeignError(f"{table.name}steps and {table.name}steps_deg are both given; leave one out")
    written = table.content.get("steps_deg")
    if written is None:
        steps_deg = [equal_steps(count) for count in table.wholes("steps", LEAST_STEPS, MOST_STEPS)]
    else:
        lists = written if isinstance(written, list) and written and isinstance(written[0], list) else [written]
        steps_deg = [
            Table(table.name, {"steps_deg": step_list}).numbers("steps_deg", -3600.0, 3600.0) for step_list in lists
        ]
    if not all(LEAST_STEPS <= len(step_list) <= MOST_STEPS for step_list in steps_deg):
        raise table.wrong("steps_deg", f"{LEAST_STEPS} to {MOST_STEPS} steps", "name all of one period")
    if micro and len(steps_deg) == 1:
        return (steps_deg[0], *[(0.0,)] * (periods - 1))
    if len(steps_deg) not in (1, periods) or micro:
        raise table.wrong(
            "steps" if written is None else "steps_deg",
            f"one for all, or one for each of {periods} periods",
            "correct it",
        )
    return tuple(steps_deg * (periods if len(steps_deg) == 1 else 1))


def _water(top: Table) -> Water | float | None:
    water = top.table("water", "index", "temperature_c", "salinity_psu", "wavelength_nm")
    if water is None:
        return None
    index, temperature_c = water.optional("index", 1.0, 1.6), water.optional("temperature_c", -2.0, 40.0)
    if (index is None) == (temperature_c is None):
        raise ForeignError("water.index or water.temperature_c: give one of them; for air leave out [water]")
    salinity_and_wavelength = (
        water.number("salinity_psu", 0.0, 45.0, 0.0),
        water.number("wavelength_nm", 380.0, 750.0, 530.0),
    )
    return index if temperature_c is None else Water(temperature_c, *salinity_and_wavelength)


def _ports(top: Table) -> tuple[Port, Port] | None:
    ports = top.table("ports", "distance_mm", "thickness_mm", "glass_index", "left_normal", "right_normal")
    if ports is None:
        return None
    from appliance.measure import Port

    normals = []
    for side in SIDES:
        normal = ports.numbers(f"{side}_normal", -1e6, 1e6, default=(0.0, 0.0, 1.0))
        length = math.hypot(*normal)
        if len(normal) != 3 or length < 1e-6 or normal[2] < 0.5 * length:
            allowed = "three numbers: a vector towards the water, in the camera's own frame"
            raise ports.wrong(f"{side}_normal", allowed, "correct it")
        x, y, z = normal
        normals.append((x / length, y / length, z / length))
    size = (
        ports.number("distance_mm", 0.0, 1000.0),
        ports.number("thickness_mm", 0.0, 100.0),
        ports.number("glass_index", 1.0, 3.0),
    )
    return Port(normals[0], *size), Port(normals[1], *size)


def with_counts(description: Description, images: tuple[ShownImage, ...]) -> Description:
    """Return the description with the numbers of bits and carrier steps in ``images``.

    Raises ForeignError where a direction has other numbers of steps, bits or inverses than its convention allows.
    """
    axes = []
    for axis in description.axes:
        own_images = [image for image in images if image.axis == axis.name]
        carriers = []
        for period, steps in enumerate(axis.steps_deg):
            fringes = [image for image in own_images if image.shows in FRINGES and image.period == period]
            modulated = bool(fringes) and fringes[0].shows is Shows.MODULATED
            carriers.append(max(LEAST_STEPS, len(fringes) // len(steps)) if modulated else 0)
            needed = len(steps) * max(1, carriers[-1])
            if axis.micro:
                needed = 0 if period else sum(map(len, axis.steps_deg))
            if len(fringes) != needed:
                word = fringes[0].word if fringes else f"sine-{axis.name}{period + 1 if period else ''}"
                raise ForeignError(
                    f"{len(fringes)} images are {word}, and {needed} are needed for {axis.name} with {len(steps)} "
                    "steps; name as many"
                )
        bits, inverses = (sum(image.shows is shows for image in own_images) for shows in (Shows.GRAY, Shows.INVERSE))
        if inverses not in (0, bits):
            raise ForeignError(
                f"{bits} images are gray-{axis.name} and {inverses} ~gray-{axis.name}; each needs its inverse, or none"
            )
        if bits > MOST_BITS:
            raise ForeignError(f"{bits} images are gray-{axis.name}; allowed are up to {MOST_BITS}; name others -")
        axis = replace(axis, bits=bits, carriers=tuple(carriers) if any(carriers) else ())
        end_px = axis.covered_px[1]
        if bits and "right" not in description.files and end_px < 0.5 * axis.size_px:
            raise ForeignError(
                f"{bits} images of gray-{axis.name} with stripes of {axis.stripe_px:g} px number {end_px:g} px of the "
                "pattern's "
                f"{axis.size_px:g}; correct {axis.name}.stripe_px, {axis.name}.gray or the order"
            )
        axes.append(axis)
    return replace(description, axes=tuple(axes))
