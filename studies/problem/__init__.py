"""Study files: keys, defaults, checks of each value; and the names of a study's files.

Light: who only asks whether a folder holds a study does not import Optuna.
"""

REPORT = "study.json"
TARGET = "target.csv"  # what the body is compared with
DATABASE = "study.db"
OWNER = "study-name.txt"
# stability below which a design is on the brink: it is reported, and another of nearly the same rms
# takes its place
STABILITY_AT_BRINK = 0.1
