"""Names of contacts, as in results and contacts.csv: "ground", its part "ground: foot", and "self_contact: a, b" of two parts."""

# before the part, or the two: such contacts have rows only while they touch
PAIR = ": "


def of_part(obstacle: str, part: str) -> str:
    """Name of a part's contact with an obstacle."""
    return f"{obstacle}{PAIR}{part}"


def pair_name(one: str, other: str) -> str:
    """Name of the contact of two parts."""
    return f"self_contact{PAIR}{one}, {other}"
