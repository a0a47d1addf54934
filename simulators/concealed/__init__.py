"""Concealed cases: a machine, its campaign and one thing more than model (17) knows, drawn from a seed and sealed.

    python -m simulators.concealed --seed N --machine pps --effect backlash --size 1.0 --out CASE --sealed SAFE

The case folder holds what a site would hand over (machine.yaml, recording.csv, held_out.csv) and the seal: the SHA-256
of the truth, which lies in another folder. Every effect has formulas of its own here, restated from the mechanics and
computed step by step through the campaign; at least one form of each is not the one in textbooks. Nothing is imported
from the model that is to find them.
"""
