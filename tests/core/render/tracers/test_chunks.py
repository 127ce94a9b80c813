"""Chunks of rays: each ray is taken once, in order, and a device whose memory does not suffice takes fewer at a time."""

from __future__ import annotations

import pytest
import torch

from unisim_blender.core.render.tracers.torch.tracer import MIN_CHUNK_RAYS, in_chunks


def test_chunks_are_halved_where_memory_does_not_suffice() -> None:
    tried, taken = [], []

    def take(begin: int, end: int) -> None:
        tried.append(end - begin)
        if end - begin > 2 * MIN_CHUNK_RAYS:
            raise torch.cuda.OutOfMemoryError("CUDA out of memory")
        taken.append((begin, end))

    in_chunks(9 * MIN_CHUNK_RAYS + 5, 8 * MIN_CHUNK_RAYS, take)
    assert [end - begin for begin, end in taken] == [2 * MIN_CHUNK_RAYS] * 4 + [MIN_CHUNK_RAYS + 5]
    assert [begin for begin, _ in taken[1:]] == [end for _, end in taken[:-1]] and taken[0][0] == 0
    assert tried[:2] == [8 * MIN_CHUNK_RAYS, 4 * MIN_CHUNK_RAYS] and len(tried) == len(taken) + 2


def test_no_memory_for_the_least_is_told() -> None:
    def take(begin: int, end: int) -> None:
        raise torch.cuda.OutOfMemoryError("CUDA out of memory")

    with pytest.raises(torch.cuda.OutOfMemoryError):
        in_chunks(100, 8 * MIN_CHUNK_RAYS, take)


def test_no_rays_make_no_chunk() -> None:
    none = list[tuple[int, int]]()
    in_chunks(0, 10, lambda begin, end: none.append((begin, end)))
    assert none == [(0, 0)], "no rays are a chunk, so that their result has its shape"
