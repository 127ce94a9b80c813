"""Operations of the renderer and the training: torch references, and the choice of the kernels that stand in for them."""
