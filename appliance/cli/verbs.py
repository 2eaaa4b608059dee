"""Owns the verbs that reach into the service: each calls one function of it and prints what it returns."""

from __future__ import annotations

import faulthandler
from pathlib import Path

from appliance import __version__, kernel_build, kernel_cache
from appliance.cli.desk import measuring, scan_in, whole_scan, writable, writable_cloud, writing
from appliance.cli.kernels import Progress as CompilerProgress
from appliance.cli.kernels import compile_desk_kernels, compile_kernels, find_kernels
from appliance.cli.listing import listing
from appliance.cli.output import Exit, Progress, UsageError, say, say_json, table
from appliance.cli.simrig import SimOptions, simulated, simulator_kernels, with_simulated_wires
from appliance.config import Rig
from appliance.service.origin import Wish, calibration_for, instrument_of, one_calibration, taken
from appliance.storage.atomic import remedy_for

# The service is imported inside the verbs: it brings drivers and compiled kernels, which `scans list` can do without.


def run(rig: Rig) -> Exit:
    """The instrument, until it is switched off."""
    find_kernels()
    return _serve(rig)


def sim(rig: Rig, options: SimOptions) -> Exit:
    """The same instrument in a simulated world. What goes wrong there brings its own exit code (``main``)."""
    wanted = simulated(with_simulated_wires(rig), options)
    compile_kernels(simulator_kernels)
    from appliance.cli.simtruth import bring_calibration

    bring_calibration(wanted)
    return _serve(wanted)


def check(rig: Rig, *, json: bool) -> Exit:
    """Open every device once and say what it says about itself; FAILED if any does not work."""
    find_kernels()
    from appliance.service.checkup import check as check_devices

    with Progress() as progress:
        progress("asking the devices")
        found = check_devices(rig)
    if json:
        say_json([{"device": h.device, "ok": h.ok, "summary": h.summary, "details": dict(h.details)} for h in found])
    else:
        facts = ("serial", "link", "firmware")
        rows = [
            (h.device, "ok" if h.ok else "FAILED", *(h.details.get(fact, "-") for fact in facts), h.summary)
            for h in found
        ]
        say(table(("DEVICE", "", *(fact.upper() for fact in facts), "WHAT IT IS, OR WHAT IS WRONG"), rows))
    return Exit.OK if all(h.ok for h in found) else Exit.FAILED


def reconstruct(wish: Wish, scan: str, out: Path | None, *, damaged: bool = False, json: bool) -> Exit:
    """A stored scan's cloud from its raw frames. ``scan``: its number, or its folder; ``damaged``: of what is left of it."""
    writable_cloud(out)
    measuring(wish.calibration)
    with Progress() as progress:
        progress("comparing checksums")
        folder = scan_in(wish, scan) if damaged else whole_scan(wish, scan)
        compile_desk_kernels()
        from appliance.service.desk import reconstruct_scan
        from appliance.service.salvage import salvage

        salvaged = salvage(folder) if damaged else None
        source = taken(folder, wish, None if salvaged is None else salvaged.scan)
        chosen = calibration_for(source, wish)
        with writing(out or Path(f"{folder.name}.ply")):
            report = reconstruct_scan(source, chosen, out, progress, salvaged)
    if json:
        say_json(report)
    else:
        listing(report)
    return Exit.OK


def merge(wish: Wish, scans: tuple[str, str], out: Path | None, *, json: bool) -> Exit:
    """One cloud of two stored scans with different exposures. ``scans``: their numbers, or their folders."""
    writable_cloud(out)
    measuring(wish.calibration)
    with Progress() as progress:
        progress("comparing checksums")
        first, second = (whole_scan(wish, scan) for scan in scans)
        compile_desk_kernels()
        from appliance.service.merging import merge_scans

        sources = (taken(first, wish), taken(second, wish))
        instrument_of(sources, wish)  # refuses two
        chosen = one_calibration(sources, wish)
        with writing(out or Path(f"{first.name}+{second.name}.ply")):
            report = merge_scans(sources, chosen, out, progress)
    if json:
        say_json(report)
    else:
        listing(report)
    return Exit.OK


def calibration_show(rig: Rig, path: Path | None, *, json: bool) -> Exit:
    """The calibration in use, or that of a file."""
    from appliance.service.desk import describe_calibration

    content = describe_calibration(rig, path)
    if json:
        say_json(content)
    else:
        listing(content)
    return Exit.OK


def calibration_nominal(rig: Rig, out: Path | None, *, json: bool) -> Exit:
    """Write the calibration that follows from the rig file's design. Never replaces a file."""
    from appliance.service.app import CALIBRATION_FILE
    from appliance.service.desk import write_nominal_calibration

    writable(out)
    path = out or rig.storage.root / CALIBRATION_FILE.with_name("nominal.json")
    if path.exists():
        raise UsageError(f"--out {path}: exists already; a calibration is never replaced; give a new name")
    with writing(path):
        write_nominal_calibration(rig, path)
    if json:
        say_json({"file": str(path)})
    else:
        say(str(path))
    return Exit.OK


def version(*, json: bool) -> Exit:
    if json:
        say_json({"version": __version__})
    else:
        say(f"kingfisher {__version__}")
    return Exit.OK


def warm(out: Path | None, *, common: bool, json: bool) -> Exit:
    """Compile the kernels for this processor, or for the common level, as an installation does."""
    from appliance.worker.warm import DESK

    target = out or kernel_cache.shipped_folder()
    with CompilerProgress() as progress:
        try:
            folder = kernel_build.build(target, DESK, progress, kernel_cache.COMMON if common else None)
        except OSError as error:
            raise UsageError(
                f"{target}: {error.strerror or error}; {remedy_for(error)}; --out DIR writes elsewhere"
            ) from error
    if json:
        say_json({"folder": str(folder)})
    else:
        say(f"kernels are in {folder}")
    return Exit.OK


def _serve(rig: Rig) -> Exit:
    faulthandler.enable(all_threads=True)  # who kills it because it hangs, or it dies in a library: where was it?
    from appliance.service.app import run as run_service

    return Exit(run_service(rig))
