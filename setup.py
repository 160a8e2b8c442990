"""The optional compiled kernels; everything else about the package is in pyproject.toml."""

import os
import sys
import sysconfig

from setuptools import Extension, setup

# The kernels promise the same bits as NumPy: no fused multiply-add, no reordering of sums. Nobody reads what a root or
# a comparison leaves in errno or among the flags of the processor, so that loops over them may become vectors.
same_bits = ["-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"]
# Vectors and unrolled loops are all of -O3 that makes the kernels faster; the rest takes three times as long to compile.
fast = ["-O2", "-ftree-vectorize", "-fvect-cost-model", "-fpeel-loops"]
flags = ["/O2", "/fp:precise"] if sys.platform == "win32" else [*fast, *same_bits, "-std=c11", "-g0"]
# Builds of Python without the global lock do not have the stable ABI.
stable_abi = not sysconfig.get_config_var("Py_GIL_DISABLED")


def kernel(name: str, depends: list[str]) -> Extension:
    """Return the definition of one compiled module."""
    return Extension(
        name,
        sources=[f"src/{name.replace('.', '/')}.c"],
        depends=[module_header, *depends],
        extra_compile_args=flags,
        define_macros=[("Py_LIMITED_API", "0x030B0000")] if stable_abi else [],
        py_limited_api=stable_abi,
        optional=True,  # without a compiler the package is built all the same and runs on NumPy
    )


filter_header, judging_header = "src/residua/linear/systems/_filter.h", "src/residua/decide/_judging.h"
members_header, means_header = "src/residua/decide/_members.h", "src/residua/decide/_means.h"
plant_header, tick_header = "src/residua/monitor/_plant_filter.h", "src/residua/monitor/_tick.h"
gain_header, module_header = "src/residua/monitor/_partial_gain.h", "src/residua/_module.h"
quads_header = "src/residua/monitor/_four_samples.h"
loop_headers = [filter_header, judging_header, members_header, means_header, plant_header, tick_header, gain_header, quads_header]
kernels = [
    kernel("residua.linear.systems._recursion", [filter_header]),
    kernel("residua.monitor._fused", loop_headers),
    kernel("residua.live._rows", []),
]

setup(
    ext_modules=[] if os.environ.get("RESIDUA_NO_COMPILED") == "1" else kernels,
    options={"bdist_wheel": {"py_limited_api": "cp311"}} if stable_abi else {},
)
