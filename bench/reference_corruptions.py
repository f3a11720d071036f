"""Time the benchmark authors' corruptions for `bench/corruptions.py --reference`.

The script runs in a clone of their code, in a Python environment with its dependencies. It reads lines "NAME
SEVERITY" from standard input, and answers each line with the CPU milliseconds for the pair in PAIR.npy, or with "-" if
their code lacks the corruption or fails.
"""

import io
import os
import sys
import time
from contextlib import redirect_stdout

import numpy as np


def main() -> None:
    sys.path.insert(0, os.getcwd())
    from utils.image_corruptions import get_corruption  # type: ignore[import-not-found]

    pair = np.load(sys.argv[1])
    for line in sys.stdin:
        name, severity = line.split()
        try:
            with redirect_stdout(io.StringIO()):
                start = time.process_time()
                get_corruption(name, int(severity))(*pair)
                answer = f"{1e3 * (time.process_time() - start):.3f}"
        except Exception as error:  # a corruption that their code cannot compute here must not stop the others
            print(f"{name} at severity {severity}: {error}", file=sys.stderr)
            answer = "-"
        print(answer, flush=True)


if __name__ == "__main__":
    main()
