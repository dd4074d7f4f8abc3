"""Equations compiled to machine code by a C compiler, and cached on disk by the hash of their source."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import tempfile
from functools import lru_cache
from pathlib import Path

import casadi as ca

from graspforce.planning.nlp.equations import Equations

_FLAGS = ("-O1", "-fPIC", "-shared")
_TIMEOUT = 120  # s; a compiler that takes longer hangs


def cache_folder() -> Path:
    """Return the folder of compiled equations, in the user's cache."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "graspforce" / "equations"


@lru_cache(maxsize=128)
def compile_equations(equations: Equations) -> Equations:
    """Return the equations as machine code, or unchanged if there is no C compiler or it fails.

    Args:
        equations: the equations.
    """
    compiler = shutil.which(os.environ.get("CC", "cc"))
    functions = (equations.value, equations.jacobian_values, equations.lagrangian_derivatives)
    if compiler is None:
        return equations
    try:
        library = str(_compile(compiler, functions))
        value, jacobian_values, lagrangian_derivatives = (ca.external(function.name(), library) for function in functions)
    except (OSError, subprocess.SubprocessError, RuntimeError):
        return equations
    patterns = (equations.jacobian_sparsity, equations.hessian_sparsity)
    return Equations(equations.name, value, jacobian_values, lagrangian_derivatives, *patterns)


def _compile(compiler: str, functions: tuple[ca.Function, ...]) -> Path:
    """Return the shared library of some functions, compiled unless it is in the cache."""
    with tempfile.TemporaryDirectory() as scratch:
        generator = ca.CodeGenerator("equations.c", {"with_header": False})
        for function in functions:
            generator.add(function)
        source = Path(generator.generate(scratch + os.sep))
        key = hashlib.sha256(source.read_bytes() + " ".join((compiler, *_FLAGS)).encode()).hexdigest()
        library = cache_folder() / f"{key}.so"
        if not library.exists():
            library.parent.mkdir(parents=True, exist_ok=True)
            compiled = Path(scratch) / "equations.so"
            command = [compiler, *_FLAGS, str(source), "-o", str(compiled), "-lm"]
            subprocess.run(command, check=True, capture_output=True, timeout=_TIMEOUT)
            partial = library.with_suffix(f".{os.getpid()}")
            shutil.copy(compiled, partial)
            partial.replace(library)  # atomic: other processes never load half a file
        return library
