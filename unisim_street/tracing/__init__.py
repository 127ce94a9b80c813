"""First hits of rays: shapes, bundles of rays, and what was hit."""
