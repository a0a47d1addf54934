"""Campaign design: which poses under which loads, in which order, tell most about a machine in the least time.

    belief.py       what is believed before the first visit: the model, how large its parameters may be, the noise
    loads.py        what the machine carries in its work, and which few load cases show it
    information.py  what visits would teach: the posterior covariance and its exact updates
    choose.py       greedy choice and exchange, least mean error variance at a point of interest (I-optimal)
    order.py        the order of the visits: shortest travel
    bound.py        no order can be shorter than this
    designer.py     all of it together: from a number of visits, or an accuracy, to a campaign
    sequential.py   the same after a recording: what is known now, what to measure next, when to stop
    write.py        the campaign script

docs/design.md.
"""
