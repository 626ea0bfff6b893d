"""From goals to verified motions."""

import os

# Matrices here are small and plans run in parallel: threads within one multiplication would only compete. numpy reads
# this once, when it is first imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
