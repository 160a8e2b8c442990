"""The optional compiled kernels; everything else about the package is in pyproject.toml."""

import os
import sys
import sysconfig
from glob import glob

from setuptools import Extension, setup

# The kernels promise the same bits as NumPy: no fused multiply-add, no reordering of sums. Nobody reads what a root or
# a comparison leaves in errno or among the flags of the processor, so that loops over them may become vectors.
same_bits = ["-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"]
# Vectors and unrolled loops are all of -O3 that makes the kernels faster; the rest takes compilers three times as long.
fast = ["-O2", "-ftree-vectorize", "-fvect-cost-model", "-fpeel-loops"]
flags = ["/O2", "/fp:precise"] if sys.platform == "win32" else [*fast, *same_bits, "-std=c11", "-g0"]
# Builds of Python without the global lock do not have the stable ABI.
stable_abi = not sysconfig.get_config_var("Py_GIL_DISABLED")


def kernel(name: str) -> Extension:
    """Return the definition of one compiled module."""
    return Extension(
        name,
        sources=[f"src/{name.replace('.', '/')}.c"],
        depends=sorted(glob("src/residua/**/_*.h", recursive=True)),
        extra_compile_args=flags,
        define_macros=[("Py_LIMITED_API", "0x030B0000")] if stable_abi else [],
        py_limited_api=stable_abi,
        optional=True,  # without a compiler the package is built all the same and runs on NumPy
    )


kernels = [kernel(f"residua.{name}") for name in ("linear.systems._recursion", "monitor._fused", "live._rows")]

setup(
    ext_modules=[] if os.environ.get("RESIDUA_NO_COMPILED") == "1" else kernels,
    options={"bdist_wheel": {"py_limited_api": "cp311"}} if stable_abi else {},
)
