"""Eighteen kinds of plants of small order, seeded, in small fractions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from random import Random

from exact_campaign.cases import Case, Rows

#: Faults of a plant: all rows of a structure are asked for.
MOST_FAULTS = 5

Maker = Callable[[Random], "Draft"]


@dataclass(frozen=True)
class Draft:
    """What a kind decides; the rest is drawn the same way for all."""

    A: Rows
    C: Rows
    E: Rows | None = None
    sampled: bool | None = None
    feedthrough: bool = False
    disturbances: int | None = None
    dependent: bool = False
    Bd: Rows | None = None


def case_of(kind: str, seed: int) -> Case:
    """Return the plant of a kind and a seed."""
    rng = Random(f"{kind}/{seed}")
    draft = KINDS[kind](rng)
    n, p = len(draft.A), len(draft.C)
    sampled = rng.random() < 0.5 if draft.sampled is None else draft.sampled
    m = rng.randint(0, 2) if rng.random() < 0.3 else rng.randint(1, 2)
    q = rng.choice([0, 1, 1, 2]) if draft.disturbances is None else draft.disturbances
    k = rng.randint(1, 3)
    through = draft.feedthrough or rng.random() < 0.15
    Bu, Du = _columns(rng, n, p, m, through)
    Bd, Dd = _columns(rng, n, p, q, through)
    if draft.Bd is not None:
        Bd, Dd, q = draft.Bd, [[Fraction(0)] * len(draft.Bd[0]) for _ in range(p)], len(draft.Bd[0])
    Bf, Df = _columns(rng, n, p, k, through)
    if draft.dependent:
        Bf, Df, Bd, Dd = _with_dependence(rng, Bf, Df, Bd, Dd)
    A = [[x / 4 for x in row] for row in draft.A] if sampled and draft.sampled is None else draft.A
    sensors = tuple(i for i in range(p) if rng.random() < 0.4)[: MOST_FAULTS - len((Bf + Df)[0])]
    actuators = tuple(i for i in range(m) if rng.random() < 0.4 and any(row[i] for row in Bu + Du))
    actuators = actuators[: MOST_FAULTS - len((Bf + Df)[0]) - len(sensors)]
    case = Case(kind, seed, A, Bu, draft.C, Du, Bd, Dd, Bf, Df, draft.E, 0.5 if sampled else 0.0, sensors, actuators)
    return _without_nothing(case)


def _without_nothing(case: Case) -> Case:
    """Leave out disturbances and faults that do nothing: a plant refuses them."""

    def kept(B: Rows, D: Rows) -> tuple[Rows, Rows]:
        width = len((B + D)[0]) if B + D else 0
        columns = [j for j in range(width) if any(row[j] for row in B + D)]
        return [[row[j] for j in columns] for row in B], [[row[j] for j in columns] for row in D]

    Bd, Dd = kept(case.Bd, case.Dd)
    Bf, Df = kept(case.Bf, case.Df)
    sensors = case.sensors or (() if case.actuators or Df[0] else (0,))  # at least one fault
    return replace(case, Bd=Bd, Dd=Dd, Bf=Bf, Df=Df, sensors=sensors)


def _entries(rng: Random, rows: int, columns: int, density: float = 1.0, most: int = 3) -> Rows:
    return [
        [Fraction(rng.randint(-most, most) if rng.random() < density else 0) for _ in range(columns)]
        for _ in range(rows)
    ]


def _columns(rng: Random, n: int, p: int, count: int, through: bool) -> tuple[Rows, Rows]:
    """Return directions of inputs: dense or of few entries; into the outputs too where things pass through."""
    B = _entries(rng, n, count, rng.choice([1.0, 0.5]))
    D = _entries(rng, p, count, 0.4) if through or n == 0 else [[Fraction(0)] * count for _ in range(p)]
    for j in range(count):
        if n and not any(row[j] for row in B) and not any(row[j] for row in D):
            B[rng.randrange(n)][j] = Fraction(1)
    return B, D


def _with_dependence(rng: Random, Bf: Rows, Df: Rows, Bd: Rows, Dd: Rows) -> tuple[Rows, Rows, Rows, Rows]:
    """Let a fault be a multiple of another, or of a disturbance, and a disturbance a sum of others."""
    twice = Fraction(rng.choice([-2, 2, 3]))
    for row in Bf + Df:
        row.append(twice * row[0])
    if Bd and Bd[0] and rng.random() < 0.5:
        for G in (Bd, Dd):
            for row in G:
                row.append(sum(row, Fraction(0)))
    if Bd and Bd[0] and rng.random() < 0.5:
        for F, G in ((Bf, Bd), (Df, Dd)):
            for row, other in zip(F, G, strict=True):
                row.append(twice * other[0])
    return Bf, Df, Bd, Dd


def _outputs(rng: Random, n: int, least: int = 1, most: int = 4) -> Rows:
    """Return outputs: single states, or combinations."""
    p = rng.randint(least, most)
    if rng.random() < 0.4 and n:
        C = [[Fraction(0)] * n for _ in range(p)]
        for row in C:
            row[rng.randrange(n)] = Fraction(1)
        return C
    C = _entries(rng, p, n, rng.choice([1.0, 0.6]))
    for row in C:
        if n and not any(row):
            row[rng.randrange(n)] = Fraction(1)
    return C


def _order(rng: Random, least: int = 1) -> int:
    return rng.randint(least, 6)


def _dense(rng: Random) -> Draft:
    n = _order(rng)
    return Draft(_entries(rng, n, n), _outputs(rng, n))


def _sparse(rng: Random) -> Draft:
    n = _order(rng, 2)
    A = _entries(rng, n, n, 1.6 / n)
    for i in range(n):
        A[i][i] -= rng.choice([0, 1, 2])
    return Draft(A, _outputs(rng, n))


def _companion(rng: Random) -> Draft:
    n = _order(rng, 2)
    A = [[Fraction(int(j == i + 1)) for j in range(n)] for i in range(n)]
    A[-1] = [Fraction(rng.randint(-5, 5)) for _ in range(n)]
    return Draft(A, _outputs(rng, n))


def _stiff(rng: Random) -> Draft:
    n = _order(rng, 2)
    A = _entries(rng, n, n, 0.6)
    rates = [Fraction(2) ** rng.randint(-10, 10) for _ in range(n)]
    return Draft([[rates[i] * x for x in row] for i, row in enumerate(A)], _outputs(rng, n), sampled=False)


def _integrators(rng: Random) -> Draft:
    n = _order(rng, 1)
    A = [[Fraction(rng.choice([1, 1, 2]) if j == i + 1 else 0) for j in range(n)] for i in range(n)]
    for i in range(n - 1):
        if rng.random() < 0.2:
            A[i][i + 1] = Fraction(0)
    sampled = rng.random() < 0.4
    if sampled:
        for i in range(n):
            A[i][i] = Fraction(1)
    return Draft(A, _outputs(rng, n, 1, 3), sampled=sampled)


def _delays(rng: Random) -> Draft:
    n = _order(rng, 2)
    A = [[Fraction(int(j == i - 1)) for j in range(n)] for i in range(n)]
    lag = rng.randrange(n)
    A[0][0] = Fraction(rng.choice([0, 1, 3]), 4)
    A[lag][lag] += Fraction(rng.choice([0, 0, 1]), 2)
    return Draft(A, _outputs(rng, n), sampled=True)


def _dead_sensors(rng: Random) -> Draft:
    n = _order(rng)
    C = _outputs(rng, n, 2, 4)
    C[rng.randrange(len(C))] = [Fraction(0)] * n
    return Draft(_entries(rng, n, n, 0.7), C)


def _duplicated_sensors(rng: Random) -> Draft:
    n = _order(rng)
    C = _outputs(rng, n, 1, 3)
    C.append([Fraction(rng.choice([-1, 1, 1, 2])) * x for x in C[rng.randrange(len(C))]])
    return Draft(_entries(rng, n, n, 0.7), C)


def _feedthrough(rng: Random) -> Draft:
    n = _order(rng)
    return Draft(_entries(rng, n, n, 0.7), _outputs(rng, n, 1, 4), feedthrough=True)


def _in_other_coordinates(rng: Random, A: Rows, C: Rows) -> tuple[Rows, Rows]:
    """Return a pair in coordinates that are whole combinations of the old ones, and back."""
    n = len(A)
    for _ in range(n):
        i, j, k = rng.randrange(n), rng.randrange(n), Fraction(rng.choice([-1, 1]))
        if i == j:
            continue
        A[i] = [a + k * b for a, b in zip(A[i], A[j], strict=True)]  # x_i + k x_j instead of x_i
        for row in A + C:
            row[j] -= k * row[i]
    return A, C


def _repeated_poles(rng: Random) -> Draft:
    n = _order(rng, 2)
    pole = Fraction(rng.choice([-2, -1, -1, 0, 1]))
    A = [[pole if i == j else Fraction(0) for j in range(n)] for i in range(n)]
    for i in range(n - 1):
        A[i][i + 1] = Fraction(rng.choice([0, 1, 1]))
    A, C = _in_other_coordinates(rng, A, _outputs(rng, n))
    return Draft(A, C)


def _no_states(rng: Random) -> Draft:
    return Draft([], [[] for _ in range(rng.randint(1, 4))])


def _many_outputs(rng: Random) -> Draft:
    n = _order(rng, 1) if rng.random() < 0.3 else rng.randint(1, 3)
    return Draft(_entries(rng, n, n, 0.8), _outputs(rng, n, n + 1, n + 2))


def _singular(rng: Random) -> Draft:
    n = _order(rng, 2)
    r = rng.randint(0, n - 1)
    while True:
        E = [[Fraction(0)] * n for _ in range(n)]
        for i in range(r):
            E[i][i] = Fraction(rng.choice([1, 1, 2]))
        A = _entries(rng, n, n, 0.8)
        if rng.random() < 0.5:
            for _ in range(2):
                i, j = rng.randrange(n), rng.randrange(n)
                if i != j:
                    E[i] = [a + b for a, b in zip(E[i], E[j], strict=True)]
                    A[i] = [a + b for a, b in zip(A[i], A[j], strict=True)]
        if _is_regular(E, A):
            return Draft(A, _outputs(rng, n), E)


def _is_regular(E: Rows, A: Rows) -> bool:
    """Tell whether ``det(sE - A)`` is not zero for every ``s``."""
    M = [[a - 1237 * e for a, e in zip(x, y, strict=True)] for x, y in zip(A, E, strict=True)]
    n = len(M)
    for c in range(n):
        pivot = next((i for i in range(c, n) if M[i][c]), None)
        if pivot is None:
            return False
        M[c], M[pivot] = M[pivot], M[c]
        for i in range(c + 1, n):
            factor = M[i][c] / M[c][c]
            M[i] = [a - factor * b for a, b in zip(M[i], M[c], strict=True)]
    return True


def _hidden_modes(rng: Random) -> Draft:
    n = _order(rng, 2)
    seen = rng.randint(1, n - 1)
    A = _entries(rng, n, n, 0.8)
    C = _outputs(rng, n)
    for i in range(seen):
        for j in range(seen, n):
            A[i][j] = Fraction(0)
    for i in range(seen, n):
        A[i][i] -= rng.choice([0, 3, 6])
    for row in C:
        for j in range(seen, n):
            row[j] = Fraction(0)
    A, C = _in_other_coordinates(rng, A, C)
    return Draft(A, C)


def _oscillators(rng: Random) -> Draft:
    n = rng.choice([2, 4, 6])
    A = [[Fraction(0)] * n for _ in range(n)]
    sampled = rng.random() < 0.4
    for i in range(0, n, 2):
        w = Fraction(rng.randint(1, 4))
        if sampled:
            c, s = rng.choice(
                [(Fraction(0), Fraction(1)), (Fraction(1, 2), Fraction(1, 2)), (Fraction(1, 2), Fraction(3, 4))]
            )
            A[i][i], A[i][i + 1], A[i + 1][i], A[i + 1][i + 1] = c, s, -s, c
        else:
            A[i][i + 1], A[i + 1][i] = w, -w
        if i and rng.random() < 0.6:
            A[i - 1][i] = Fraction(1)
    return Draft(A, _outputs(rng, n, 1, 3), sampled=sampled)


def _planted_zeros(rng: Random) -> Draft:
    """Return a plant with a zero at a chosen place: a disturbance reaches the outputs through it."""
    n = _order(rng, 2)
    A = _entries(rng, n, n, 0.8)
    p = rng.randint(1, 3)
    sampled = rng.random() < 0.4
    zero = Fraction(rng.choice([-2, -1, 0, 0, 1, 2])) if not sampled else Fraction(rng.choice([0, 1, 1, 2, 4]), 2)
    A = [[x / 4 for x in row] for row in A] if sampled else A
    # the vector of ones is in the kernel of C and (A - zero I) 1 is the disturbance
    b = [[sum(row, Fraction(0)) - zero] for row in A]
    C = _entries(rng, p, n)
    for row in C:
        row[-1] -= sum(row, Fraction(0))
        if not any(row):
            row[0], row[-1] = Fraction(1), row[-1] - 1
    if not any(row[0] for row in b):
        b[0][0] = Fraction(1)
    return Draft(A, C, sampled=sampled, Bd=b)


def _used_up(rng: Random) -> Draft:
    n = _order(rng, 2)
    C = _outputs(rng, n, 1, 3)
    return Draft(_entries(rng, n, n, 0.8), C, disturbances=max(1, len(C) + rng.choice([-1, 0, 0])))


def _alike_directions(rng: Random) -> Draft:
    n = _order(rng, 2)
    return Draft(_entries(rng, n, n, 0.7), _outputs(rng, n, 1, 4), dependent=True)


#: The kinds by name, in the order of the tables.
KINDS: dict[str, Maker] = {
    "dense": _dense,
    "sparse": _sparse,
    "companion": _companion,
    "stiff": _stiff,
    "integrators": _integrators,
    "delays": _delays,
    "dead sensors": _dead_sensors,
    "duplicated sensors": _duplicated_sensors,
    "feedthrough": _feedthrough,
    "repeated poles": _repeated_poles,
    "no states": _no_states,
    "more outputs than states": _many_outputs,
    "singular E": _singular,
    "hidden modes": _hidden_modes,
    "oscillators": _oscillators,
    "planted zeros": _planted_zeros,
    "used-up measurements": _used_up,
    "alike directions": _alike_directions,
}
