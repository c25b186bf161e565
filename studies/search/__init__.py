"""What is searched: parameters, limits of manufacture, and the checks of a study against its scene."""
