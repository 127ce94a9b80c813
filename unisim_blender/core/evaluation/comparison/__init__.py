"""Methods side by side: trained within one budget, rendered, and measured against the same truth."""
