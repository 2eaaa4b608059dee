"""Owns the verb ``sim``: the instrument in a simulated world, held by a person, a script, or an unlucky diver."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from appliance.cli.arguments import option, repeated, switch, whole
from appliance.cli.chaos import Chaos, chaos
from appliance.cli.instrument import serve
from appliance.cli.kernels import compile_kernels
from appliance.cli.output import Exit
from appliance.cli.places import WithRoot
from appliance.cli.simrig import (
    OBJECTS,
    PACES,
    TEXTURES,
    TRUTHS,
    WORLDS,
    SimOptions,
    default_sim_rig,
    simulated,
    simulator_kernels,
    with_simulated_wires,
)

if TYPE_CHECKING:  # brings pydantic, which `--help` can do without
    from appliance.store import Rig

SEED = whole(0, 999_999_999)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sim(WithRoot):
    """The same instrument in a simulated world. What goes wrong there brings its own exit code."""

    codes: ClassVar[Sequence[Exit]] = (Exit.SCRIPT_FAILED,)
    service: ClassVar[bool] = True

    object: str | None = option("--object", "what lies before the scanner", choices=OBJECTS)
    texture: str | None = option("--texture", "its albedo", choices=TEXTURES)
    truth: str | None = option("--truth", f"the true rig: {', '.join(TRUTHS)}, or a truth.toml", metavar="SET")
    world: str | None = option("--world", "outside: a harsher one, drawn by --seed", choices=WORLDS)
    seed: int | None = option("--seed", "seeds the truth and all noise", parse=SEED)
    size: str | None = option("--size", "camera size in px, for example 800x600", metavar="WxH")
    pace: str | None = option("--pace", "how world time passes", choices=PACES)
    script: Path | None = option("--script", "a diver's script; exit code 3 if it fails", parse=Path, metavar="FILE")
    faults: Sequence[str] = repeated("--fault", "a fault; may be repeated", metavar="SENTENCE")
    chaos: int | None = option("--chaos", "a dive on which devices come and go, seeded", parse=SEED, metavar="SEED")
    scans: int = option(
        "--scans", "of --chaos: how often SCAN is pressed (default 200)", default=200, parse=whole(1, 100_000)
    )
    console: bool = switch("--console", "commands on standard input; as --window on a terminal has it")
    window: bool = switch("--window", "show both screens in windows; the keyboard is the key pad")

    def run(self) -> Exit:
        from appliance.store import load_rig

        rig = load_rig(self.rig or default_sim_rig())
        options = SimOptions(
            root=self.new_root(),
            object_name=self.object,
            texture=self.texture,
            truth=self.truth,
            world=self.world,
            seed=self.seed,
            size=self.size,
            pace=self.pace,
            script=self.script,
            faults=self.faults,
            window=self.window,
            # Without a terminal standard input may be closed, or somebody else's text.
            console=self.console or (self.window and sys.stdin.isatty()),
        )
        if self.chaos is None:
            return dive(rig, options)
        return chaos(rig, options, Chaos(self.chaos, self.scans), dive, json=self.json)


def dive(rig: Rig, options: SimOptions) -> Exit:
    """Run the instrument of ``rig`` in its simulated world until that ends. Raises UsageError for options that do not fit."""
    wanted = simulated(with_simulated_wires(rig), options)
    compile_kernels(simulator_kernels)
    from appliance.cli.simtruth import bring_calibration

    bring_calibration(wanted)
    return serve(wanted)
