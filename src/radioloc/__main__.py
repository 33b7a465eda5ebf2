"""The program ``radioloc``, and ``python -m radioloc``."""

import atexit
import gc
import os
import sys

# Linear algebra runs on one thread: a second pool of waiting threads takes an eighth of the time of a small study.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from radioloc.cli import main

# The last collection, of objects that the end of the process frees anyway, takes a tenth of that time.
atexit.register(gc.freeze)

if __name__ == "__main__":
    sys.exit(main())
