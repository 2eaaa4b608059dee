"""The rig of ``kingfisher sim``: a rig file whose wires lead to a simulated world, changed by the options.

The simulator is found by name, as a folder with a rig file in it; nothing of it is imported here. The options are those
of ``docs/protocols/world.md`` and go into ``[rig.wires_options]``, unread by the product.
"""

from __future__ import annotations

import importlib
import importlib.util
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from appliance.cli.output import UsageError

if TYPE_CHECKING:
    from appliance.store import Rig

SIMULATOR = "hw_sim"
OBJECTS = ("plane", "ballbar", "frustum", "pipe", "shell", "stones", "board", "main")
TEXTURES = ("none", "slight", "strong", "checker", "labels")
TRUTHS = ("nominal", "realistic", "hard", "paper", "modelled", "outside")
WORLDS = ("ordinary", "outside")
DEFAULT_SEED = 1
"""Default seed of the world, where neither the command line nor the rig file has one."""
PACES = ("lockstep", "realtime", "attended")


@dataclass(frozen=True, slots=True)
class SimOptions:
    """Options that the command line may change; ``None`` leaves the value of the rig file."""

    root: Path | None = None
    object_name: str | None = None
    texture: str | None = None
    truth: str | None = None
    world: str | None = None
    """One of ``WORLDS``; the strengths of ``outside`` follow from the seed."""
    seed: int | None = None
    size: str | None = None
    """``1600x1200``."""
    pace: str | None = None
    script: Path | None = None
    faults: Sequence[str] = ()
    window: bool = False
    console: bool = False


def default_sim_rig() -> Path:
    """Return the rig file that comes with the simulator. Raises UsageError if it is not installed."""
    spec = importlib.util.find_spec(SIMULATOR)
    if spec is None or spec.origin is None:
        raise UsageError("the simulator is not installed; install it, or give a rig file with --rig PATH")
    return Path(spec.origin).parent / "rigs" / "full.toml"


def simulator_kernels() -> Iterable[tuple[str, str]]:
    """Return the pieces (text, function) that the simulator has to compile before it opens."""
    pieces: Iterable[tuple[str, str]] = importlib.import_module(f"{SIMULATOR}.rendering.warm").PIECES
    return pieces


def check_simulated_wires(rig: Rig) -> Rig:
    """Return ``rig``. Raises UsageError unless its wires lead to the simulator: no real device is started."""
    if rig.rig.wires.partition(".")[0] != SIMULATOR:
        raise UsageError(
            f"--rig: wires of [rig] is {rig.rig.wires}, no simulated world; allowed: {SIMULATOR}.wires:open; "
            "use `kingfisher run` for an instrument"
        )
    return rig


def apply_options(rig: Rig, options: SimOptions) -> Rig:
    """Return ``rig`` with the options. Raises UsageError for one that does not fit, before any device is started."""
    wires = dict(rig.rig.wires_options)
    if options.root is not None:
        rig = replace(rig, storage=replace(rig.storage, root=options.root.absolute()))
    if options.size is not None:
        rig = _resize(rig, options.size)
        wires |= {"width_px": rig.camera.left.width_px, "height_px": rig.camera.left.height_px}
    if options.truth is not None and options.truth not in TRUTHS:
        wires["truth"] = str(_check_file("truth=", Path(options.truth), f"one of {', '.join(TRUTHS)}, or a truth.toml"))
    elif options.truth is not None:
        wires["truth"] = options.truth
    if options.world == "ordinary":
        wires.pop("outside", None)
    elif options.world is not None:
        wires["outside"] = {"seed": options.seed if options.seed is not None else wires.get("seed", DEFAULT_SEED)}
    if options.script is not None:
        wires["script"] = str(_check_file("--script ", options.script, "the path of a scenario"))
    chosen: dict[str, Any] = {
        "object": options.object_name,
        "texture": options.texture,
        "seed": options.seed,
        # Lock-step goes as fast as it can between two sequences, and no person keeps up with that (ADR 0004).
        "pace": options.pace or ("attended" if options.window else None),
        "window": options.window or None,
        "console": options.console or None,
        # Faults are added to those of the rig file, while all other options replace its values.
        "faults": [*wires.get("faults", []), *options.faults] if options.faults else None,
    }
    wires |= {name: value for name, value in chosen.items() if value is not None}
    wires["status"] = str(rig.storage.root.absolute() / "run" / "status.json")
    return replace(rig, rig=replace(rig.rig, wires_options=wires))


def _check_file(option: str, path: Path, allowed: str) -> Path:
    if not path.is_file():
        raise UsageError(f"{option}{path}: no such file; allowed: {allowed}")
    return path.absolute()


def _resize(rig: Rig, size: str) -> Rig:
    """Return cameras of another size with the same field of view: larger pixels if there are fewer."""
    old = rig.camera.left
    match = re.fullmatch(r"(\d{2,4})x(\d{2,4})", size)
    width_px, height_px = (int(match[1]), int(match[2])) if match else (0, 0)
    if not (64 <= width_px <= 8192 and width_px * old.height_px == height_px * old.width_px):
        raise UsageError(
            f"size={size}: allowed are WIDTHxHEIGHT from 64 to 8192 px in the ratio {old.width_px}:{old.height_px}; "
            f"for example {old.width_px // 2}x{old.height_px // 2}"
        )
    cameras = replace(
        rig.camera,
        left=replace(rig.camera.left, width_px=width_px, height_px=height_px),
        right=replace(rig.camera.right, width_px=width_px, height_px=height_px),
    )
    # Focal length in px = principal distance / pixel: with the sensor's size kept, the angles stay.
    design = replace(rig.design, pixel_um=rig.design.pixel_um * old.width_px / width_px)
    return replace(rig, camera=cameras, design=design)
