"""Operations of the renderer and the training, on torch's tensors.

An operation that has kernels is a package: its function of the same interface for everybody in ``__init__.py``, plain
torch in ``reference.py``, the compiled kernels in ``compiled.py``, Triton's in ``gpu.py``; `dispatch` chooses between
them. What is plain torch alone is a module.
"""
