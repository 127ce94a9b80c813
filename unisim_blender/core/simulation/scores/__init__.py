"""Scores of a finished rollout: what happened to the ego vehicle, how it drove, and how much of it is evidence.

Every score is a pure function of a `record.Record`. `summary.summarise` computes all of them. A score that cannot be
computed is None beside a reason.
"""
