"""Which names of scenes and studies can be names of folders, on any system: results go to runs/NAME."""

from __future__ import annotations

FORBIDDEN = frozenset('/\\<>:"|?*')
RESERVED = frozenset(  # names of devices on Windows, with any ending
    {"con", "prn", "aux", "nul", *(f"{port}{k}" for port in ("com", "lpt") for k in range(1, 10))}
)
LONGEST = 100  # characters


def folder_fault(name: str) -> tuple[str, str] | None:
    """Rule and remedy where a name can't be a folder's; else None."""
    rule = "must be usable as the name of a folder"
    bad = sorted({c for c in name if c in FORBIDDEN})
    odd = sorted({c for c in name if not c.isprintable()})
    if bad or odd:
        found = ", ".join([*bad, *(f"U+{ord(c):04X}" for c in odd)])
        return rule, (
            f"leave out {found}: letters of any script, digits, spaces and all signs but {' '.join(sorted(FORBIDDEN))} can be used, "
            "and no line breaks, tabs or other characters that can't be printed"
        )
    if not name.strip() or name != name.strip():
        return rule, "begin and end it with something other than a space"
    if name.startswith(".") or name.endswith("."):
        return rule, "begin and end it with something other than a dot: such a folder is hidden, another one, or lost on some systems"
    if name.split(".")[0].strip().lower() in RESERVED:
        return rule, f"choose another name: {name.split('.')[0]} is a device on Windows"
    if len(name) > LONGEST:
        return f"{rule}, of at most {LONGEST} characters", "shorten it"
    return None
