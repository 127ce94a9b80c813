"""An autonomy stack of detectors, a tracker, forecasts and a lattice planner, as a driver of `unisim drive`."""
