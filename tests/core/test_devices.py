"""How many threads torch and the kernels take."""

from __future__ import annotations

import pytest
import torch

from unisim_blender.core.devices import kernel_threads, torch_threads


def test_the_kernels_keep_their_threads_where_torch_gives_them_up() -> None:
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(3)
        assert kernel_threads() == 3
        with torch_threads(1):
            assert (torch.get_num_threads(), kernel_threads()) == (1, 3)
            with torch_threads(None):
                assert (torch.get_num_threads(), kernel_threads()) == (3, 3)
            assert (torch.get_num_threads(), kernel_threads()) == (1, 3)
        with pytest.raises(ZeroDivisionError), torch_threads(2):
            _ = 1 / 0
        assert (torch.get_num_threads(), kernel_threads()) == (3, 3)
    finally:
        torch.set_num_threads(before)
