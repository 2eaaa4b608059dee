"""Kernels compiled at installation are used from a read-only disk, and never when anything in them has changed; how a process starts."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import pytest

from appliance.base import kernel_cache
from appliance.base.kernel_build import compile_pieces
from appliance.base.kernel_cache import COMPLETE, VARIABLE, KernelOrigin
from appliance.base.process_start import BLAS_THREADS, use_one_blas_thread
from appliance.measure import warm

USE = """
import json, sys
from pathlib import Path
from appliance.base import kernel_cache
cache = kernel_cache.use_kernel_cache(Path(sys.argv[1]), Path(sys.argv[2]))
from appliance.measure.warm import run_every_kernel
run_every_kernel()
import gc
from numba.core.registry import CPUDispatcher
kernels = [one for one in gc.get_objects() if isinstance(one, CPUDispatcher) and one.__module__.startswith("appliance.")]
compiled = sorted({kernel.__name__ for kernel in kernels if kernel.stats.cache_misses})
hits = sum(bool(kernel.stats.cache_hits) for kernel in kernels)
def written(signature):  # as if each array may be written
    return ", ".join(str(one).replace("readonly ", "") for one in signature)
twice = sorted({
    kernel.__name__ for kernel in kernels if len({written(one) for one in kernel.signatures}) < len(kernel.signatures)
})
print(json.dumps({
    "origin": cache.origin.value, "path": str(cache.path), "compiled": compiled, "found": hits, "twice": twice,
}))
"""


def called(*words: object, timeout_s: float = 200.0, **changes: str) -> Any:
    """What another process of Python prints as JSON, without a place for kernels in its environment."""
    environment = {name: value for name, value in os.environ.items() if name != VARIABLE} | changes
    command = [sys.executable, *map(str, words)]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=timeout_s, check=True)
    return json.loads(ran.stdout)


def started(shipped: Path, writable: Path, temporary: Path) -> dict[str, Any]:
    return dict(called("-c", USE, shipped, writable, TMPDIR=str(temporary)))


@pytest.fixture(scope="module")
def shipped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As an installation leaves it, from what this source tree has compiled, piece by piece."""
    mine = kernel_cache.use_kernel_cache().path
    compile_pieces(mine, warm.PIECES)
    folder = tmp_path_factory.mktemp("installation")
    copy = folder / kernel_cache.fingerprint()
    shutil.copytree(mine, copy)
    (copy / COMPLETE).touch()
    return folder


def test_what_the_installation_compiled_is_not_compiled_again(
    shipped: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = started(shipped, tmp_path / "cache", tmp_path)
    assert (first["origin"], first["compiled"]) == ("shipped", [])
    assert first["found"] > 20
    assert first["twice"] == [], "an array cannot be written: make it writable where it is made"
    assert Path(first["path"]).parent == tmp_path / "cache"
    again = chosen(monkeypatch, tmp_path / "gone", tmp_path / "cache")
    assert (again.origin, again.path) == (KernelOrigin.READY, Path(first["path"]))


def chosen(monkeypatch: pytest.MonkeyPatch, shipped: Path, writable: Path) -> kernel_cache.KernelCache:
    """What a process of its own would choose."""
    config: Any = numba.config
    monkeypatch.setattr(config, "CACHE_DIR", config.CACHE_DIR)  # given back afterwards
    monkeypatch.delenv(VARIABLE, raising=False)
    return kernel_cache.use_kernel_cache(shipped, writable)


def test_without_a_place_to_write_there_is_a_temporary_one_and_a_copy_that_was_cut_off_is_not_trusted(
    shipped: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    said = chosen(monkeypatch, shipped, Path("/proc/read-only"))
    assert (said.origin, tmp_path in said.path.parents) == (KernelOrigin.SHIPPED, True)
    (folder,) = (f for f in shipped.iterdir() if f.is_dir())
    shutil.copytree(folder, tmp_path / "half" / folder.name, ignore=shutil.ignore_patterns(COMPLETE))
    assert chosen(monkeypatch, tmp_path / "half", tmp_path / "cache").origin is KernelOrigin.EMPTY


def test_who_sets_the_place_keeps_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    assert kernel_cache.use_kernel_cache(tmp_path / "a", tmp_path / "b") == kernel_cache.KernelCache(
        tmp_path, KernelOrigin.GIVEN
    )


def test_a_changed_function_in_another_file_is_another_program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tree = Path(kernel_cache.__file__).parents[2]
    for package in ("appliance", "drivers", "hw_sim"):
        shutil.copytree(tree / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(kernel_cache, "_PROGRAM", tmp_path / "appliance")
    prints = [kernel_cache.fingerprint(), kernel_cache.fingerprint()]
    for file in ("appliance/measure/decode/scratch.py", "hw_sim/optics/trace.py"):
        (tmp_path / file).write_text((tmp_path / file).read_text() + "\n")
        prints.append(kernel_cache.fingerprint())
    assert (prints[0] == prints[1], len(set(prints))) == (True, 3)


@pytest.fixture
def last_resort(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder that a process without any other place used in a temporary folder that everybody may write to."""
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o1777)
    monkeypatch.delenv(VARIABLE, raising=False)
    config: Any = numba.config
    monkeypatch.setattr(config, "CACHE_DIR", config.CACHE_DIR)  # given back afterwards
    monkeypatch.setattr(tempfile, "tempdir", str(shared))
    return shared / f"kingfisher-kernels-{os.getuid()}" / kernel_cache.fingerprint()


def used() -> kernel_cache.KernelCache:
    os.environ.pop(VARIABLE, None)
    return kernel_cache.use_kernel_cache(Path("/nothing/shipped"), Path("/proc/read-only"))


def prepared(folder: Path, mode: int = 0o700) -> None:
    """Lay a folder of kernels there, ``complete`` included, as a stranger would."""
    folder.mkdir(parents=True)
    (folder / COMPLETE).touch()
    folder.chmod(mode)


def a_strangers(folder: Path, _: Path) -> None:
    prepared(folder)
    given_away(folder)


def given_away(folder: Path) -> None:
    if os.geteuid() != 0:
        pytest.skip("only root can make a folder of somebody else's")
    os.chown(folder, 65534, 65534)


def linked(folder: Path, elsewhere: Path) -> None:
    prepared(elsewhere)
    folder.parent.mkdir()
    folder.symlink_to(elsewhere)


def below_a_strangers(folder: Path, _: Path) -> None:
    """Its owner may rename what others keep in it, sticky or not."""
    folder.parent.mkdir()
    folder.parent.chmod(0o1777)
    given_away(folder.parent)


def no_longer_sticky(folder: Path, _: Path) -> None:
    prepared(folder)
    folder.parents[1].chmod(0o777)


@pytest.mark.parametrize(
    "lay",
    [
        a_strangers, linked, below_a_strangers, no_longer_sticky,
        lambda folder, _: prepared(folder, 0o740), lambda folder, _: prepared(folder, 0o701),
    ],
)  # fmt: skip
def test_kernels_that_others_laid_into_tmp_or_may_exchange_are_never_run(
    lay: Callable[[Path, Path], object], last_resort: Path, tmp_path: Path
) -> None:
    lay(last_resort, tmp_path / "elsewhere")
    cache = used()
    assert (cache.origin, cache.path == last_resort) == (KernelOrigin.EMPTY, False)
    assert cache.path.resolve() != (tmp_path / "elsewhere").resolve()
    found = cache.path.lstat()
    assert (found.st_uid, found.st_mode & 0o777) == (os.geteuid(), 0o700)


@pytest.mark.parametrize(
    ("owner", "mode", "exchanged"),
    [
        (0, 0o40755, False), (0, 0o41777, False), (0, 0o40777, True), (0, 0o42775, False),  # /tmp, and that of Debian's administrators
        (1000, 0o40700, False), (1000, 0o41777, False), (1000, 0o40777, True), (1001, 0o40700, True), (1001, 0o41777, True),
        (1000, 0o120777, True),  # a link
    ],
)  # fmt: skip
def test_a_folder_above_belongs_to_root_or_this_user(owner: int, mode: int, exchanged: bool) -> None:
    assert kernel_cache.others_may_exchange(owner, mode, 1000) is exchanged


def test_the_last_resort_is_private_and_used_again(last_resort: Path) -> None:
    first = used()
    assert (first.path, first.path.lstat().st_mode & 0o777) == (last_resort, 0o700)
    assert used().path == first.path
    (last_resort / COMPLETE).touch()
    assert used() == kernel_cache.KernelCache(last_resort, KernelOrigin.READY)


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({"CACHE_DIRECTORY": "/var/cache/kingfisher", "HOME": "/root"}, "/var/cache/kingfisher/kernels"),
        ({"XDG_CACHE_HOME": "/x", "HOME": "/root"}, "/x/kingfisher/kernels"),
        ({"HOME": "/home/diver"}, "/home/diver/.cache/kingfisher/kernels"),
    ],
)
def test_the_service_and_its_user_have_a_place(
    environment: dict[str, str], expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kernel_cache, "_PROGRAM", tmp_path / "site-packages" / "appliance")
    assert kernel_cache.writable_folder(environment) == Path(expected)


def test_whichever_command_starts_it_a_source_tree_has_one_place_for_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    tree = Path(kernel_cache.__file__).parents[2]
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.delenv("CACHE_DIRECTORY", raising=False)
    expected = tree / ".cache/numba" / kernel_cache.fingerprint()
    told = subprocess.run(
        [sys.executable, "-m", "appliance.base.kernel_cache"],
        cwd="/",
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert Path(told.stdout.strip()) == expected
    assert kernel_cache.use_kernel_cache().path == expected  # as `kingfisher` finds it by itself
    monkeypatch.setenv(VARIABLE, str(expected))
    assert kernel_cache.use_kernel_cache().path == expected  # as what ./dev starts finds it
    assert kernel_cache.use_kernel_cache().origin is not KernelOrigin.GIVEN


@pytest.mark.long
def test_an_image_brings_kernels_for_processors_it_has_never_seen(tmp_path: Path) -> None:
    if not kernel_cache.runs_common(kernel_cache.this_processor()):
        pytest.skip("this processor is below x86-64-v3, which images are made for")
    shipped = tmp_path / "image"
    made = called("-m", "appliance.cli", "setup", "compile", "--json", "--out", shipped, "--common", timeout_s=900.0)
    assert (Path(made["folder"]) / COMPLETE).exists()
    said = started(shipped, tmp_path / "cache", tmp_path)
    assert (said["origin"], said["compiled"]) == ("shipped", [])
    assert Path(said["path"]).name == kernel_cache.fingerprint(kernel_cache.COMMON_KERNELS)


def test_an_old_processor_does_not_run_the_kernels_of_an_image(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    image = tmp_path / "image"
    common = image / kernel_cache.fingerprint(kernel_cache.COMMON_KERNELS)
    common.mkdir(parents=True)
    (common / COMPLETE).touch()
    old = kernel_cache.Processor("ivybridge", "+avx,+sse4.2,+popcnt,+cx16,+f16c,-avx2,-fma")
    monkeypatch.setattr(kernel_cache, "this_processor", lambda: old)
    assert kernel_cache.use_kernel_cache(image, tmp_path / "cache").origin is KernelOrigin.EMPTY


IMPORTS = """
import gc, json
from appliance.base.process_start import importing
passes = []
gc.callbacks.append(lambda phase, _: passes.append(phase))
with importing():
    made = [[] for _ in range(100_000)]
inside = len(passes)
made += [[] for _ in range(10_000)]
print(json.dumps({"inside": inside, "after": len(passes), "looked at": len(gc.get_objects()), "on": gc.isenabled()}))
"""


def printed(program: str) -> str:
    without = {name: value for name, value in os.environ.items() if name != BLAS_THREADS}
    done = subprocess.run(
        [sys.executable, "-c", program], env=without, capture_output=True, text=True, timeout=100, check=True
    )
    return done.stdout


def test_the_collector_sleeps_while_modules_are_imported_and_never_looks_at_what_they_made() -> None:
    seen = json.loads(printed(IMPORTS))
    assert seen["inside"] == 0
    assert seen["on"]
    assert seen["after"] > 0
    assert 10_000 <= seen["looked at"] < 20_000, "of 110,000"


def test_linear_algebra_takes_one_thread_unless_somebody_wants_more() -> None:
    for given, used in (({}, "1"), ({BLAS_THREADS: "3"}, "3")):
        environment: dict[str, str] = {**given}
        use_one_blas_thread(environment)
        assert environment == {BLAS_THREADS: used}
