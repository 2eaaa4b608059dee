"""Compile every kernel of the product and of the simulator, as ``./dev`` does before tests and benchmarks.

    python -m bench.kernels

Else each process that needs a kernel would compile it for itself, the reconstruction's worker while a test waits for it.
"""

from __future__ import annotations

import sys

from appliance.cli.kernels import compile_kernels
from appliance.cli.output import log_lines
from appliance.cli.simrig import simulator_kernels


def main() -> int:
    """Compile the missing kernels, with progress on stderr."""
    with log_lines(as_json=False, service=False):
        compile_kernels(simulator_kernels)
    return 0


if __name__ == "__main__":
    sys.exit(main())
