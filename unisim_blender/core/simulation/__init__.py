"""The closed loop: a vehicle that a driver steers through a trained scene, sensors that answer it, actors that react."""
