"""Facts and lines of objects for panels and 3D views: cards, tables, trails, LiDAR points, portraits."""
