"""``python -m bench [--list | names]``: runs the benchmarks and writes ``bench/out/<name>.json``."""

from __future__ import annotations

import os
import sys

from appliance.base.process_start import use_one_blas_thread

# As in the product's own processes; NumPy reads it when it is imported, which the runner does.
use_one_blas_thread(os.environ)

from bench.runner import main  # noqa: E402

sys.exit(main(sys.argv[1:]))
