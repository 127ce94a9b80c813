"""The report of a batch: one page of HTML with its variants, their images and scores, and filters over parameters."""
