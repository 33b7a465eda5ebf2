"""Entry point of ``python -m radioloc``."""

import sys

from radioloc.cli import main

sys.exit(main())
