"""One recording of the procedural street, written in several layouts by the writers that readers are tested with."""
