"""Run time against error, measured side by side in one run.

settings.py     how large, how often
methods.py      what renders: tracer, quality, instruction set, threads
render_request.py   one render, and its measurement
copies.py       actors copied in front of a camera or behind it, to see what they cost
state_cost.py   what a state of many actors costs before a ray is traced
process.py      a process that renders, with an environment of its own
cases.py        what is measured: render requests that take turns
measure.py      the rounds
errors.py       how far images and depths are from the truth
machine.py      where it was measured
report/         measurements to metrics, tables, plots and files
run.py          all of it, from paths to files
"""
