"""The page of a study: a sheet from which its best design can be made, as one HTML file, and as PDF where a printer is at hand.

Everything comes as plain data (studies.sheet) and files of pictures; every text is escaped, and nothing is loaded from elsewhere.
"""

from magmpm.viz.sheet.goal import goal_page
from magmpm.viz.sheet.whole import Pictures, PrintError, page, printed

__all__ = ["Pictures", "PrintError", "goal_page", "page", "printed"]
