"""What numerical stability is held to: cases at the ends of what numbers can be, each with its error against
float64 and a bound.

`test_stress.py` runs them small, `benchmarks/stability.py` at full size. The truth is torch's own modules in float64,
or plain numpy; never the code under test.
"""
