"""`python -m magmpm` is the `magmpm` command."""

import runpy

if __name__ == "__main__":  # processes that it starts import it again
    runpy.run_module("magmpm.cli", run_name="__main__")
