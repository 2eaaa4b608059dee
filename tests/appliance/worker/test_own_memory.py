"""The compiler's library leaves the worker's memory when all kernels are loaded, and compiles all the same when it is needed again."""

from __future__ import annotations

import subprocess
import sys

from appliance.worker.own_memory import COMPILER, unwritten

PROGRAM = """
from pathlib import Path
import llvmlite.binding as llvm
from appliance.worker.own_memory import give_back_memory

def compiled():
    module = llvm.parse_assembly("define i32 @f(i32 %a) { %b = mul i32 %a, 7  ret i32 %b }")
    machine = llvm.Target.from_default_triple().create_target_machine(opt=3)
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(3))
    builder.getModulePassManager().run(module, builder)
    return machine.emit_object(module)

def file_mb():
    status = Path("/proc/self/status").read_text()
    return int(next(line.split()[1] for line in status.splitlines() if line.startswith("RssFile"))) / 1000

llvm.initialize_native_target()
llvm.initialize_native_asmprinter()
first = compiled()
before = file_mb()
give_back_memory()
after = file_mb()
print(before - after, compiled() == first)
"""
SMAPS = """\
7f00000000-7f00003000 r-xp 00001000 fe:00 12 /opt/lib/{name}
Size:                 12 kB
Rss:                  12 kB
Anonymous:             0 kB
7f00003000-7f00004000 r--p 00004000 fe:00 12 /opt/lib/{name}
Anonymous:             4 kB
7f00004000-7f00005000 rw-p 00005000 fe:00 12 /opt/lib/{name}
Anonymous:             0 kB
7f00005000-7f00006000 r-xp 00001000 fe:00 13 /opt/lib/other.so
Anonymous:             0 kB
7f00006000-7f00007000 r-xp 00000000 00:00 0
Anonymous:             0 kB
7f00007000-7f00009000 r--p 00006000 fe:00 12 /opt/lib/{name}
Anonymous:             0 kB
"""


def test_pages_of_the_compiler_go_and_come_back() -> None:
    ran = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=60.0, check=False)
    assert ran.returncode == 0, ran.stderr
    freed_mb, same = ran.stdout.split()
    assert float(freed_mb) > 10.0
    assert same == "True"


def test_only_what_is_as_the_file_has_it_is_forgotten() -> None:
    """The loader writes addresses into some pages, and takes the right to write away afterwards."""
    parts = list(unwritten(SMAPS.replace("{name}", COMPILER), COMPILER))
    assert parts == [(0x7F00000000, 0x7F00003000), (0x7F00007000, 0x7F00009000)]


HUNGRY = """
import numpy as np
from multiprocessing.shared_memory import SharedMemory
from appliance.worker.own_memory import limit_memory
limit_memory(100.0)
shared = SharedMemory(create=True, size=300_000_000)
shared.buf[:10] = bytes(10)
shared.close()
shared.unlink()
some = np.ones(50_000_000, np.uint8)
try:
    np.ones(200_000_000, np.uint8)
except MemoryError:
    print("refused")
"""


def test_the_kernel_refuses_what_is_out_of_proportion_but_not_what_is_shared() -> None:
    ran = subprocess.run([sys.executable, "-c", HUNGRY], capture_output=True, text=True, timeout=100, check=True)
    assert ran.stdout.strip() == "refused", ran.stderr
