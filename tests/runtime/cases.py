"""Compiler options for tests of large programs on tiny arrays."""

import jax


def known_options(options):
    """Those compiler options that this jax knows."""
    known = {}
    for name, value in options.items():
        try:
            jax.jit(lambda: 0, compiler_options={name: value})()
        except jax.errors.JaxRuntimeError:
            continue
        known[name] = value
    return known


# The networks are tiny and the programs are not: most of the time would go to optimising machine code.
QUICK = known_options(
    {
        "xla_backend_optimization_level": 0,
        "xla_llvm_disable_expensive_passes": True,
        "xla_cpu_use_fusion_emitters": False,
        "xla_cpu_parallel_codegen_split_count": 1,
    }
)
