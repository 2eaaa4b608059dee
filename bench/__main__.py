"""``python -m bench [--list | names]``: runs the benchmarks and writes ``bench/out/<name>.json``."""

from __future__ import annotations

import sys

from bench.runner import main

sys.exit(main(sys.argv[1:]))
