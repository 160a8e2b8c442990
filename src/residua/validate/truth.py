"""Simulated substitute of the real plant: its sampled matrices, with a controller if there is one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.errors import ModelError, SettingError
from residua.linear import StateSpace
from residua.linear.systems.recursion import run_filter
from residua.plant import Plant
from residua.robust.sets.uncertain_loop import fitting_controller
from residua.validate.shapes import LossOfEffectiveness, StuckAt

#: A plant whose deviations grow by more than this over a run is not one that runs by itself.
_MOST_GROWTH = 1e6


@dataclass(frozen=True, eq=False)
class Truth:
    r"""A sampled plant from its inputs to the recorded signals :math:`s = [u; y]`, as deviations.

    .. math:: x_{k+1} = A x_k + B z_k + B_f f_k, \qquad s_k = C x_k + D z_k + D_f f_k, \qquad z = [v; d; w]

    with what is added to the command :math:`v`, disturbances and noise. With a controller :math:`x_c` is part of the
    state, and :math:`u = C_c x_c + v`.

    Attributes
    ----------
    A, B, C, D, Bf, Df : ndarray
    inputs, disturbances, noises : int
        Columns of ``B`` for each.
    offset : ndarray, shape (channels,)
        Operating point of inputs and outputs.
    looped : bool
        True if there is a controller.
    faults : tuple of str
        The columns of ``Bf``.
    """

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    D: NDArray[np.float64]
    Bf: NDArray[np.float64]
    Df: NDArray[np.float64]
    inputs: int
    disturbances: int
    noises: int
    offset: NDArray[np.float64]
    looped: bool
    faults: tuple[str, ...]

    def respond(self, z: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the recorded signals for inputs of (runs, time, columns), from rest."""
        return run_filter(self.A, self.B, self.C, self.D, np.zeros((len(z), len(self.A))), z)[1]

    def respond_to_fault(self, fault: int, course: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the effect of a fault of (runs, time) on the recorded signals."""
        b, d = self.Bf[:, fault, None], self.Df[:, fault, None]
        return run_filter(self.A, b, self.C, d, np.zeros((len(course), len(self.A))), course[:, :, None])[1]


def truth_of(plant: Plant, dt: float, controller: StateSpace | None, samples: int) -> Truth:
    """Return the simulated plant, sampled, in the loop of a controller if there is one.

    Raises
    ------
    ModelError
        If the controller does not fit, or the plant is unstable over a run.
    """
    p = (plant if plant.is_discrete else plant.discretize(dt)).explicit()
    n, m = p.n_states, len(p.inputs)
    B = np.hstack([p.B, p.Bd, p.Bw])
    Dy = np.hstack([p.D, p.Dd, p.Dw])
    D = np.vstack([np.hstack([np.eye(m), np.zeros((m, B.shape[1] - m))]), Dy])
    A, C, Bf = p.A, np.vstack([np.zeros((m, n)), p.C]), p.Bf
    if controller is not None:
        c = fitting_controller(p, controller)
        A = np.block([[p.A, p.B @ c.C], [c.B @ p.C, c.A + c.B @ p.D @ c.C]])
        C = np.block([[np.zeros((m, n)), c.C], [p.C, p.D @ c.C]])
        B, Bf = np.vstack([B, c.B @ Dy]), np.vstack([Bf, c.B @ p.Df])
    Df = np.vstack([np.zeros((m, len(p.faults))), p.Df])
    radius = float(np.abs(np.linalg.eigvals(A)).max(initial=0.0))
    if radius > 1 and samples * np.log(radius) > np.log(_MOST_GROWTH):
        raise ModelError(
            f"plant {plant.name!r} is unstable (pole of size {radius:.6g}) and leaves all bounds within {samples} "
            "samples: give controller=, from y to u, that holds it"
        )
    point = p.operating_point
    offset = np.concatenate([point.inputs, point.outputs])
    matrices = {"A": A, "B": B, "C": C, "D": D, "Bf": Bf, "Df": Df}
    return Truth(
        **{name: np.ascontiguousarray(M) for name, M in matrices.items()},
        inputs=m,
        disturbances=len(p.disturbances),
        noises=p.Bw.shape[1],
        offset=offset,
        looped=controller is not None,
        faults=p.faults,
    )


@dataclass(frozen=True, eq=False)
class ActingFault:
    """A fault that holds or weakens the signal of a channel.

    Attributes
    ----------
    shape : StuckAt or LossOfEffectiveness
    size : float
    fault : int
        Number of the fault in the plant.
    channel : int
        Number of its signal among the inputs, then the outputs.
    """

    shape: StuckAt | LossOfEffectiveness
    size: float
    fault: int
    channel: int

    def added(
        self, signal: NDArray[np.float64], before: NDArray[np.float64], share: NDArray[np.float64], offset: float
    ) -> NDArray[np.float64]:
        """Return the effect of the fault on a signal (deviations), given its value at the sample before the onset."""
        if isinstance(self.shape, LossOfEffectiveness):
            return -self.size * share * (signal + offset)
        value = before if self.shape.value is None else self.shape.value - offset
        return np.where(share > 0, value - signal, 0.0)


def with_acting_fault(
    truth: list[Truth],
    acting: ActingFault,
    z: NDArray[np.float64],
    signals: NDArray[np.float64],
    onsets: NDArray[np.int64],
    share: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the recorded signals with such a fault.

    Parameters
    ----------
    truth : list of Truth
        Of each run, or one for all.
    acting : ActingFault
    z : ndarray, shape (runs, time, columns)
        Inputs of the simulation.
    signals : ndarray, shape (runs, time, channels)
        Recorded signals without the fault.
    onsets : ndarray of int, shape (runs,)
    share : ndarray, shape (runs, time)
    """
    j, channel, first = acting.fault, acting.channel, truth[0]
    offset = float(first.offset[channel])
    if not (first.looped or (channel >= first.inputs and any(one.Bf[:, j].any() for one in truth))):
        signal = signals[:, :, channel]
        before = signal[np.arange(len(signals)), np.maximum(onsets - 1, 0)][:, None]
        added = acting.added(signal, before, share, offset)
        if len(truth) == 1:
            return signals + first.respond_to_fault(j, added)
        parts = [one.respond_to_fault(j, added[k : k + 1]) for k, one in enumerate(truth)]
        return signals + np.concatenate(parts)
    # the fault depends on its own effect: sample by sample, all runs at once
    A, B, C, D = (np.stack([getattr(one, name) for one in truth]) for name in "ABCD")
    bf, df = (np.stack([getattr(one, name)[:, j] for one in truth]) for name in ("Bf", "Df"))
    runs, time, _ = z.shape
    x, before = np.zeros((runs, A.shape[1])), np.zeros(runs)
    out = np.empty((runs, time, C.shape[1]))
    for k in range(time):
        s = _times(D, z[:, k]) + _times(C, x)
        before = np.where(onsets >= k, out[:, k - 1, channel], before) if k else s[:, channel].copy()
        f = acting.added(s[:, channel], before, share[:, k], offset)
        out[:, k] = s + f[:, None] * df
        x = _times(B, z[:, k]) + _times(A, x) + f[:, None] * bf
    return out


def _times(M: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the product of a matrix for each run, or one for all, with a vector of each run: sums in one order."""
    total = np.zeros((len(v), M.shape[1]))
    for j in range(M.shape[2]):
        total += M[:, :, j] * v[:, j, None]
    return total


def check_same_channels(plant: Plant, model: Plant) -> None:
    """Raise unless a plant to simulate has the channels of the plant that the monitor is designed for."""
    for what in ("inputs", "outputs"):
        own, wanted = getattr(plant, what), getattr(model, what)
        if own != wanted:
            raise SettingError(
                f"plant {plant.name!r} has the {what} {', '.join(own) or 'none'}, the monitor watches "
                f"{', '.join(wanted) or 'none'}: a plant to simulate has the same channels in the same order"
            )
