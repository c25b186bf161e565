"""Search of a study: parameters, limits of manufacture, and the checks of a study against its scene."""
