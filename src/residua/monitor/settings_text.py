"""How a monitor was set, in words."""

from __future__ import annotations

from residua.decide.member_thresholds import BankTest
from residua.decide.norm_threshold import NormTest
from residua.decide.peak_tests import CERTIFIED
from residua.decide.residual_groups import GroupTest
from residua.design import ResidualGenerator
from residua.monitor.running import Specification


def settings_of(spec: Specification, generator: ResidualGenerator) -> dict[str, str]:
    """Return how threshold, alarms and isolation were set, in words."""
    test, step = spec.test, generator.dt
    out = {
        "sample step": f"{step:g} s",
        "threshold": _threshold(test, spec.members),
        "test": _peak_test(test, step) if test.kind == "peak" else _norm_test(test),
        "alarm": _alarm(test),
        "settling": f"no decision in the first {spec.settle} samples after a start ({spec.settle * step:g} s)",
        "start": _start(spec),
        "missing values": _missing(spec),
    }
    if spec.direction is not None:
        window = spec.direction.window
        out["isolation"] = f"direction of the residual averaged over {window} samples ({window * step:g} s)"
    if spec.matched is not None:
        out |= _matched_settings(spec, step)
    if spec.codes is not None:
        out["isolation"] = _code(spec, step)
    return out


def _start(spec: Specification) -> str:
    if spec.first is None:
        return "as if the plant had been at rest at the first sample"
    return f"state estimated from the residuals of the first {spec.first.samples} samples"


def _missing(spec: Specification) -> str:
    if spec.partial is None:
        return f"held for up to {spec.max_hold} samples, then the filter starts anew"
    return (
        "the filter goes on with the outputs that are there; after more than "
        f"{spec.max_hold} samples in a row without any, or with an input missing, it starts anew"
    )


def _threshold(test: NormTest | BankTest, members: tuple[str, ...]) -> str:
    if isinstance(test, NormTest):
        return f"{test.threshold:.4g} ({test.basis})"
    limits = ", ".join(f"{name} {limit:.4g}" for name, limit in zip(members, test.thresholds, strict=True))
    return f"{limits} ({test.basis})"


def _norm_test(test: NormTest | BankTest) -> str:
    summed = f", summed over {test.window} samples" if test.window > 1 else ""
    if isinstance(test, BankTest):
        whose = "group of residuals, whitened" if isinstance(test, GroupTest) else "member's whitened residual"
        return f"norm of each {whose}{summed}; the statistic is the largest ratio to its threshold"
    return f"norm of the whitened residual{summed}"


def _peak_test(test: NormTest | BankTest, step: float) -> str:
    """Return the finite-horizon test in words."""
    several = isinstance(test, BankTest) and len(test.thresholds) > 1
    origin = "certified by the design" if test.basis.startswith(CERTIFIED) else test.basis.split(" ")[0]
    origin = {"each": "fitted", "threshold": "given"}.get(origin, origin)
    whose = "each member's residual; the statistic is the largest ratio to its threshold" if several else "the residual"
    return (
        f"finite-horizon peak test, window {test.release} samples ({test.release * step:g} s), "
        f"threshold{'s' if several else ''} {origin}: norm of {whose}"
    )


def _alarm(test: NormTest | BankTest) -> str:
    samples = "one sample" if test.kind == "peak" else f"{test.persistence} samples in a row"
    if isinstance(test, BankTest):
        one, all_ = ("a group", "all") if isinstance(test, GroupTest) else ("a member", "the bank")
        return (
            f"of {one}: raised by {samples} over its threshold, ended by {test.release} below it; of {all_}: "
            f"while any {one[2:]} is in alarm"
        )
    return f"raised by {samples} over it, ended by {test.release} below it"


def _code(spec: Specification, step: float) -> str:
    assert spec.codes is not None
    window = spec.codes.window
    told = (
        f"code of the members that fired over {window} samples ({window * step:g} s): those in alarm for at least "
        f"{spec.codes.share:g} of the samples of the one that was in alarm the longest"
    )
    if spec.codes.dedicated and spec.test.kind == "peak":
        return "every fault has a member of its own: each member that fires in an alarm names its fault"
    if spec.codes.dedicated:
        return f"{told}; every fault has a member of its own, so several at once are all named"
    return f"{told}; nearest codes up to {spec.codes.distance} off"


def _matched_settings(spec: Specification, step: float) -> dict[str, str]:
    """Return how matched filters were set, in words."""
    assert spec.matched is not None
    window = spec.matched.window
    if not len(spec.matched.responses):
        return {
            "test": f"largest standardised size of a settled fault, over {window + 1} samples",
            "isolation": "the settled response that explains them best; the name may be wrong until it has settled",
        }
    return {
        "test": f"largest standardised size of a step fault that arrived up to {window} samples ago, or before",
        "isolation": f"the fault and arrival, up to {window} samples ({window * step:g} s) ago, that explain the "
        "innovations best; held once that arrival has left the window",
        "missing values": f"{_missing(spec)}; samples without a decision count for none",
    }
