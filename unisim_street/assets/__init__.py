"""Assets that a street is built of: houses, vehicles, furniture and the road, as solids and as triangles."""
