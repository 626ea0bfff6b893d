"""From goals to verified motions."""

import os

# Matrices here are small and plans run side by side: threads within one multiplication only get in each other's way.
# numpy reads this once, when it is first imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
