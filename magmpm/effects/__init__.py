"""The effects that can act on a body, one file each."""
