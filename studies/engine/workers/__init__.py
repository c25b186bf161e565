"""Several trials at once: processes that solve, sessions that share a storage, and samplers that know what is running."""
