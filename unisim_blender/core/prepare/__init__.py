"""From what a scenario or a command line names to what is rendered: drives, frames, sensors, renderers."""
