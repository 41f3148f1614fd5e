"""Planned and reached: `make plan` writes docs/results/plan.md and plan.svg.

* agreement: standard deviations that a plan predicts, over the errors of calibrations of simulated runs.
* duration: how long the shortest programs take that reach given standard deviations.
* curve: worst standard deviation over minutes, of the paper's programs and of optimal ones.
* page: the page and the figure.
"""
