"""Operations of the renderer and the training, on torch's tensors.

An operation that has kernels is a module: its function for everybody, the same in plain torch (`*_reference`) and by
the compiled kernels (`*_compiled`), the CPU's or, launched by `gpu`, a GPU's; `dispatch` chooses between them.
"""
