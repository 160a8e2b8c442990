"""Linear systems as values, and the matrix and pencil algorithms that SciPy lacks."""

from residua.facade import hand_on

hand_on(__name__)
