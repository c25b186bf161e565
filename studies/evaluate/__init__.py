"""The value of a design: shapes, derivatives, errors of manufacture, schedules, insertions."""
