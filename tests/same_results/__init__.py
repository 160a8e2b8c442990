"""What the package answers, as hashes, for two states of its source to be compared."""

import os

# Before NumPy is imported: the order in which products are summed must not depend on the number of threads.
for _library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")
