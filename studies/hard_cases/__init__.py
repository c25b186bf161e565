"""Hard cases: scenes at the edge of what the solvers can do.

Each is an object with its scene, what a weak code does there, a measure and its bound.
What they find is repaired in the solver, not in the case.

    for case in CASES:
        print(case.run().summary())
"""

from magmpm.studies.hard_cases.case import Case, Outcome, table
from magmpm.studies.hard_cases.suites import CASES, run_cases

__all__ = ["CASES", "Case", "Outcome", "run_cases", "table"]
