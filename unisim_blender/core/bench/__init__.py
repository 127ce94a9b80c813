"""Run time against error, measured side by side in one run.

settings.py     how large, how often
methods.py      what renders: tracer, quality, instruction set, threads
shot.py         one render, and what came of it
copies.py       actors copied in front of a camera or behind it, to see what they cost
process.py      a process that renders, with an environment of its own
cases.py        what is measured: shots that take turns
measure.py      the rounds
errors.py       how far images and depths are from the truth
figures.py      takes to figures
pareto.py       what nothing else beats
machine.py      where it was measured
tables.py plots.py report.py    figures to files
run.py          all of it, from paths to files
"""
