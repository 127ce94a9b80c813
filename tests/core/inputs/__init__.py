"""Property tests of everything that reads files: broken input reads as a valid value or is refused in
one sentence, soon.

`faults.py` says what can be wrong with a file, `strategies.py` draws such faults with hypothesis, `promise.py` checks
what a reader does with them, `views.py` opens a file so that a fault is one of its structure (a key gone, an array
one-dimensional). The profile `few` runs a few fixed inputs of each reader; HYPOTHESIS_PROFILE=many (`make test-inputs`)
100 000 in all. Tests lie in rooms by what is read: `logs`, `datasets` (logs of other layouts), `scenes` (with scenarios
and meshes), `outputs` (and caches).
"""
