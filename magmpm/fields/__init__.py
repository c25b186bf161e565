"""The outside magnetic field: its sources, schedules and evaluation."""
