"""One linear-algebra thread for the program; import this before numpy. A user's own setting is kept.

Measured on two cores, identification of 700 visits: 3.4 s with one thread or two, at half the processor time with one;
and with another program on the same cores two threads wait for each other (45 s were seen).
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
