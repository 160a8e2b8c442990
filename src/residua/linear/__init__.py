"""Linear systems as values, and the matrix and pencil algorithms that SciPy lacks."""

from residua.linear.rank import DEFAULT_RTOL, RankDecision, decide_rank
from residua.linear.sampling import sample
from residua.linear.state_space import StateSpace

__all__ = ["DEFAULT_RTOL", "RankDecision", "StateSpace", "decide_rank", "sample"]
