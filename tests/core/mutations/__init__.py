"""Files with random faults, and what reads them: a reader gives what it reads or raises `UnisimError` in one sentence, soon.

`test_mutations.py` runs a few inputs of each; `python tests/core/mutations/run.py --count 100000` many. Own code, for faults must
be of a file's structure (a key gone, a number too large, an array one-dimensional), and every input must end within a time.
"""
