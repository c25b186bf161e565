"""Content of a report of a study, gathered from its folder and its storage: plain data, which viz.sheet draws and writes."""

from magmpm.studies.sheet.facts import gather

__all__ = ["gather"]
