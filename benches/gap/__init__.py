"""The blind benchmark of `imucal.find_gap`: `make gap-benchmark`, to docs/results/gap.md and gap.json.

sizes      how large an effect must be to be seen, and how large it usually is
scene      how a recording is made: motion, unit, temperature, columns
case       a hidden case, and the seal on its answer
named      cases with effects of the catalogue: one, pairs, confounded, aliases
outside    cases with effects that the catalogue does not have, or has in another form
noise      clean runs, with noise that keeps to the model and noise that does not
faults     cases whose data are spoilt
said       what a tool answered, in one form for all tools
loop       the advised motion, simulated, and the question asked again
baselines  the textbook ways, on the same cases
limits     the detection limits, predicted by differences of simulated runs
judge      opens the answer and compares
rates      rates with their confidence intervals
page       the table
"""
