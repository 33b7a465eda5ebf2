"""``python -m radioloc``, the same as ``radioloc``."""

import sys

from radioloc.cli import main

sys.exit(main())
