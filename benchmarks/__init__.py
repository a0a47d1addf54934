"""How fast, beside what: each command measures in one run and writes its table into docs/figures.md, section Speed.

    python -m benchmarks.peers        kinematics and a whole calibration against figaroh, pybotics, robotkinecal
    python -m benchmarks.identify     identification against bare LAPACK; growth with the number of visits
    python -m benchmarks.compensate   compensated setpoints, one by one and in bulk

How right: each prints what stands in docs/figures.md, in the section behind it.

    python -m benchmarks.coverage     Intervals
    python -m benchmarks.noise_forms  Forms of pose noise
    python -m benchmarks.designed     Designed campaigns
    python -m benchmarks.visibility   Visibility

`--short` runs each in seconds, to see that it runs, and writes nothing.
"""
