"""Concealed cases: a machine, its campaign and one thing more than model (17) knows, drawn from a seed and sealed.

    python -m simulators.concealed --seed N --machine pps --effect backlash --size 1.0 --out CASE --sealed SAFE

The case folder holds what a site would hand over (machine.yaml, recording.csv, held_out.csv) and the seal: the SHA-256
of the truth, which lies in another folder. Every effect has formulas of its own here, restated from the mechanics and
computed step by step through the campaign; at least one form of each is not the one in textbooks. Nothing is imported
from the model that is to find them.

Known limitations, of all cases that are written to a folder (live.py says its own)
  - The machine below the effect is simulators/plant.py's, with its limitations: elasticity is linear and taken in the
    undeflected pose, nothing grows or creeps but by the effect, encoders repeat to 0.1 µm or µrad and do not err.
  - Effects do not act on each other: each looks at commands, encoders and nominal poses, and what they displace is
    added up. A joint with play and friction has both, one beside the other.
  - The path between two visits is straight, and a joint comes from the side that its last move says; visits are 60 to
    110 s apart however far they are, so a pause says nothing of the way.
  - The same three reflectors are seen at every visit: no beam is lost, no visit is wrong unless `outliers` makes it so.
  - Scatter is normal, independent from joint to joint, and the same everywhere unless `unsettled` or `--remembers`
    makes it otherwise; the tracker's noise is alike in all directions at any distance.
  - Two kinds of machine only, a positioner and an arm with a spherical wrist; thermometers stand in the air and at one
    rail. How slow, how wide and how many anything is are our guesses; how large, whoever asks says.
"""
