"""PandaSet's logs that the paper measured on, by name."""

from __future__ import annotations

SPLITS: dict[str, tuple[str, ...]] = {
    "seed10": ("001", "011", "016", "028", "053", "063", "084", "106", "123", "158"),
    "seed24": (
        *("001", "011", "013", "016", "017", "028", "029", "032", "053", "054", "063", "065"),
        *("068", "072", "084", "086", "090", "103", "106", "110", "112", "115", "123", "158"),
    ),
}
"""``seed10``: image metrics (063 is at night, 028 has no actors); ``seed24``: validation of perception. Even frames train, odd
frames test."""

TEST_FRAMES = "1::2"
