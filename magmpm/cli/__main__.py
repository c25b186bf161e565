"""`python -m magmpm.cli` is `magmpm`."""

import sys

from magmpm.cli import main

sys.exit(main())
