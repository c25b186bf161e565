"""`python -m magmpm.cli` is `magmpm`."""

import sys

from magmpm.cli.main import main

sys.exit(main())
