"""A monitor as an ONNX model: ``Scan`` over time, with the state in and out."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from residua.errors import AccuracyError, SettingError, missing_extra
from residua.export.identifiers import checked_identifier, identifier
from residua.export.monitor_program import MonitorProgram, monitor_program, precision_named
from residua.export.one_file import file_for, named_after
from residua.export.program import Variable
from residua.export.selftest import DOUBLE_UNIT, Comparison, comparison, rounding_bound
from residua.export.tensor_program import Node, TensorProgram
from residua.files import replacing
from residua.monitor import Monitor

#: Written versions, supported by runtimes since 2022.
_OPSET, _IR = 17, 8
#: Values of a sample, by their names in the model.
_OUTPUTS = (
    "residual", "statistic", "known", "decided", "alarm", "scored", "score", "best", "part_statistic", "fired", "code",
    "answer",
)  # fmt: skip
_SUFFIX = ".onnx"
#: Samples of the comparison that the model is checked with.
_CHECKED = 50


class ONNXModel(NamedTuple):
    """Result of :func:`to_onnx`.

    Attributes
    ----------
    path : Path
        The file.
    bound : ndarray or None, shape (residuals,)
        By how much each residual may be off where something is decided; ``None`` where the filter forgets so slowly
        that no bound can be said.
    within : ndarray, shape (inputs + outputs,)
        The deviations from the operating point up to which that holds.
    """

    path: Path
    bound: NDArray[np.float64] | None
    within: NDArray[np.float64]


def to_onnx(
    monitor: Monitor,
    path: str | os.PathLike[str],
    *,
    name: str | None = None,
    precision: str = "double",
    missing: str = "as monitored",
    overwrite: bool = False,
) -> ONNXModel:
    r"""Write a monitor as an ONNX model, ``NAME.onnx``.

    The model takes recordings of one sample or more, ``u`` (samples, inputs; absent where the plant has none) and ``y``
    (samples, outputs), and its state, ``state`` and ``counts``: zeros at first, later ``next_state`` and
    ``next_counts`` of the call before. It gives ``residual`` (samples, residuals), ``statistic``, ``known``,
    ``decided``, ``alarm``, and where faults are named ``scored``, ``score`` (samples, groups) and ``best``, as
    :func:`to_c` does. Inside is one ``Scan`` over the samples.

    Guaranteed: where something is decided, residuals are off by no more than a bound, while signals stay within sizes:

    .. math::

       |\Delta r| \le H \delta + (G + |D|) v + \gamma (|C| X + |D| V), \qquad
       \delta = \gamma (|A| X + |B| V), \qquad \gamma = (n + m + 3) u

    with u = 2^-53 in double and 2^-24 in single precision (a runtime may add in any order, so that bits are not
    promised). Both stand in the model's properties. Before it is written the model is checked by ``onnx.checker``, and
    by the evaluator of the ``onnx`` package on 50 samples.

    Parameters
    ----------
    monitor : Monitor
        With a threshold; :func:`to_c` lists what can be exported.
    path : path
        A file that ends in ``.onnx``, or a folder for ``NAME.onnx``.
    name : str, optional
        From the file, else from the plant, when omitted.
    precision : {"double", "float"}
    missing : {"as monitored", "hold"}
        As of :func:`to_c`.
    overwrite : bool
        Whether a file that is there may be replaced.

    Returns
    -------
    ONNXModel
        The path, the bound, and the sizes of signals that it holds for.

    Raises
    ------
    MissingExtraError
        If the extra ``onnx`` is not installed.
    SettingError
        If the model cannot represent the monitor, an option has an invalid value, or nothing can be promised in
        single precision.
    AccuracyError
        If the model's answers are not those of the monitor.
    NotFittedError
        If the monitor has no threshold.
    DataError
        If the file is there, or its folder cannot be made.

    See Also
    --------
    to_c : For anything with a C compiler.

    Notes
    -----
    Assumes that samples are ``dt`` apart and that missing values are NaN. A decision about a statistic that is as near
    to its threshold as rounding reaches may be another one. It comes without a certificate.

    References
    ----------
    Bai, Lu, Zhang and others: ONNX, Open Neural Network Exchange, operator set 17.

    Examples
    --------
    >>> import tempfile
    >>> import residua as rs
    >>> plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1, inputs=["valve"], outputs=["level"])
    >>> plant = plant.with_sensor_faults().with_noise(process=1e-6, measurement=1e-4)
    >>> monitor = rs.Monitor(rs.design.kalman_filter(plant))
    >>> made = rs.export.to_onnx(monitor, tempfile.mkdtemp(), name="tank", missing="hold")
    >>> print(made.path.name, bool(made.bound < 1e-13))
    tank.onnx True
    """
    made = monitor_program(monitor, precision=precision_named(precision), missing=missing)
    prefix = (named_after(path, _SUFFIX) or identifier(made.name)) if name is None else checked_identifier(name)
    return pack(made, file_for(path, f"{prefix}{_SUFFIX}", overwrite=overwrite), prefix)


def pack(made: MonitorProgram, target: Path, name: str) -> ONNXModel:
    """Write a program as a model; parameters as of :func:`to_onnx`."""
    onnx = _package()
    one, spec = comparison(made), made.specification
    within = np.nanmax(np.abs(np.hstack([one.u, one.y]) - spec.offset), axis=0, initial=0.0)
    if made.precision.name == "float":
        bound: NDArray[np.float64] | None = rounding_bound(spec, within)
    else:
        try:
            bound = rounding_bound(spec, within, DOUBLE_UNIT)
        except SettingError:
            bound = None  # nothing is wrong with double precision, but that no number can be said
    model = _model(onnx, made, name, bound, within)
    onnx.checker.check_model(model, full_check=True)
    _check(onnx, model, made, one, bound)
    with replacing(target) as partial:
        partial.write_bytes(model.SerializeToString(deterministic=True))
    return ONNXModel(target, bound, within)


def _package() -> Any:
    """Return the ``onnx`` package."""
    try:
        import onnx
        import onnx.reference
    except ImportError as error:
        raise missing_extra("onnx", "onnx") from error
    return onnx


def _check(onnx: Any, model: Any, made: MonitorProgram, one: Comparison, bound: NDArray[np.float64] | None) -> None:
    """Raise unless the package's evaluator gives the monitor's answers on samples around a gap.

    Raises
    ------
    AccuracyError
    """
    real = np.float64 if made.precision.name == "double" else np.float32
    state, counts = (sum(_size(v) for v in _states(made, real=kind)) for kind in (True, False))
    feed: dict[str, Any] = {"y": one.y[:_CHECKED].astype(real), "state": np.zeros(state, real)}
    feed["counts"] = np.zeros(counts, np.int64)
    if made.inputs:
        feed["u"] = one.u[:_CHECKED].astype(real)
    evaluator = onnx.reference.ReferenceEvaluator(model)
    with np.errstate(all="ignore"):  # of computed values that are not selected
        given = dict(zip(evaluator.output_names, evaluator.run(None, feed), strict=True))
    decided = one.decided[:_CHECKED]
    off = np.abs(given["residual"].astype(float) - one.residuals[:_CHECKED])[decided]
    exact = {"known": one.known, "decided": one.decided}
    if made.precision.name == "double":  # in single precision a statistic near its threshold may fall to the other side
        exact["alarm"] = one.alarm
    wrong = sum(int(np.count_nonzero(given[name] != right[:_CHECKED])) for name, right in exact.items())
    if wrong or (bound is not None and bool((off > bound).any())):
        promised = np.nan if bound is None else np.max(bound, initial=0.0)
        raise AccuracyError(
            f"the ONNX model does not answer as the monitor: residuals are off by up to {off.max(initial=0.0):.2g} "
            f"where {promised:.2g} is promised, and {wrong} answers of {_CHECKED} samples are others; please report "
            "this, with the monitor"
        )


def _size(one: Variable) -> int:
    return 1 if one.size is None else one.size


def _states(made: MonitorProgram, *, real: bool) -> list[Variable]:
    """Return the state variables: numbers, or counts and flags."""
    return [one for one in made.program.of_role("state") if (one.kind == "real") == real]


def _model(
    onnx: Any, made: MonitorProgram, name: str, bound: NDArray[np.float64] | None, within: NDArray[np.float64]
) -> Any:
    """Return the model: the state in parts, a Scan over time, and the state as one again."""
    helper, types = onnx.helper, onnx.TensorProto
    real = types.DOUBLE if made.precision.name == "double" else types.FLOAT
    of_kind = {"real": real, "count": types.INT64, "flag": types.BOOL}
    body = _Body(onnx, made, of_kind)
    nodes, states = _unpacked(helper, made, of_kind)
    signals = [one for one in made.program.of_role("input") if one.size]
    after, scanned = [f"{one.name}_after" for one in body.states], [one.name for one in body.outputs]
    given, count = [*states, *(one.name for one in signals)], len(signals)
    nodes.append(helper.make_node("Scan", given, [*after, *scanned], body=body.graph, num_scan_inputs=count))
    nodes += _packed(helper, made, of_kind)
    sizes = [sum(_size(one) for one in _states(made, real=kind)) for kind in (True, False)]
    info = helper.make_tensor_value_info
    inputs = [info(one.name, real, ["samples", one.size]) for one in signals]
    inputs += [info("state", real, [sizes[0]]), info("counts", types.INT64, [sizes[1]])]
    outputs = [info(one.name, of_kind[one.kind], ["samples", *one.shape]) for one in body.outputs]
    outputs += [info("next_state", real, [sizes[0]]), info("next_counts", types.INT64, [sizes[1]])]
    graph = helper.make_graph(nodes, name, inputs, outputs, [*_constants(onnx, made, sizes), *body.constants])
    model = helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", _OPSET)], ir_version=_IR, producer_name="residua"
    )
    helper.set_model_props(model, _properties(made, bound, within))
    return model


def _properties(made: MonitorProgram, bound: NDArray[np.float64] | None, within: NDArray[np.float64]) -> dict[str, str]:
    """Return the metadata of the model."""
    words = [*made.notes, "It comes without a certificate."]
    return {
        "inputs": json.dumps(made.inputs),
        "outputs": json.dumps(made.outputs),
        "units": json.dumps(made.units),
        "residuals": json.dumps(made.residuals),
        "groups": json.dumps(made.groups),
        "parts": json.dumps(made.parts),
        "dt": repr(made.dt),
        "threshold": repr(float(made.judging.test.threshold)),
        "bound": json.dumps(None if bound is None else bound.tolist()),
        "within": json.dumps(within.tolist()),
        "notes": " ".join(words),
    }


class _Body:
    """Computation on each sample, as a graph of the ``onnx`` package.

    Parameters
    ----------
    onnx : module
    made : MonitorProgram
    of_kind : dict
        The types of ONNX.
    """

    def __init__(self, onnx: Any, made: MonitorProgram, of_kind: dict[str, int]) -> None:
        self._onnx, self._types = onnx, of_kind
        tensors = TensorProgram(made)
        self.states = [*_states(made, real=True), *_states(made, real=False)]
        self.outputs = sorted(made.program.of_role("output"), key=lambda one: _OUTPUTS.index(one.name))
        signals = [one for one in made.program.of_role("input") if one.size]
        given = [(one, tensors.named(one.name)) for one in (*self.states, *self.outputs)]
        ends = [Node("Identity", (name,), (f"{one.name}_next",), {}) for one, name in given]
        nodes = _used([*tensors.nodes, *ends], {f"{one.name}_next" for one, _ in given})
        info = onnx.helper.make_tensor_value_info
        self.graph = onnx.helper.make_graph(
            [self._node(one) for one in nodes],
            "sample",
            [info(f"{one.name}_now", of_kind[one.kind], one.shape) for one in (*self.states, *signals)],
            [info(f"{one.name}_next", of_kind[one.kind], one.shape) for one, _ in given],
        )
        wanted = _names(nodes)
        self.constants = [
            onnx.numpy_helper.from_array(value, name) for name, value in tensors.constants.items() if name in wanted
        ]

    def _node(self, one: Node) -> Any:
        helper = self._onnx.helper
        attributes = dict(one.attributes)
        if one.operation == "Cast":
            attributes["to"] = self._types[attributes["to"]]
        if one.branches:
            for name, (nodes, given) in zip(("then_branch", "else_branch"), one.branches, strict=True):
                ends = [helper.make_value_info(end, self._onnx.TypeProto()) for end in given]
                attributes[name] = helper.make_graph([self._node(inner) for inner in nodes], name, [], ends)
        return helper.make_node(one.operation, list(one.inputs), list(one.outputs), **attributes)


def _used(nodes: Sequence[Node], wanted: set[str]) -> list[Node]:
    """Return the nodes that lead to wanted outputs, in order."""
    kept: list[Node] = []
    for one in reversed(nodes):
        if not wanted & set(one.outputs):
            continue
        branches = []
        for inner, given in one.branches:
            here = set(given)
            branches.append((_used(inner, here), given))
            wanted |= here
        made = Node(one.operation, one.inputs, one.outputs, one.attributes, tuple(branches))
        wanted |= _names([made])
        kept.append(made)
    return kept[::-1]


def _names(nodes: Sequence[Node]) -> set[str]:
    """Return all names that nodes read, those in branches included."""
    found: set[str] = set()
    for one in nodes:
        found |= set(one.inputs)
        for inner, _ in one.branches:
            found |= _names(inner)
    return found


def _shape(one: Variable) -> str:
    """Return the name of the constant with the shape of a variable."""
    return f"shape_{'x'.join(map(str, one.shape))}"


def _unpacked(helper: Any, made: MonitorProgram, of_kind: dict[str, int]) -> tuple[list[Any], list[str]]:
    """Return the nodes that take the state apart, and the names of the parts."""
    nodes, names = [], []
    for whole, real in (("state", True), ("counts", False)):
        parts = _states(made, real=real)
        names += [f"{one.name}_before" for one in parts]
        if not parts:
            continue
        nodes.append(helper.make_node("Split", [whole, f"sizes_of_{whole}"], [f"{one.name}_part" for one in parts]))
        for one in parts:
            nodes.append(helper.make_node("Reshape", [f"{one.name}_part", _shape(one)], [f"{one.name}_shaped"]))
            nodes.append(helper.make_node("Cast", [f"{one.name}_shaped"], [f"{one.name}_before"], to=of_kind[one.kind]))
    return nodes, names


def _packed(helper: Any, made: MonitorProgram, of_kind: dict[str, int]) -> list[Any]:
    """Return the nodes that put the state together again."""
    nodes = []
    for whole, real in (("state", True), ("counts", False)):
        parts = _states(made, real=real)
        kind = of_kind["real" if real else "count"]
        for one in parts:
            nodes.append(helper.make_node("Cast", [f"{one.name}_after"], [f"{one.name}_cast"], to=kind))
            nodes.append(helper.make_node("Reshape", [f"{one.name}_cast", "row"], [f"{one.name}_row"]))
        if parts:
            nodes.append(helper.make_node("Concat", [f"{one.name}_row" for one in parts], [f"next_{whole}"], axis=0))
        else:
            nodes.append(helper.make_node("Identity", [whole], [f"next_{whole}"]))
    return nodes


def _constants(onnx: Any, made: MonitorProgram, sizes: Sequence[int]) -> list[Any]:
    """Return the constants for the nodes around the Scan."""
    made_of = {"row": [-1], **{_shape(one): one.shape for one in made.program.of_role("state")}}
    for whole, real, size in (("state", True, sizes[0]), ("counts", False, sizes[1])):
        if size:
            made_of[f"sizes_of_{whole}"] = [_size(one) for one in _states(made, real=real)]
    return [onnx.numpy_helper.from_array(np.array(values, dtype=np.int64), name) for name, values in made_of.items()]


__all__ = ["ONNXModel", "pack", "to_onnx"]
