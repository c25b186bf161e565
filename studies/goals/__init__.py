"""Design of anything that can be simulated: any number of a scene, any measure of its answer, any goal; and sweeps of values."""
