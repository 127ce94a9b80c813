"""The ego's trajectory: how well sweeps agree under it, its refinement by the sweeps, and logs on a refined one."""
