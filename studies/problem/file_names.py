"""Names of a study's files: light, so that who only asks whether a folder holds a study does not import Optuna."""

REPORT = "study.json"
DATABASE = "study.db"
OWNER = "study-name.txt"
