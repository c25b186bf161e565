"""The external magnetic field: its sources, schedules and evaluation."""
