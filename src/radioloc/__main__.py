"""The program ``radioloc``, and ``python -m radioloc``."""

import atexit
import ctypes
import gc
import os
import sys
from contextlib import suppress

# Linear algebra runs on one thread: a second pool of waiting threads takes an eighth of the time of a small study.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Linux returns freed memory, and faults in each page of the next array: a tenth of the time of large studies.
with suppress(AttributeError, OSError, TypeError):  # C libraries other than GNU's
    for option, limit_bytes in ((-3, 2**25), (-1, 2**29)):  # M_MMAP_THRESHOLD, M_TRIM_THRESHOLD of mallopt(3)
        ctypes.CDLL(None).mallopt(option, limit_bytes)

from radioloc.cli import main

# The last collection, of objects that the end of the process frees anyway, takes a tenth of that time.
atexit.register(gc.freeze)

if __name__ == "__main__":
    sys.exit(main())
