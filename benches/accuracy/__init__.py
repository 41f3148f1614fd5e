"""Monte Carlo accuracy over the theoretical bound: `make accuracy`.

scene         how a run is made: motion, unit, rate
bound         the Cramér-Rao bound, from the truth alone
trial         one run: simulated, calibrated, compared with the truth
faults        contaminated runs, and what is bad in them
naming        whether what is bad was named, and what was named that is not
band          bands of what a perfect estimator gives by chance
figures       many trials in numbers: RMSE, bias, coverage, chi2
contaminated  many contaminated runs in numbers
gates         what has to be reached, and whether it was
page          the tables
"""
